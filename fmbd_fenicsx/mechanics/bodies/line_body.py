"""Planar lines by a user's own weak form: beams, cables and the like on an interval mesh, with large rotations.

A line has the fields z(s) = (x, y, theta, ...) over 0 <= s <= length: the place of its sections in world axes (m), the angle of
a section (rad), and what else the user needs. Its motion follows from two forms of the user,

    int m(z'', w) ds  +  dPi(z)[w]  =  loads,          m bilinear and constant, Pi the energy in J                      (1)

Ends are the surfaces "start" and "end": rigid sections at (x, y) that turn with theta, for joints, forces and sensors as on any
body. Lines are small: every rank holds all of it, and its matrices belong to the core of the system.

The energy is integrated with ``degree`` Gauss points in each cell: the reduced rule that keeps shear and stretch of curved
configurations from locking. Masses are integrated exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ... import dolfinx_compat as compat
from ...checks import check_fields, number, whole
from ...errors import CallbackError, InputError, floats, named, near, require
from ...fem.given_numbers import GivenNumbers
from ...rotations import Array
from ..body import LINES, Body, Placed, Site
from ..placements import FrameMotion, Part
from .bodies import Surface

ENDS = ("start", "end")


@dataclass(frozen=True, eq=False)
class LineBody(Body):
    """A planar line by its own weak form, equation (1) of ``mechanics.bodies.line_body``.

    Args:
        name: what messages call it. Its surfaces are the end sections "start" and "end".
        length: of the interval, m.
        mass: bilinear form m(z, w, ds) in UFL, symmetric; z'' in the place of z gives the inertia.
        energy: Pi(z, ds) in UFL, J.
        start: z at the start, a function of s (n,) -> (fields, n); its first three rows are x, y (m) and theta (rad).
        start_rate: z' at the start, likewise; None for rest.
        cells, degree: of the mesh and of the Lagrange elements.
        mass_damping: alpha (1/s): forces alpha m(z', w).
    """

    framed = False
    by_section = interpolated = True
    stage = LINES

    name: str
    length: float
    mass: Callable[[Any, Any, Any], Any]
    energy: Callable[[Any, Any], Any]
    start: Callable[[Array], Any]
    start_rate: Callable[[Array], Any] | None = None
    cells: int = 20
    degree: int = 2
    mass_damping: float = 0.0
    dim: int = field(init=False, default=2)

    @property
    def keeps_energy(self) -> bool:
        """Without damping."""
        return not self.mass_damping

    def placed(self, site: Site) -> Placed:
        """The line as a part on the ground."""
        line = LinePart(self, site.ground, site.surfaces)
        return Placed(line, line.start, line.start_rate)

    def __post_init__(self) -> None:
        what = f'Line "{self.name}"'
        check_fields(self, what)
        number(f"{what}: length", self.length, above=0.0, unit="m")
        whole(f"{what}: cells", self.cells, least=1)
        whole(f"{what}: degree", self.degree, least=1)
        number(f"{what}: mass_damping", self.mass_damping, least=0.0)

    def surface(self, name: str) -> Surface:
        """An end section: "start" or "end"."""
        if name not in ENDS:
            raise InputError(f'Line "{self.name}": no surface "{name}". {near(name, list(ENDS))}')
        return Surface(self, name)

    def with_finer_space(self, *, higher: bool) -> LineBody:
        """The same line with twice the cells."""
        return replace(self, cells=2 * self.cells)

    def curve(self, coordinates: Array, per_cell: int = 8) -> Array:
        """The fields z along the line, between the nodes by the elements' own polynomials: for pictures and for places on it.

        Args:
            coordinates: nodal values (..., nodes * fields): ``run["nodes"]`` of the sensor :func:`~fmbd_fenicsx.coordinates`.
            per_cell: places in each cell, evenly spaced; the end of the line is one more.

        Returns:
            z at s = 0 ... length, (..., cells * per_cell + 1, fields).
        """
        values = np.asarray(coordinates, dtype=float)
        along = np.argsort(self._nodes)
        require(
            values.shape[-1] % len(along) == 0,
            f'Line "{self.name}": curve takes the values of {len(along)} nodes, found {values.shape[-1]} numbers.',
        )
        values = values.reshape(*values.shape[:-1], len(along), -1)[..., along, :]

        # Lagrange's polynomials of the nodes of each cell
        places = [_cell_values(self._nodes[along], values, self.degree, c, per_cell) for c in range(self.cells)]
        return np.concatenate([*places, values[..., -1:, :]], axis=-2)

    @cached_property
    def _nodes(self) -> Array:
        """Places s of the nodes, in the order of the coordinates, (nodes,)."""
        return np.asarray(_space(self, 1).tabulate_dof_coordinates()[:, 0])


def _space(body: LineBody, fields: int) -> Any:
    """The elements of a line, on a mesh of its own on every rank."""
    from dolfinx import fem, mesh
    from mpi4py import MPI

    line = mesh.create_interval(MPI.COMM_SELF, body.cells, [0.0, body.length])

    return fem.functionspace(line, ("Lagrange", body.degree, (fields,)))


def _cell_values(s: Array, values: Array, degree: int, cell: int, count: int) -> Array:
    """Values (..., count, fields) at even places of a cell without its end; nodes ``s`` and ``values`` in order."""
    own = slice(degree * cell, degree * (cell + 1) + 1)
    nodes = s[own]
    at = nodes[0] + (nodes[-1] - nodes[0]) * np.arange(count) / count

    shape = np.ones((count, degree + 1))
    for k in range(degree + 1):
        for m in range(degree + 1):
            if m != k:
                shape[:, k] *= (at - nodes[m]) / (nodes[k] - nodes[m])
    return np.asarray(shape @ values[..., own, :])


class LinePart(Part):
    """A line as a replicated part of a system: local coordinates are the nodal values of z, in world axes.

    Ports: at each end in use x, y, the turn since the start, and three zeros (the size of any other surface).
    """

    of_time = False

    def __init__(self, body: LineBody, frame: int, surfaces: list[str]) -> None:
        self.body, self.name, self.frame = body, body.name, frame
        self._forms()
        self.start, self.start_rate = self._nodal("start", body.start), self._nodal("start_rate", body.start_rate)
        self._place(self.start)

        value = self._scalar(self._energy)
        if not np.isfinite(value):
            raise InputError(f'Line "{self.name}": its energy is {value} J at the start.')

        # ports of an end: x, y, and its turn since the start
        self.n_port = 6 * len(surfaces)
        self.port_matrix, self.reference = np.zeros((self.n_port, self.n)), np.zeros(self.n_port)
        for k, name in enumerate(surfaces):
            node = self._ends[name]
            self.port_matrix[6 * k + np.arange(3), node + np.arange(3)] = 1.0
            self.reference[6 * k + 2] = -self.start[node + 2]

        self.mass_total = float(self._weight[0].sum())
        self.size = body.length

    def _forms(self) -> None:
        """Mesh, space and compiled forms; the mass matrix."""
        import ufl
        from dolfinx import fem

        compat.check_versions()
        b = self.body
        count = np.shape(self._asked("start", b.start, np.zeros(1)))[0]
        require(count >= 3, f'Line "{b.name}": start(s) must give x, y and theta at least, found {count} rows.')
        self.fields = count
        self.space = _space(b, count)
        self.s = self.space.tabulate_dof_coordinates()[:, 0]
        self.n = len(self.s) * count
        self._ends = {"start": count * int(np.argmin(self.s)), "end": count * int(np.argmax(self.s))}

        z = ufl.TrialFunction(self.space)
        w = ufl.TestFunction(self.space)
        dz = ufl.TrialFunction(self.space)
        ds = ufl.Measure("dx", domain=self.space.mesh)
        try:
            mass = compat.form(b.mass(z, w, ds))
            M = fem.assemble_matrix(mass)
            self.M = self.constant_mass = M.to_dense()
            self._z = fem.Function(self.space)
            # reduced integration: full would lock thin lines
            energy = b.energy(self._z, ds(metadata={"quadrature_degree": 2 * b.degree - 1}))
            force = ufl.derivative(energy, self._z, w)
            self._energy, self._force, self._stiffness = (
                compat.form(x) for x in (energy, force, ufl.derivative(force, self._z, dz))
            )
        except Exception as error:
            raise InputError(
                f'Line "{b.name}": mass(z, w, ds) must be a bilinear form and energy(z, ds) a form of rank 0: '
                f"{type(error).__name__}: {error}"
            ) from error

        self.numbers = GivenNumbers(self.space.mesh.comm, (mass, self._energy), (self._z,))
        self._add_force, self._values = compat.assembly_of(self._force), self._z.x.array
        self._K = fem.create_matrix(self._stiffness)
        if np.abs(self.M - self.M.T).max() > 1e-10 * np.abs(self.M).max():
            raise InputError(f'Line "{b.name}": its mass form is not symmetric.')

        unit = np.zeros((2, self.n))
        unit[0, 0::count], unit[1, 1::count] = 1.0, 1.0
        self._weight = unit @ self.M  # rows: what gravity along x and y does

    def _asked(self, what: str, function: Callable[[Array], Any], s: Array) -> Array:
        """What a function of the user's gives at places s, numbers in rows."""
        given = named(f"The {what} of line", self.body.name, function, time=None)(s)
        try:
            found: Array = floats(given)
        except (TypeError, ValueError):
            found = np.zeros(0)
        if found.ndim != 2:
            raise CallbackError(f'Line "{self.body.name}": {what}(s) returned {given!r:.80}, expected rows of numbers.')
        return found

    def _nodal(self, what: str, function: Callable[[Array], Any] | None) -> Array:
        """Nodal values of z(s)."""
        if function is None:
            return np.zeros(self.n)
        found = self._asked(what, function, self.s)
        if found.shape != (self.fields, len(self.s)) or not np.isfinite(found).all():
            raise CallbackError(
                f'Line "{self.name}": start functions must return {self.fields} finite rows of one value for each s; '
                f"found shape {found.shape}."
            )
        return found.T.ravel().copy()

    def _place(self, z: Array) -> None:
        self._values[:] = z

    @staticmethod
    def _scalar(form: Any) -> float:
        from dolfinx import fem

        return float(fem.assemble_scalar(form))

    @cached_property
    def _at(self) -> dict[str, Array]:
        return {name: self.start[k : k + 2].copy() for name, k in self._ends.items()}

    # -- ports --------------------------------------------------------------------------------------------------
    def surface_center(self, surface: str) -> Array:
        """Place of an end section at the start, world axes."""
        return self._at[surface]

    def lengths(self, length: float) -> Array:
        """The angles of sections count at the model's length."""
        out = np.ones(self.n)
        out[2 :: self.fields] = length
        return out

    # -- mechanics ----------------------------------------------------------------------------------------------
    def force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Rows of (1): inertia, energy and weight."""
        z, v, a = local
        self._place(z)
        alpha = self.body.mass_damping
        rows = self.M @ (a + alpha * v if alpha else a) - motion.gravity @ self._weight
        self._add_force(rows)
        return np.zeros(len(motion.twist)), rows  # which enters no Python

    def given(self, motion: FrameMotion, local: tuple[Array, Array]) -> dict[str, float] | None:
        """Power (W) of damping."""
        alpha = self.body.mass_damping

        return {"damping": -alpha * float(local[1] @ self.M @ local[1])} if alpha else {}

    def mass_blocks(self, motion: FrameMotion, u: Array) -> tuple[Array, Array, Array]:
        """M, constant."""
        n = len(motion.twist)
        return np.zeros((n, n)), np.zeros((self.n, n)), self.M

    def stiffness_blocks(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Second derivative of the energy, and the damping."""
        from dolfinx import fem

        self._place(local[0])
        self._K.set_value(0.0)
        fem.assemble_matrix(self._K, self._stiffness)
        return self._K.to_dense(), self.body.mass_damping * self.M

    def energies(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[float, float, float]:
        """Kinetic, elastic and weight energy, J."""
        z, v = local
        self._place(z)
        weight = -float(motion.gravity @ self._weight @ z)
        return 0.5 * float(v @ self.M @ v), self._scalar(self._energy), weight

    def momenta(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """Linear momentum, and angular momentum about the world origin with the spin of the sections."""
        z = local[0].reshape(-1, self.fields)
        p = (self.M @ local[1]).reshape(-1, self.fields)
        # of places, and of the sections themselves
        spin = z[:, 0] @ p[:, 1] - z[:, 1] @ p[:, 0] + p[:, 2].sum()
        return p[:, :2].sum(0), np.array([float(spin)])
