"""Floating elastic fields in the driver's tables: their matrices, and the columns that their own factors have solved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import scipy.sparse as sp

from .....errors import ConvergenceError
from .....fem.factors.factor import address_of_solve
from .....kernel_cache import address_of
from .....mechanics.elastic.field_part import FieldPart
from .....mechanics.elastic.floating import FloatingField
from .....mechanics.validity import TOO_LARGE
from .....rotations import Array
from ..resting import RestingField, RestingPart
from ..structures import structure
from .field_forces import FieldForces, told_in_c
from .field_matrices import FieldMatrices, node_matrix
from .told import ToldMotion

if TYPE_CHECKING:
    from ..layout import TableLayout

FIELD_LIMIT = 50_000  # unknowns of a field: above, calls cost nothing, and the driver's copies of the matrices memory
SIZES = 9  # of steps, whose compliances are kept
VANISHING = 1e-9  # size of the column of a surface's port, against the largest
LEAST = 1e-10  # compliance of a combination of columns, against the largest
ROUNDOFF = 1e-13  # the same where none of them gives way: against those without the frame conditions


class Block(Protocol):
    """Factor and columns of a field for one size of a step: Y = E^-1 H and W = H^T Y of its inertia and of the ports
    ``used``; ``in_use`` of the part.
    """

    factor: Any
    used: np.ndarray
    Y: Array
    W: Array
    in_use: Any


class FieldTable:
    """One floating field as the structure Field of ``driver/tables.h``.

    Columns of H: those of inertia, the ports that the factor has solved for, then ports that are only read.
    """

    def __init__(self, tables: TableLayout, before: Sequence[FieldTable], k: int, block: Block) -> None:
        """Of part k; ``before``: the fields that are numbered before it, and so are their columns in arrays of all."""
        system = tables.system
        self.tables, self.number, self.k, self.block = tables, len(before), k, block
        self.parts = parts_of(block)
        self.part: Any = system.parts[k]
        self.rows = system.frame_rows[k]
        self.turns = isinstance(self.part, RestingField) and self.part.turns
        # what C does not know of a stiffened body is told with its inertia forces
        self.told = not told_in_c(system.cache, k, self.part)  # whether Python tells its forces
        self.whole = self.told and self.part.stiffening is not None
        self.changes = self.turns or self.told or self.part.slack is not None  # matrices with the steps that were made
        self.matrices = FieldMatrices(system.cache, self.part, k, tables.dim)
        self.forces_in_c = FieldForces(tables, self.part, k)

        first = system.port_slice(k).start
        seen = [x for x in np.unique(system.markers.port) - first if 0 <= x < self.part.n_port]
        self.ports = np.concatenate((block.used, np.setdiff1d(seen, block.used))).astype(int)
        inertial = self.inertial = self.part.inertia_columns.shape[1]
        self.solved, self.count = inertial + len(block.used), inertial + len(self.ports)
        self.column = sum(field.solved for field in before)
        conditions = np.arange(self.part.n_frame_rows)
        places = inertial + np.searchsorted(block.used, conditions)
        self.frame_slots = conditions if self.part.shared_columns else places

        self.port_matrix = np.zeros((self.part.n_port, self.count))
        self.port_matrix[self.ports, inertial + np.arange(len(self.ports))] = 1.0
        nothing: Array = np.zeros(0)
        self.b = self.z = self.force = self.sums = self.gap = nothing  # those of the structure
        self.wide = self.part.n + (self.part.field.n_pressure if self.part.field.mixed else 0)  # unknowns of the factor
        self.motion = ToldMotion(tables, self.part.n)
        self.c: Any = None  # the structure
        self.vectors: list[Any] = []  # PETSc's, on b and z
        self.indefinite = False
        self.moving: tuple[np.ndarray, ...] = ()  # columns of ports that move: places, entries and two rates of these
        self.of_tangent: dict[str, Array] = {}  # likewise, what changes with the tangent
        # of the factors in use, which sizes of steps come back to, and other tables
        self._condensed: dict[int, tuple[Array, CondensedColumns]] = system.cache.setdefault(("condensed", k), {})

    def solve(self) -> None:
        """z = E^-1 b, complex ones by their parts."""
        b, z = (x.reshape(self.parts, -1)[:, : self.part.n] for x in (self.b, self.z))
        z[:] = in_parts(self.block.factor.solve(b[0] if self.parts == 1 else b[0] + 1j * b[1]))

    def alike(self, block: Block) -> bool:
        """Whether another factor has solved for the same columns."""
        if parts_of(block) != self.parts:
            return False
        same = block.Y.shape == self.block.Y.shape and self.part.inertia_columns.shape[1] == self.inertial
        return same and np.array_equal(block.used, self.block.used) and block.in_use == self.block.in_use

    def take(self, block: Block) -> None:
        """Go on with another factor, and with the inertia of the frame that goes with it."""
        self.block = block
        for name, values in self._of_tangent().items():
            self.of_tangent[name][...] = values
        self.c.placed_at = np.nan
        self.matrices.take_slack(self.block.factor)
        self._lend()

    def _lend(self) -> None:
        """Let C solve with the factor by itself, where it can."""
        factor = self.block.factor
        solved = None if factor is None else factor.in_c()
        self.c.factor = None if solved is None else address_of(solved.matrix)
        if solved is None:
            return
        self.c.tangent = address_of(self.matrices.tangent())
        if self.part.field.mixed:
            self.matrices.of_pressure()
        self.c.by_component = int(solved.by_component)
        self.c.told, self.c.tolerance = address_of(factor.judge.told), factor.judge.tolerance
        self.c.of_mass[:], self.c.of_stiffness[:] = _parts(solved.mass), _parts(solved.stiffness)
        if solved.damping:
            self._lend_dampings(solved.damping)

    def _lend_dampings(self, c: complex) -> None:
        """Matrices that stand in the factor times c, beside M and K."""
        made = self.matrices.dampings()
        for i, one in enumerate(made):
            self.c.damping[i] = self.c.damping[i] or self.tables.store.structure(node_matrix(one, self.tables.dim))
            self.c.of_damping[2 * i : 2 * i + 2] = _parts(c)

    def _of_tangent(self) -> dict[str, Array]:
        """What changes with the tangent."""
        part, block = self.part, self.block
        inverse = self._inverse(block.W)
        self.indefinite = inverse.indefinite
        d = self.tables.dim
        moment = part.moment if part.column_version(0.0) else np.zeros(d)
        return {
            **{name: in_parts(getattr(inverse, name)) for name in "AWGS"}, "Y": in_parts(block.Y.T),
            "Q": part.inertia_columns.T, "inertia": part.inertia, "moment": moment,
            "began": part.began if self.turns else np.zeros((2, d, d)),
        } | ({} if part.stiffening is None else self._bent_tangent())  # fmt: skip

    def _bent_tangent(self) -> dict[str, Array]:
        """The same with stiffening: ports of second order, and what second-order displacements add to the frame's mass."""
        part = self.part
        bends = 0 if part.shortening is None else part.shortening.N.shape[1]
        return {
            "held": np.zeros((bends, part.n)) if part.shown is None else part.shown.slopes.T,
            "second": part.second_inertia,
        }

    def _inverse(self, W: Array) -> CondensedColumns:
        """The compliance W of a factor without the frame conditions; kept, as steps change between a few sizes."""
        known = self._condensed.pop(id(W), None)
        if known is None or known[0] is not W:
            known = W, CondensedColumns(W, self.frame_slots, self.inertial)
        self._condensed[id(W)] = known
        for old in list(self._condensed)[:-SIZES]:
            del self._condensed[old]
        return known[1]

    def forces(self, t: float) -> None:
        """Rows of the frame, in body axes but for the first of whole forces, and forces on the nodes."""
        motion, _, local = self.motion.at(t)
        told = self.part.force if self.whole else self.part.held_force
        self.sums[:], self.force[: self.part.n] = told(motion, local)
        if self.part.field.carried:
            self.gap[:] = self.part.field.volume_gap(local[0])

    def mean_forces(self, t: float) -> None:
        """Forces on the nodes over a step about t (s), its frame at rest; or their integrals from now on, where C knows them."""
        lent = self.forces_in_c.of_steps()
        if not lent:
            motion, _, local = self.motion.at(t)
            self.force[:] = self.part.mean_force(motion, local, self.tables.c.span)
        for name, value in lent.items():
            setattr(self.c, name, value)
        self.c.loaded_at = np.nan  # loads have further factors

    def energies(self, t: float) -> None:
        """Kinetic, elastic and weight energy."""
        motion, pose, local = self.motion.at(t)
        self.sums[:3] = self.part.energies(motion, pose, local[:2])

    # -- structures ----------------------------------------------------------------------------------------------------------
    def body(self) -> Any:
        """The structure Body."""
        tables = self.tables
        part = self.part
        system = tables.system
        frame, d = part.frame, tables.dim

        width = int(tables.width[frame])
        i, j = np.tril_indices(width)
        unknown = tables.at_u[frame] + np.arange(width)
        address = tables.store.structure(self._field())

        largest = np.inf if part.field.nonlinear else TOO_LARGE * part.size
        large = largest**2 * part.field.n_global / d
        stiffening = part.stiffening
        mean = np.zeros(0) if stiffening is None else stiffening.second.inverse

        return structure("Body", d)(
            modes=self.count, mean=tables.store.address(mean),
            at_v=system.slices[1][self.k].start, at_q=system.slices[0][self.k].start,
            at_u=int(tables.at_u[frame]), mass=part.mass_total, large=large,
            block=tables.store.address(np.zeros((width, width))),
            dest=tables.store.integers(tables.fronts.place(unknown[i], unknown[j])), field=address,
            mean_rates=None if part.mean_rates is None else tables.store.shared(part.mean_rates),
        )  # fmt: skip

    def _field(self) -> Any:
        """The structure Field."""
        part = self.part
        field = part.field
        tables = self.tables
        d = tables.dim
        store = tables.store
        n = self.part.n
        arrays = {
            **({} if part.moves_ports else self._columns_of_ports()), "X": field.X, "MX": field.mass(field.X), "T": np.eye(d),
            "asked": np.zeros(n + self.wide + d * d), "held_force": np.zeros(n), "held_sums": np.zeros(tables.twist),
            **{name: np.zeros(self.parts * self.count) for name in ("p", "rates", "pz", "rest", "f", "h")},
            **{name: np.zeros(n) for name in ("accel", "MU")},
        }  # fmt: skip
        of_tangent = {name: store.array(x) for name, x in self._of_tangent().items()}
        self.of_tangent = {name: x for name, (x, _) in of_tangent.items()}

        (self.b, b), (self.z, z) = (store.array(np.zeros(self.parts * self.wide)) for _ in range(2))
        self.force, force = store.array(np.zeros(self.parts * n))
        rhs, solution = self._vectors(self.b, self.z)
        (one, one_b), (found, one_z) = (store.array(np.zeros(n // d)) for _ in range(2))
        one_rhs, one_solution = self._vectors(one, found)
        self.sums, sums = store.array(np.zeros(max(tables.twist, 3)))

        self.c = structure("Field", d)(
            n=n, nodes=n // d, solved=self.solved, column=self.column, frames=part.n_frame_rows, row=self.rows.start,
            wide=self.wide, elastic=store.address(np.zeros(self.wide)), pressure=self._pressure(), rhs=rhs, solution=solution,
            one_b=one_b, one_z=one_z, one_rhs=one_rhs, one_solution=one_solution,
            direct=address_of_solve(), asked_at=np.nan, number=self.number, b=b, z=z,
            own=int(self.told), whole=int(self.whole), force=force, sums=sums, state=self.motion.address,
            inertial=self.inertial, turns=int(self.turns), parts=self.parts, frame_slot=store.integers(self.frame_slots),
            **{name: address for name, (_, address) in of_tangent.items()},
            **{name: store.integers(x) if x.dtype == np.int32 else store.address(x) for name, x in arrays.items()},
            **{name: store.shared(x) for name, x in self.matrices.of_nodes().items()},
            **self._residual(), **self._stiffening(), **self.forces_in_c.members(),
            **(self._moving_ports() if part.moves_ports else {}), **self.matrices.of_numbers(store, self.block.factor),
        )  # fmt: skip

        self._lend()
        self.sway(True)
        return self.c

    def _vectors(self, *arrays: Array) -> list[int]:
        """PETSc's vectors on arrays."""
        from petsc4py import PETSc

        made = [PETSc.Vec().createWithArray(x, comm=PETSc.COMM_SELF) for x in arrays]
        self.vectors += made
        return [x.handle for x in made]

    def _residual(self) -> dict[str, int]:
        """Room for the residual of a solution, and for the change that it asks for where the pressure is an unknown."""
        size = self.parts * self.wide
        (left, at_left), (more, at_more) = (self.tables.store.array(np.zeros(size)) for _ in range(2))
        if not self.part.field.carried:
            return {"left": at_left}
        residual, change = self._vectors(left, more)
        return {"left": at_left, "more": at_more, "residual": residual, "change": change}

    def _pressure(self) -> int | None:
        """The structure Pressure of a field that has one."""
        if not self.part.field.mixed:
            return None
        field, store = self.part.field, self.tables.store
        (b, at_b), (x, at_x), (gap, at_gap) = (store.array(np.zeros(field.n_pressure)) for _ in range(3))
        rhs, solution = self._vectors(b, x)
        unknown = {}
        if field.carried:  # C moves that of the field itself
            self.gap = gap
            unknown = {"gap": at_gap, "began": store.address(np.zeros(field.n_pressure))}

        rows = {name: store.shared(x) for name, x in self.matrices.of_pressure().items()}
        factor = store.array([field.compliance_factor.handle], np.uint64)[1]
        made = structure("Pressure", self.tables.dim)(
            n=field.n_pressure,
            b=at_b,
            x=at_x,
            p=address_of(field.pressure_array) if field.carried else at_x,
            factor=factor,
            rhs=rhs,
            solution=solution,
            keeps_volume=int(field.keeps_volume),
            **unknown,
            **rows,
            **self.forces_in_c.of_pressure(),
        )
        return store.structure(made)

    @property
    def remembers(self) -> int:
        """Whether forces depend on more than a state: on a pressure that is an unknown."""
        return int(self.part.field.carried)

    def sway(self, corrected: bool) -> None:
        """Whether solutions correct moments on the frame that columns of inertia leave out, see ``driver/fields/condensed.c``."""
        self.c.sways = int(corrected and self.part.shared_columns)

    def move(self, t: float) -> None:
        """Ports that move, where they are at a time (s), and what follows from their columns."""
        on, *entries = self.part.port_entries(self.ports, t)
        for array, values in zip(self.moving, (on, *entries), strict=True):
            array[:] = values.ravel()

        k = self.solved
        if not k:
            return
        H = np.zeros((self.part.n, k))
        H[on[:k], np.arange(k)[:, None]] = entries[0][:k]
        Y = self.block.factor.solve_columns(H)
        inverse = CondensedColumns(H.T @ Y, self.frame_slots, self.inertial)
        self.of_tangent["S"][...], self.of_tangent["Y"][...] = in_parts(inverse.S), in_parts(Y.T)

    def _moving_ports(self) -> dict[str, int | float]:
        """Room for the columns of ports that move; there are no others."""
        store, (on, *entries) = self.tables.store, self.part.port_entries(self.ports, 0.0)
        places, made = store.array(on.ravel(), np.int32), [store.array(x.ravel()) for x in entries]
        self.moving = places[0], *[x for x, _ in made]
        port, drift, curve = (at for _, at in made)
        start = store.integers(np.arange(len(on) + 1) * on.shape[1])
        moves: dict[str, int | float] = {}
        if len(on):
            moved, bias = (store.address(np.zeros(self.count)) for _ in range(2))
            moves = {"drift": drift, "curve": curve, "moved": moved, "bias": bias, "placed_at": np.nan}
        return {"port": port, "port_on": places[1], "port_start": start, **moves}

    def _columns_of_ports(self) -> dict[str, np.ndarray]:
        """The columns of ports, of the body that is not bent."""
        ports = sp.csc_matrix(FieldPart.port_columns(self.part, self.ports, 0.0))
        return {
            "port": ports.data,
            "port_start": ports.indptr.astype(np.int32),
            "port_on": ports.indices.astype(np.int32),
        }

    def _stiffening(self) -> dict[str, int]:
        """What a field with stiffening has beside, see ``driver/fields/stiffened.c``."""
        part, d = self.part, self.tables.dim
        if part.stiffening is None:
            return {}
        store, stiffening = self.tables.store, part.stiffening
        pattern, entries = stiffening.entries
        first = d + d * d
        bends = 0 if part.shortening is None else part.shortening.N.shape[1]
        entries = entries[:, first : first + bends] if self.told else entries
        stresses = 0 if self.told else first

        N = np.zeros((self.count, bends))
        if part.shortening is not None:
            N[self.inertial :] = part.shortening.N[self.ports]
        second, k = stiffening.second, entries.shape[1]
        arrays = {
            "N": N, "bent": np.zeros((part.n, k)), "form": np.zeros((3, k)), "bias": np.zeros(self.count),
            "pull": np.zeros(bends), "one": stiffening.first[:: d, 0], "first": np.concatenate((second.S0, second.X0.ravel())),
        }  # fmt: skip
        return {
            "stresses": stresses, "bends": bends, "stress": store.shared(entries),
            "stress_start": store.integers(pattern.indptr), "stress_column": store.integers(pattern.indices),
            **{name: store.address(x) for name, x in arrays.items()},
        }  # fmt: skip


class CondensedColumns:
    """What equation (2) of ``driver/fields/fields.c`` knows of the columns of H: S, the inverse of their compliance with the
    frame conditions solved.

    W: H^T E^-1 H. ``at``: columns of the frame conditions. ``inertial``: how many columns are those of inertia.
    """

    def __init__(self, W: Array, at: np.ndarray, inertial: int) -> None:
        if not np.isfinite(W).all():
            raise ConvergenceError("The tangent of a field is not finite where an iteration led.")
        self.A = np.linalg.inv(W[np.ix_(at, at)])
        self.W = W[:, at]
        self.G = self.A @ W[at]
        compliance = W - self.W @ self.G

        # columns at one scale; those of ports that vanish have that of the smallest one. Frame conditions are no measure for
        # the others: they are large where a body's mass is a large number. Bodies that are pressed give way: negative ones
        size = np.sqrt(np.abs(W.diagonal()))
        ports = np.arange(len(W)) >= inertial
        ports[at] = False
        vanishes = ports & (size <= VANISHING * size[ports].max(initial=0.0))
        size[vanishes] = size[ports & ~vanishes].min(initial=np.inf)
        scaled = compliance / np.outer(size, size)
        scaled = 0.5 * (scaled + scaled.T)  # S is taken by its lower half and as a whole

        if np.iscomplexobj(W):
            left, share, right = np.linalg.svd(scaled)
            stiffness = 1.0 / np.maximum(share, _least(share))
            found = (right.conj().T * stiffness) @ left.conj().T / np.outer(size, size)
            self.indefinite, self.S = False, 0.5 * (found + found.T)
            return
        # negative ones are those of bodies that buckle
        share, directions = np.linalg.eigh(scaled)
        least = _least(share)
        stiffness = 1.0 / np.where(np.abs(share) > least, share, least)
        self.indefinite = bool((share < -least).any())
        self.S = (directions * stiffness) @ directions.T / np.outer(size, size)


def _least(share: Array) -> float:
    """What counts as a compliance, by those of all combinations of columns, whose sizes are 1 without the frame conditions."""
    largest = float(np.abs(share).max(initial=0.0))
    return LEAST * (largest if largest > ROUNDOFF else 1.0)


def parts_of(block: Block) -> int:
    """Of the numbers of a factor: 2 where they are complex."""
    return 1 + np.iscomplexobj(block.W)


def in_parts(x: Array) -> Array:
    """A complex array as its real part and behind it its imaginary one; a real one as it is."""
    return np.stack((x.real, x.imag)) if np.iscomplexobj(x) else x


def _parts(c: complex) -> tuple[float, float]:
    """The real and the imaginary part."""
    return complex(c).real, complex(c).imag


def known_field(part: Any) -> bool:
    """Whether the driver takes a part with a field, floating or at rest: on one rank, of moderate size."""
    if type(part) not in (FloatingField, RestingField, RestingPart) or (
        part.field.carried and address_of_solve() is None
    ):
        return False
    return part.comm.size == 1 and part.n <= FIELD_LIMIT  # type: ignore[no-any-return]
