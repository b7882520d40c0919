"""Reading meshes: what arrives, and one clear error on all ranks for each fault."""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from faulty import FAULTS
from motion import elastic_rod
from mpi4py import MPI
from programs import launch
from scipy.spatial.transform import Rotation

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import dolfinx_compat, read_gmsh
from fmbd_fenicsx.errors import FmbdError, InputError, MeshError
from fmbd_fenicsx.fem.fields import Field

HERE = Path(__file__).resolve().parent
FAULTY = HERE / "faulty.py"


@pytest.mark.mpi
@pytest.mark.smoke
@pytest.mark.parametrize("dim", [2, 3])
def test_names_dimension_and_size(dim: int, rod_mesh: Callable[..., Any]) -> None:
    mesh = rod_mesh(dim=dim, h=0.5, height=0.4)
    assert mesh.dim == dim
    assert mesh.surface_names == ["pin", "side", "tip"]
    assert mesh.volume == "rod"
    x = mesh.dolfinx.geometry.x
    low, high = (mesh.dolfinx.comm.allgather(f(x[:, 0]) if len(x) else v) for f, v in ((np.min, 9.0), (np.max, -9.0)))
    assert (min(low), max(high)) == (0.0, 1.0)


@pytest.mark.mpi
@pytest.mark.smoke
@pytest.mark.parametrize("dim", [2, 3])
def test_one_mesh_for_bodies_at_several_places(dim: int, rod_mesh: Callable[..., Any]) -> None:
    """Two rods of one mesh, joined tip to pin at a right angle: surfaces where they should be, the mesh itself unmoved."""
    mesh = rod_mesh(dim=dim, h=0.5, height=0.4)
    turned = Rotation.from_rotvec([0, 0, np.pi / 2])
    away = np.array([1.0, 0.0, 0.5])[:dim]
    other = mesh.placed(away, np.pi / 2 if dim == 2 else turned.as_quat())
    elastic = fmbd.materials.linear_elastic(1e9, 0.3)
    a, b = (fmbd.FloatingBody(n, m, density=1e3, elastic=elastic) for n, m in (("a", mesh), ("b", other)))
    scene = fmbd.Scene("angle")
    scene.add(
        a, b, fmbd.spherical("elbow", a.surface("tip"), b.surface("pin"), center=away * 0 + [1.0, 0.0, 0.0][:dim])
    )
    for name, body in (("a", a), ("b", b)):
        scene.sensor(name, fmbd.position(body.surface("tip")))
    run = fmbd.solve(scene, t_end=1e-3, dt=1e-3)
    np.testing.assert_allclose(run["a"][0], [1.0, 0.0, 0.0][:dim], atol=1e-12)
    np.testing.assert_allclose(run["b"][0], away + [0.0, 1.0, 0.0][:dim], atol=1e-12)
    with pytest.raises(MeshError, match="rod.py: position 1.0 must be"):
        mesh.placed(1.0)
    with pytest.raises(InputError, match="A rotation is"):
        mesh.placed(away, [1.0, 2.0])


@pytest.mark.mpi
@pytest.mark.parametrize("fault", FAULTS)
def test_faulty_mesh_is_refused(fault: str) -> None:
    """The same message on every rank: pytest sees it on each."""
    with pytest.raises(MeshError, match="(?s)faulty.py.*" + FAULTS[fault]):
        read_gmsh(FAULTY, fault=fault)


@pytest.mark.smoke
@pytest.mark.mpi
def test_reading_works_after_an_error(rod_mesh: Callable[..., Any]) -> None:
    with pytest.raises(MeshError):
        read_gmsh(FAULTY, fault="none")
    assert read_gmsh(HERE.parent / "meshes/rod.py", h=0.5).dim == 2


@pytest.mark.smoke
@pytest.mark.mpi
def test_missing_file_and_wrong_arguments() -> None:
    with pytest.raises(MeshError, match=r"meshes/rood.py does not exist"):
        read_gmsh("meshes/rood.py")
    with pytest.raises(MeshError, match="(?s)faulty.py.*TypeError.*fualt"):
        read_gmsh(FAULTY, fualt="none")
    with pytest.raises(MeshError, match='no volume "body".*"plate 0"'):
        read_gmsh(FAULTY, fault="two volumes", volume="body")
    with pytest.raises(MeshError, match="no function build"):
        read_gmsh(HERE / "motion.py")


@pytest.mark.mpi
def test_a_group_that_is_no_surface_says_why() -> None:
    mesh = read_gmsh(FAULTY, fault="lone point")
    with pytest.raises(MeshError, match=r'No surface "corner".* holds points: surfaces hold curves.*Known: "end"'):
        mesh.surface_tag("corner")
    body = fmbd.FloatingBody("plate", mesh, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3))
    with pytest.raises(InputError, match='Body "plate": no surface "corner".* holds points'):
        body.surface("corner")


@pytest.mark.mpi
def test_a_form_that_is_not_linear_is_an_input_error(rod_mesh: Callable[..., Any]) -> None:
    """UFL's own exception for it is none that `except Exception` sees."""

    def elastic(u: Any, v: Any, dx: Any) -> Any:
        return (1 + u[0] ** 2) * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(v)) * dx

    body = fmbd.FloatingBody("rod", rod_mesh(dim=2, h=0.1), density=1.0, elastic=elastic)
    with pytest.raises(InputError, match='Body "rod".*did not give a bilinear UFL form'):
        body.frequencies(1)


@pytest.mark.mpi
def test_file_that_is_no_mesh(shared_tmp: Path) -> None:
    path = shared_tmp / "broken.msh"
    path.write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 2")
    with pytest.raises(MeshError, match="broken.msh"):
        read_gmsh(path)
    with pytest.raises(MeshError, match=r"broken.msh is a finished mesh.*\['h'\]"):
        read_gmsh(path, h=0.1)


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_a_finished_mesh_has_its_edges_halved(dim: int, shared_tmp: Path) -> None:
    """Four or eight cells for each, twice over; the same surfaces with the same areas and centres, where it was placed."""
    file = shared_tmp / f"rod_{dim}.msh"
    if MPI.COMM_WORLD.rank == 0:
        write_rod(file, dim)
    MPI.COMM_WORLD.barrier()
    turned = 0.3 if dim == 2 else Rotation.from_rotvec((0.1, 0.2, 0.3)).as_matrix()
    mesh = read_gmsh(file).placed((1.0, 2.0, 3.0)[:dim], turned)
    fine = mesh.refined().refined()
    cells = [m.dolfinx.topology.index_map(dim).size_global for m in (mesh, fine)]
    assert cells[1] == 4**dim * cells[0]
    assert fine.surface_names == mesh.surface_names

    coarse, halved = (Field("rod", m, elastic_rod(m, degree=1).forms()) for m in (mesh, fine))
    assert halved.mass_total == pytest.approx(coarse.mass_total, rel=1e-13)
    for name in mesh.surface_names:
        before, after = coarse.moments(name), halved.moments(name)
        assert after.area == pytest.approx(before.area, rel=1e-13)
        assert after.center == pytest.approx(before.center, abs=1e-13)


ROUND = """
Point(1) = {0, 0, 0}; Point(2) = {100, 0, 0}; Point(3) = {-100, 0, 0};
Circle(1) = {2, 1, 3}; Circle(2) = {3, 1, 2};
Curve Loop(1) = {1, 2}; Plane Surface(1) = {1};
Physical Surface("disc") = {1}; Physical Curve("rim") = {1, 2};
Mesh.MeshSizeMax = 60;
Mesh 2;
"""
SCRIPT = """
def build(gmsh, size=60.0):
    disc = gmsh.model.occ.addDisk(0, 0, 0, 100, 100)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [disc], name="disc")
    gmsh.model.addPhysicalGroup(1, [1], name="rim")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.model.mesh.generate(2)
"""


def test_a_geo_file_that_does_not_mesh_itself_is_meshed(shared_tmp: Path) -> None:
    """As by gmsh's own command line, with the sizes that it states."""
    cells = []
    for name, text in (("meshed.geo", ROUND), ("shape.geo", ROUND.replace("Mesh 2;\n", ""))):
        file = shared_tmp / name
        file.write_text(text)
        cells.append(read_gmsh(file).dolfinx.topology.index_map(2).size_global)
    assert cells[0] == cells[1] > 0


@pytest.mark.parametrize(("name", "text"), [("disc.geo", ROUND), ("disc.py", SCRIPT)])
def test_halved_edges_of_a_round_shape_in_millimetres_meet_it(name: str, text: str, shared_tmp: Path) -> None:
    """They were put on the shape in mm of a mesh in m, a disc of 98 m; scripts without a cell size ``h`` were not refined."""
    from dolfinx import fem

    file = shared_tmp / name
    file.write_text(text)
    mesh = read_gmsh(file, scale=1e-3)
    missing = []
    for _ in range(3):
        assert np.linalg.norm(mesh.dolfinx.geometry.x, axis=1).max() == pytest.approx(0.1, rel=1e-6)
        area = fem.assemble_scalar(fem.form(fem.Constant(mesh.dolfinx, 1.0) * mesh.dx))
        missing.append(np.pi * 0.01 - area)
        mesh = mesh.refined()
    assert missing[0] / missing[1] == pytest.approx(4.0, rel=0.1) and missing[1] / missing[2] == pytest.approx(
        4.0, rel=0.1
    )


CURVED = """
def build(gmsh):
    gmsh.model.occ.addDisk(0, 0, 0, 1, 1), gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [1], name="disc")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
    gmsh.model.mesh.generate(2), gmsh.model.mesh.setOrder(2)
"""


def test_halved_edges_of_curved_cells_are_curved(shared_tmp: Path) -> None:
    """They fall to the shape with the fourth power of their length; a finished mesh has no shape for them."""
    from dolfinx import fem

    script, finished = shared_tmp / "curved.py", shared_tmp / "curved.msh"
    script.write_text(CURVED)
    mesh, missing = read_gmsh(script), []
    for _ in range(2):
        assert mesh.dolfinx.geometry.cmap.degree == 2
        area = mesh.dolfinx.comm.allreduce(fem.assemble_scalar(fem.form(fem.Constant(mesh.dolfinx, 1.0) * mesh.dx)))
        missing.append(np.pi - area)
        mesh = mesh.refined()
    assert missing[0] / missing[1] == pytest.approx(16.0, rel=0.1)

    if MPI.COMM_WORLD.rank == 0:
        import gmsh

        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        runpy.run_path(str(script))["build"](gmsh)
        gmsh.write(str(finished))
        gmsh.finalize()
    MPI.COMM_WORLD.barrier()
    with pytest.raises(MeshError, match="order 2 cannot be halved"):
        read_gmsh(finished).refined()


def write_rod(file: Path, dim: int) -> None:
    """The rod of meshes/rod.py as a finished mesh."""
    import gmsh

    script = runpy.run_path(str(HERE.parent / "meshes/rod.py"))
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    script["build"](gmsh, dim=dim, height=0.4, h=0.5)
    gmsh.write(str(file))
    gmsh.finalize()


@pytest.mark.mpi
@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["script", "finished"])
def test_a_mesh_in_millimetres(kind: str, shared_tmp: Path) -> None:
    """Script and file alike, their refined meshes too."""
    source: Any = HERE.parent / "meshes" / "rod.py"
    size: Any = {"dim": 2, "h": 0.5}
    if kind == "finished":
        source, size = shared_tmp / "rod.msh", {}
        if MPI.COMM_WORLD.rank == 0:
            write_rod(source, 2)
        MPI.COMM_WORLD.barrier()
    mesh = read_gmsh(source, scale=1e-3, **size)
    for made in (mesh, mesh.refined()):
        assert made.dolfinx.comm.allreduce(made.dolfinx.geometry.x.max(initial=0.0), MPI.MAX) == pytest.approx(1e-3)
    with pytest.raises(InputError, match="scale"):
        read_gmsh(source, scale=-1.0, **size)


def test_one_volume_of_several_brings_its_own_surfaces() -> None:
    mesh = read_gmsh(FAULTY, fault="two volumes", volume="plate 0")
    assert mesh.volume == "plate 0"
    assert mesh.surface_names == ["end"]
    assert read_gmsh(FAULTY, fault="two volumes", volume="plate 1").surface_names == []


GROUPS = """
SetFactory("OpenCASCADE");
Rectangle(1) = {0, 0, 0, 1, 0.2}; Rectangle(2) = {1, 0, 0, 1, 0.2};
BooleanFragments{ Surface{1}; Delete; }{ Surface{2}; Delete; }
Physical Surface("one") = {1}; Physical Surface("two") = {2};
middle() = Curve In BoundingBox{0.99, -1, -1, 1.01, 1, 1}; around() = Boundary{ Surface{1}; }; other() = Boundary{ Surface{2}; };
Physical Curve("middle") = {middle()};
Physical Curve("left") = Curve In BoundingBox{-0.1, -1, -1, 0.01, 1, 1};
Physical Curve("ends") = {Curve In BoundingBox{-0.1, -1, -1, 0.01, 1, 1}, Curve In BoundingBox{1.99, -1, -1, 2.1, 1, 1}};
Physical Curve("all") = {around(), other()};
Mesh.MeshSizeMax = 0.2; Mesh.ElementOrder = 2;
Mesh 2;
"""


@pytest.mark.mpi
@pytest.mark.parametrize("version", [2.2, 4.1])
def test_a_facet_may_be_in_several_groups_and_one_inside_is_in_none(version: float, shared_tmp: Path) -> None:
    """One of the groups lost it, and a load on a group inside the body was nothing, both in silence."""
    geo, file = shared_tmp / "groups.geo", shared_tmp / "groups.msh"
    if MPI.COMM_WORLD.rank == 0:
        import gmsh

        geo.write_text(GROUPS)
        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(geo))
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.write(str(file))
        gmsh.finalize()
    MPI.COMM_WORLD.barrier()

    mesh = read_gmsh(file, volume=("one", "two"))
    E, nu, p = 1e7, 0.3, 1e4
    sheet = fmbd.materials.plane_stress(E, nu)
    body = fmbd.AbsoluteBody("sheet", mesh, density=1.0, elastic=sheet, loads=[fmbd.pressure("all", p)])
    assert mesh.surface_names == ["all", "ends", "left"]
    known = Field("sheet", mesh, body.forms())
    assert [known.moments(name).area for name in mesh.surface_names] == pytest.approx([4.4, 0.4, 0.2], rel=1e-12)

    scene = fmbd.Scene("pressed from all sides")
    scene.add(body, fmbd.fixed("held", fmbd.ground, body.surface("left")))
    scene.sensor("ends", fmbd.position(body.surface("ends")))
    assert fmbd.equilibrium(scene)["ends"][0] == pytest.approx(1.0 - p * (1 - nu) / E, rel=1e-12)

    with pytest.raises(InputError, match=r'no surface "middle".*does not lie on the boundary of volume "one \+ two"'):
        inside = fmbd.AbsoluteBody("sheet", mesh, density=1.0, elastic=sheet, loads=[fmbd.pressure("middle", p)])
        fmbd.Scene("pushed inside").add(inside).build()


@pytest.mark.mpi
def test_points_outside_the_solid_are_left_out() -> None:
    mesh = read_gmsh(FAULTY, fault="lone point")
    assert mesh.dolfinx.comm.allreduce(float(mesh.dolfinx.geometry.x.max(initial=0.0))) < 3.0


@pytest.mark.mpi
def test_unknown_surface_lists_near_names(rod_mesh: Callable[..., Any]) -> None:
    with pytest.raises(InputError, match='No surface "tpi".*Did you mean "tip"'):
        rod_mesh(dim=2, h=0.5, height=0.4).surface_tag("tpi")


# -- programs: one message, an exit code, no hang ------------------------------------------------------------
SOLVE = """
import numpy as np
import fmbd_fenicsx as fmbd
mesh = fmbd.read_gmsh("meshes/rod.py", h=0.5, height=0.4)
rod = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=fmbd.materials.linear_elastic(5e6, 0.3))
scene = fmbd.Scene("bad")
scene.add(rod)
{line}
fmbd.solve(scene, t_end=0.02, dt=0.01)
"""
MISTAKES = {
    "missing file": ("import fmbd_fenicsx as f; f.read_gmsh('meshes/rood.py')", "rood.py does not exist"),
    "inverted": (
        "import fmbd_fenicsx as f; f.read_gmsh('tests/faulty.py', fault='inverted')",
        "are inverted",
    ),
    "solid forgotten": (
        "import fmbd_fenicsx as f; f.read_gmsh('tests/faulty.py', fault='solid forgotten')",
        "highest physical group has dimension 2",
    ),
    "unknown surface": (SOLVE.format(line="rod.surface('tpi')"), 'Did you mean "tip"'),
    "load": (
        SOLVE.format(line="scene.add(fmbd.force('wind', rod.surface('tip'), lambda t: (np.nan, 0.0)))"),
        'Force "wind"',
    ),
    "load on one rank": (
        SOLVE.format(
            line="from mpi4py import MPI\n"
            "bad = MPI.COMM_WORLD.rank == MPI.COMM_WORLD.size - 1\n"
            "scene.add(fmbd.force('gust', rod.surface('tip'), lambda t: (np.nan if bad else 0.0, 0.0)))"
        ),
        'force "gust" gives (0.0, 0.0) on rank 0',
    ),
    "initial displacement": (
        SOLVE.format(line="scene.bodies['rod'] = rod.with_(displacement=lambda x: np.where(x > 0.9, np.nan, 0 * x))"),
        '"rod": displacement',
    ),
}
PROGRAMS = ("inverted", "load on one rank")  # of the mesh, which rank 0 makes, and of a law that differs between ranks


@pytest.mark.mpi
@pytest.mark.parametrize("name", [name for name in MISTAKES if name not in PROGRAMS])
def test_mistakes_are_told_on_all_ranks(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(HERE.parent)
    code, words = MISTAKES[name]
    with pytest.raises(FmbdError, match=re.escape(words)):
        exec(code, {})  # noqa: S102


@pytest.mark.serial
@pytest.mark.parametrize("name", PROGRAMS)
def test_bad_input_ends_two_ranks_with_one_message(name: str) -> None:
    code, words = MISTAKES[name]
    done = launch(code, 2, timeout=60)
    assert done.returncode != 0
    # not from the start of a line on: what mpirun forwards of two ranks may begin in a line of its own words
    messages = re.findall(r"\bfmbd_fenicsx\.errors\.\w+: .*" + re.escape(words), done.stderr)
    assert len(messages) == 1, done.stderr


@pytest.mark.serial
def test_bad_input_ends_a_serial_program() -> None:
    done = launch(MISTAKES["missing file"][0], 1)
    assert done.returncode != 0
    assert done.stderr.count("MeshError: Mesh file meshes/rood.py does not exist") == 1


# -- environment ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("version", ["0.8.0", "0.5.2", "0.8.0.post1"])
def test_old_dolfinx_is_refused(version: str) -> None:
    with pytest.raises(FmbdError, match=f"DOLFINx {version} is too old.*0.9"):
        dolfinx_compat.refuse_unusable(version, "f")


@pytest.mark.parametrize("version", ["0.9.0", "0.10.0.post2", "0.11.0", "0.12.0.dev0", "1.0.0"])
def test_new_dolfinx_is_accepted(version: str) -> None:
    dolfinx_compat.refuse_unusable(version, "f")


def test_complex_petsc_is_refused() -> None:
    with pytest.raises(FmbdError, match="complex.*real build"):
        dolfinx_compat.refuse_unusable("0.9.0", "c")


def test_reader_asks_for_usable_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    """The refusal is reached before anything is read."""
    import dolfinx

    monkeypatch.setattr(dolfinx, "__version__", "0.8.1")
    with pytest.raises(FmbdError, match="0.8.1 is too old"):
        read_gmsh("meshes/rod.py", h=0.5)


def test_a_further_body_of_a_mesh_numbers_no_nodes(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor does it make more than a few cells, of which a tetrahedron is made with 74 others."""
    from dolfinx import fem

    mesh, cells, spaces = rod_mesh(dim=3, h=0.5, height=0.2), [], []
    anew, space = ufl.Cell.__init__, fem.functionspace
    monkeypatch.setattr(ufl.Cell, "__init__", lambda cell, name: cells.append(name) or anew(cell, name))
    monkeypatch.setattr(fem, "functionspace", lambda *given: spaces.append(given) or space(*given))

    for place in (0.0, 2.0):
        cells.clear(), spaces.clear()
        scene = fmbd.Scene("one")
        scene.add(elastic_rod(mesh.placed((0.0, place, 0.0))))
        scene.build()
    assert not spaces
    assert len(cells) <= 4 * 75


def test_shapes_too_small_for_the_kernel_say_so() -> None:
    """Nanometres are drawn in larger units."""
    with pytest.raises(MeshError, match=r"block\.py: .*OpenCASCADE.*below 1e-7.*scale="):
        fmbd.read_gmsh("meshes/block.py", size=(1e-10, 1e-11), counts=(4, 1))
    assert fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.1), counts=(4, 1), scale=1e-10).surface_names
