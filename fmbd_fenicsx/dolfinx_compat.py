"""The only place where versions of DOLFINx differ (0.9, 0.10, 0.11), and the checks of what was found."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .errors import FmbdError
from .log import note
from .ranks import together

OLDEST = (0, 9)
NOT_COMPILED = "Failed just-in-time compilation"  # how DOLFINx begins to say so
OTHER_MESH = (
    "it holds coordinates or functions of another mesh than that of its measure. The body may be taken to a finer mesh: write "
    "x = ufl.SpatialCoordinate(dx.ufl_domain())"
)
SLOW = 1.0  # s: a form that is kept is there in a hundredth of it
JIT_OPTIONS: dict[str, Any] = {"timeout": 600}  # wait for another process that compiles the same form


def check_versions() -> None:
    """Refuse a DOLFINx older than 0.9 and a complex PETSc, on all ranks alike."""
    import dolfinx
    from petsc4py import PETSc

    refuse_unusable(dolfinx.__version__, np.dtype(PETSc.ScalarType).kind)


def refuse_unusable(version: str, scalar_kind: str) -> None:
    """Raise unless the DOLFINx version string and the kind of PETSc's scalars ("f" or "c") can be used."""
    numbers = tuple(int(p) for p in version.split(".")[:2])
    if numbers < OLDEST:
        raise FmbdError(f"DOLFINx {version} is too old: fmbd_fenicsx needs 0.9 or newer. Use ./with-dolfinx.")
    if scalar_kind != "f":
        raise FmbdError(
            "PETSc was built with complex numbers: fmbd_fenicsx needs the real build. "
            "Set PETSC_DIR to a real build (Debian: python3-petsc4py-real), or use ./with-dolfinx."
        )


def model_to_mesh(model: Any, comm: Any, dim: int) -> tuple[Any, Any, Any]:
    """Distribute the gmsh model of rank 0: mesh, cell tags, facet tags (None without facet groups); collective."""
    from dolfinx import mesh

    try:
        from dolfinx.io import gmsh as reader
    except ImportError:
        from dolfinx.io import gmshio as reader
    msh, cells, facets = reader.model_to_mesh(model, comm, 0, gdim=dim, partitioner=_partitioner(mesh))[:3]
    if facets is not None and comm.allreduce(len(facets.values)) == 0:
        facets = None
    return _mesh_of(msh._cpp_object, msh.ufl_domain().ufl_coordinate_element()), cells, facets


@cache
def _domain() -> Any:
    """UFL's mesh, which makes its cell once. Basix makes one whenever it is asked, a hexahedron of 147 cells within each other;
    spaces and forms of a body ask forty times.
    """
    import ufl

    class Domain(ufl.Mesh):  # type: ignore[misc]
        @cached_property
        def _cell(self) -> Any:
            return super().ufl_cell()

        def ufl_cell(self) -> Any:
            return self._cell

    return Domain


def _mesh_of(made: Any, element: Any) -> Any:
    """DOLFINx's mesh around one of C++ with this element of its coordinates."""
    from dolfinx import mesh

    return mesh.Mesh(made, _domain()(element))


def _partitioner(mesh: Any) -> Any:
    """Cells on ranks with the neighbours across facets as ghosts."""
    try:
        return mesh.create_cell_partitioner(mesh.GhostMode.shared_facet)
    except TypeError:
        return mesh.create_cell_partitioner(mesh.GhostMode.shared_facet, 2)


def coordinate_element(geometry: Any) -> Any:
    """The element that maps the cells of a mesh, which has one."""
    known = getattr(geometry, "cmaps", None)
    return geometry.cmap if known is None or callable(known) else known[0]  # 0.9 has a function of that name


def moved(msh: Any, x: np.ndarray) -> Any:
    """A mesh with the topology of another and the points x (n, d) in place of its own."""
    from dolfinx import cpp

    old = msh.geometry._cpp_object
    element = coordinate_element(old)
    geometry = type(old)(
        old.index_map(), geometry_dofmap(msh), element, np.ascontiguousarray(x), old.input_global_indices
    )
    made = cpp.mesh.Mesh_float64(msh.comm, msh.topology._cpp_object, geometry)
    return _mesh_of(made, msh.ufl_domain().ufl_coordinate_element())


def of_simplices(domain: Any) -> bool:
    """Whether the cells of UFL's mesh are simplices."""
    told = domain.ufl_cell().is_simplex
    return bool(told() if callable(told) else told)  # 0.9 has a function of that name


def space_like(known: Any, msh: Any) -> Any:
    """A function space on another mesh of the same topology, with the same numbers of nodes."""
    from dolfinx import fem

    inner = known._cpp_object
    given = msh._cpp_object, inner.element, inner.dofmap
    try:
        made = type(inner)(*given)
    except TypeError:
        made = type(inner)(*given, inner.value_shape)  # 0.9
    return fem.FunctionSpace(msh, known.ufl_element(), made)


def geometry_dofmap(msh: Any) -> np.ndarray:
    """Cell-to-node map of the mesh geometry, (n_cells, n_nodes)."""
    g = msh.geometry
    return np.asarray(g.dofmaps[0] if hasattr(g, "dofmaps") else g.dofmap)


def pull_back(msh: Any, x: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Points x (n, d) of the cell with the geometry ``nodes`` (k, d), in the reference cell, (n, d)."""
    g = msh.geometry
    element = coordinate_element(g)
    return np.asarray(element.pull_back(np.ascontiguousarray(x), np.ascontiguousarray(nodes)))


def interpolation_points(space: Any) -> np.ndarray:
    """Points of the reference cell where expressions are evaluated for a space, (n, d)."""
    points = space.element.interpolation_points
    return np.asarray(points() if callable(points) else points)


class _Modules:
    """The modules that FFCx has loaded in this process; ``missed`` is called before it looks for another one.

    It reads its whole folder of modules for each form, also for one that it has just loaded: nearly all that a small body
    takes to set up. What a module is called tells its form, the elements and all options, so that a name stands for one module.
    """

    def __init__(self) -> None:
        from ffcx.codegeneration import jit

        self._look: Callable[..., Any] = jit.get_cached_module
        self._loaded: dict[tuple[Any, ...], Any] = {}
        self.missed: Callable[[], None] = lambda: None
        jit.get_cached_module = self._of
        jit.compile_forms = self._freeing(jit.compile_forms)
        jit.compile_expressions = self._freeing(jit.compile_expressions)
        self._begun: Path | None = None  # the source that others wait for

    def _freeing(self, compile_all: Callable[..., Any]) -> Callable[..., Any]:
        """As FFCx's own. What is no Exception would leave the source that others wait for, and ranks beside this one waiting."""
        from cffi import VerificationError
        from ufl.algorithms.check_arities import ArityMismatch

        def compiled(*given: Any, **more: Any) -> Any:
            self._begun = None
            try:
                return compile_all(*given, **more)
            except ArityMismatch as error:
                self._leave()
                raise ValueError(str(error)) from error
            except VerificationError as error:
                # not from that: of what C compilers say it has many pages
                raise FmbdError(
                    f"A form of an elastic body is not compiled: {error}. FEniCSx needs a C compiler for it, the variable CC or "
                    "cc; rigid bodies, beams and rods run without one."
                ) from None
            except KeyboardInterrupt:
                self._leave()
                raise

        return compiled

    def _leave(self) -> None:
        """Nobody waits for what was begun."""
        if self._begun is not None:
            self._begun.unlink(missing_ok=True)

    def _of(self, module_name: str, object_names: Any, cache_dir: Any, timeout: Any) -> Any:
        """As FFCx's own; asked once a module."""
        wanted = (module_name, tuple(object_names), str(cache_dir))
        if wanted not in self._loaded:
            self.missed()
            found = self._look(module_name, object_names, cache_dir, timeout)
            if found[1] is None:
                self._begun = Path(cache_dir, f"{module_name}.c")
                return found
            self._loaded[wanted] = found
        return self._loaded[wanted]


@cache
def _modules() -> _Modules:
    return _Modules()


def _refuse_no_numbers(ufl_form: Any) -> None:
    """Numbers are written into C, where nan and inf are the names of functions."""
    from ufl.constantvalue import RealValue
    from ufl.corealg.traversal import traverse_unique_terminals

    for integral in ufl_form.integrals():
        for leaf in traverse_unique_terminals(integral.integrand()):
            if isinstance(leaf, RealValue) and not np.isfinite(float(leaf)):
                raise ValueError(f"a number in it is {float(leaf)}")


def form(ufl_form: Any) -> Any:
    """Compile a UFL form; collective. Waits for other processes that compile the same form.

    One that is not kept from earlier runs takes seconds, which is then said.

    Raises:
        ValueError: a number in it is not finite.
    """
    from dolfinx import fem
    from ufl import Mesh

    _refuse_no_numbers(ufl_form)
    modules = _modules()
    sort = ("a functional", "a linear form", "a bilinear form")[len(ufl_form.arguments())]
    saying = threading.Timer(SLOW, note, (f"compiling {sort} of an elastic body, once (some seconds)",))
    saying.daemon = True

    def begin() -> None:
        # a thread takes as long as a form that is there
        if saying.ident is None:
            saying.start()

    modules.missed = begin
    try:
        return fem.form(ufl_form, jit_options=dict(JIT_OPTIONS))
    except RuntimeError as error:
        # raised on all ranks, of which only the first knows why
        if str(error).startswith(NOT_COMPILED):
            together(ufl_form.ufl_domain().ufl_cargo().comm, error)
        raise
    except KeyError as error:
        # UFL numbers the meshes of measures only
        if isinstance(error.args[0], Mesh):
            raise TypeError(OTHER_MESH) from error
        raise
    finally:
        saying.cancel()


def assembly_of(form: Any) -> Callable[[np.ndarray], None]:
    """What adds the vector of a compiled linear form to an array, ghosts included, without a look at what it is given."""
    from dolfinx import cpp

    inner, of = form._cpp_object, cpp.fem

    def assemble(x: np.ndarray) -> None:
        of.assemble_vector(x, inner, of.pack_constants(inner), of.pack_coefficients(inner))

    return assemble


def integrals_of(form: Any) -> list[tuple[int, np.ndarray, np.ndarray | None, np.ndarray]] | None:
    """Of each integral of a compiled form over cells or exterior facets: the address of FFCx's function, the cells, the facets of
    these (None: the cells themselves) and the packed coefficients, (count, width); None where others are in it, or DOLFINx tells
    them otherwise.
    """
    from dolfinx import cpp

    inner, kinds = form._cpp_object, getattr(cpp.fem, "IntegralType", None)
    if kinds is None:
        return None
    known = [kinds.cell, kinds.exterior_facet]  # in FFCx's order
    if form.ufcx_form is None or any(kind not in known for kind in inner.integral_types):
        return None
    packed = cpp.fem.pack_coefficients(inner)
    found = []

    for kind in inner.integral_types:
        place = known.index(kind)
        first, end = (form.ufcx_form.form_integral_offsets[i] for i in (place, place + 1))
        for i in range(first, end):
            number = form.ufcx_form.form_integral_ids[i]
            function = form.ufcx_form.form_integrals[i].tabulate_tensor_float64
            try:
                where = np.array(inner.domains(kind, number))
            except TypeError:
                return None
            cells, facets = (where, None) if kind == kinds.cell else where.reshape(-1, 2).T
            address = int(form.module.ffi.cast("uintptr_t", function))
            found.append((address, cells, facets, np.array(packed[kind, number])))
    return found


def constants_of(form: Any) -> np.ndarray:
    """The constants of a compiled form as its functions read them, one behind the other."""
    return reader_of_constants(form)()


def reader_of_constants(form: Any) -> Callable[[], np.ndarray]:
    """Reads :func:`constants_of` a form, whenever it is called."""
    from dolfinx import cpp

    inner = form._cpp_object
    return lambda: np.array(cpp.fem.pack_constants(inner))


def functions_of(form: Any) -> list[Any]:
    """The functions among the coefficients of a compiled form, DOLFINx's own in C++."""
    return list(form._cpp_object.coefficients)
