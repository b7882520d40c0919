"""The arrays of one system as the compiled step (``step.c``) reads them.

A system is bodies (rigid, reduced or floating, each with its frame), markers, and rows of elementary constraints between
markers. The rows' factor is kept in profile storage after a reverse Cuthill-McKee order. A floating body has its factor and
constant columns from the :class:`~fmbd_fenicsx.linear.condensation.StepSolver`, which solves, and judges, for the kernel too.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import reverse_cuthill_mckee

from ...linear.blocks.field_blocks import Block
from ...mechanics.bodies.floating import FloatingField
from ...mechanics.joints import constraints as ct
from ...mechanics.reduction.reduced import ReducedPart
from ...mechanics.validity import TOO_LARGE
from ...rotations import Array
from ...system.compiled.bodies import modal_arrays
from ...system.system import System
from .compiled import library

KINDS = {ct.Coincident: 0, ct.Along: 1, ct.Perpendicular: 2, ct.Turned: 2, ct.Distance: 3}
PROFILE_LIMIT = 4_000_000  # entries of the factor
FIELD_LIMIT = 50_000  # unknowns of a field: above, calls cost nothing, and the kernel's copies of the matrices memory
FRAME_ROW = 4  # kind of a frame condition
LOOK = 3  # verdict: something to be warned of or refused by the NumPy path
# fmt: off
(H, AM, AF, GAMMA, BETA, GX, GY, GZ, TOL, FLOOR, LENGTH, THETA, SLOW, MAXIT, HISTORY, PATIENCE, NEW_TANGENT,
 FAR, ITERATIONS, LOCAL, RESIDUAL, LEFT) = range(22)
# fmt: on


def _structure(name: str, dim: int = 0) -> type[ctypes.Structure]:
    """The C structures Body, Marker (for its dimension) and System."""
    i, r, p, n = ctypes.c_int, ctypes.c_double, ctypes.c_void_p, ctypes.c_long
    rot = max(2 * dim - 3, 0)
    fields: dict[str, list[tuple[str, Any]]] = {
        "Field": [("n", n), ("nodes", n), ("solved", i), ("frames", i), ("row", i), ("sways", i), ("frame_slot", p)]
        + [(x, p) for x in ("X", "Q", "port", "Y", "HY", "inertia", "moment", "port_start", "port_col")]
        + [(x, p) for x in ("M_start", "M_col", "K_start", "K_col", "M", "K")]
        + [("beta", r), *((x, p) for x in ("B", "A", "b", "z", "h", "zh", "MU"))]
        + [("R", r * dim**2), ("L", r * (dim + rot) ** 2), ("solve", p)],
        "Body": [(x, i) for x in ("m", "at_v", "at_q", "at_x")]
        + [(x, r) for x in ("mass", "large", "spin")]
        + [(x, p) for x in ("inertia", "S", "T", "V", "modal", "K", "C", "stress", "chol", "U", "now", "field")],
        "Marker": [("frame", i), ("surface", i), ("reference", p), ("ports", p)]
        + [("bends", i), ("N", p), ("G", p), ("now", p), ("row", r * (dim + rot)), ("pull", r * (dim + rot))]
        + [("slot", p), ("p", r * dim)]
        + [("x", r * dim), ("arm", r * dim), ("R", r * dim**2)]
        + [("lever", r * dim), ("turn", r * dim**2), ("Z", r * rot**2)],
        "System": [(x, i) for x in ("nb", "markers", "m", "nc", "n", "nq", "n_core", "n_x")]
        + [(x, n) for x in ("profile_size", "jac_size")]
        + [(x, p) for x in ("body", "marker", "kind", "ma", "mb", "e", "e1", "f", "length", "order", "first", "start")]
        + [
            (x, p)
            for x in ("ci", "cj", "cdest", "on", "js", "profile", "jac", "tangent", "W", "g", "y", "R", "work", "units")
        ],
    }
    return type(name, (ctypes.Structure,), {"_fields_": fields[name]})


def supports(system: System) -> bool:
    """Whether the kernel covers a system: rigid, reduced and floating bodies, the elementary constraints, gravity."""
    parts: tuple[Any, ...] = system.parts
    known = all(
        _plain_field(p) if type(p) is FloatingField else type(p) is ReducedPart and not p.constants.loads for p in parts
    )
    plain = system.markers.section is None and not (
        system.forces or system.elements or system.contacts or system.port_constraints or system.traces
    )
    kinds = all(type(batch) in KINDS for batch, _ in system.batches)
    return known and plain and kinds and system.n_frames > 0


def _plain_field(part: Any) -> bool:
    """A linear field on one rank, of moderate size, with its own mass and nothing but damping by stiffness."""
    f, forms = part.field, part.field.forms
    special = f.nonlinear or f.mixed or f.redistributed or f.D is not None or f.loads.loads or part.traces
    small = part.comm.size == 1 and part.n <= FIELD_LIMIT
    return small and not special and part.stiffening is None and not forms.mass_damping


class Kernel:
    """The arrays of one system, and its steps; ``blocks``: factors and columns of the fields for the step size."""

    def __init__(self, system: System, lib: Any, blocks: list[Block] | None = None) -> None:
        self.system, self.lib, self.blocks = system, lib, blocks
        self.error: Exception | None = None
        self.n, self.nq, self.m = system.n_v, system.n_q, system.n_lam
        self.block_size = 1 + self.nq + 3 * self.n + self.m
        self._kept: list[Any] = []
        nb, d = system.n_frames, system.motions.dim
        self.parts = {p.frame: (k, p) for k, p in enumerate(system.parts) if isinstance(p, ReducedPart)}
        self.fields = {
            f.frame: FieldColumns(system, i, f, blocks[i]) for i, (_, f) in enumerate(system.fields) if blocks
        }
        modes = {b: p.n for b, (_, p) in self.parts.items()} | {b: f.count for b, f in self.fields.items()}
        widths = np.array([system.motions.n_twist + modes.get(b, 0) for b in range(nb)])
        self.bodies = self._bodies(widths)
        numbers = [x for batch, _ in system.batches for x in (*batch.a, *batch.b)]
        used = np.unique(np.array(numbers, dtype=int))
        arrays = self._rows(used)
        frame = np.append(system.markers.frame[used], nb)  # a row without markers does not exist
        fa, fb = frame[arrays["ma"]], frame[arrays["mb"]]
        for b, f in self.fields.items():
            rows = system.frame_rows[f.number]
            fa[rows], fb[rows], arrays["kind"][rows], arrays["ma"][rows] = b, nb, FRAME_ROW, f.frame_slots
        sides = np.stack((fa, fb), axis=1).ravel()
        wide = np.append(widths, 0)[sides]
        arrays["on"] = sides.astype(np.int32)
        arrays["js"] = np.where(sides < nb, np.cumsum(wide) - wide, -1).astype(np.int64)
        order, first, start, self.size = _profile(nb, self.m, fa, fb)
        ci, cj, cdest = _contributions(nb, fa, fb, order, first, start)
        arrays |= {"order": order, "first": first, "start": start, "ci": ci, "cj": cj, "cdest": cdest}
        jac = int(wide.sum())
        sizes = {"profile": self.size, "jac": jac, "tangent": jac, "W": jac, "g": self.m, "y": self.m}
        arrays |= {k: np.zeros(max(x, 1)) for k, x in sizes.items()}
        arrays["work"] = np.zeros(4 * self.n + 2 * (int(widths.sum()) + self.m))
        arrays["R"] = np.tile(np.eye(d), (nb + 1, 1, 1))
        arrays["units"] = np.array(system.units, dtype=float)
        counts = (nb, len(used), self.m, len(ci), self.n, self.nq, system.n_core, int(widths.sum()), self.size, jac)
        pointers = {k: self._keep(x) for k, x in arrays.items()}
        markers = self._markers(used)
        body, marker = ctypes.addressof(self.bodies), ctypes.addressof(markers)
        self.c = _structure("System")(*counts, body=body, marker=marker, **pointers)
        self._kept.append(markers)
        self.address = ctypes.addressof(self.c)
        self.parameters, self.offset = np.zeros(22), np.zeros(max(self.m, 1))
        self.driven = [(batch, rows) for batch, rows in system.batches if batch.driven]
        self.look()

    def _keep(self, x: Array | np.ndarray) -> int:
        """Address of a copy of an array that lives as long as the kernel."""
        self._kept.append(np.ascontiguousarray(x))
        return int(self._kept[-1].ctypes.data)

    def _bodies(self, widths: np.ndarray) -> Any:
        """All bodies, in the order of their frames."""
        s, d, made = self.system, self.system.motions.dim, []
        kind = _structure("Body")
        rigid = {} if s.rigid is None else {int(f): i for i, f in enumerate(s.rigid.frame)}
        for b, at in enumerate(np.cumsum(widths) - widths):
            if b in rigid:
                assert s.rigid is not None
                L = np.linalg.cholesky(s.rigid.matrices()[rigid[b]])
                L[range(len(L)), range(len(L))] = 1.0 / L.diagonal()
                made.append(
                    kind(
                        mass=float(s.rigid.mass[rigid[b]]),
                        at_x=int(at),
                        spin=np.inf,
                        inertia=self._keep(s.rigid.inertia[rigid[b]]),
                        chol=self._keep(L),
                    )
                )
                continue
            if b in self.fields:
                made.append(self._field(kind, b, int(at)))
                continue
            k, part = self.parts[b]
            c, m = part.constants, part.n
            arrays = modal_arrays(c, m, d) | {"chol": np.zeros((widths[b], widths[b]))}
            made.append(
                kind(
                    m=m,
                    at_v=s.slices[1][k].start,
                    at_q=s.slices[0][k].start,
                    at_x=int(at),
                    mass=c.mass,
                    large=(TOO_LARGE * c.size) ** 2 * c.mass,
                    **{n: self._keep(x) for n, x in arrays.items()},
                )
            )
        return (kind * len(made))(*made)

    def _field(self, kind: Any, b: int, at: int) -> Any:
        """A floating body: its field's arrays, and the call back that solves with its factor."""
        c, s = self.fields[b], self.system
        part, d = c.part, s.motions.dim
        b_, z = np.zeros(part.n), np.zeros(part.n)

        def solve(_: int) -> int:
            try:
                z[:] = c.block.factor.solve(b_)
            except Exception as error:
                self.error = error
                return 1
            return 0

        call = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int)(solve)
        arrays = c.arrays() | {"A": np.zeros(part.n), "h": np.zeros(c.count), "zh": np.zeros(c.count)}
        arrays["MU"] = np.zeros(part.n)
        pointers = {n: self._keep(x) for n, x in arrays.items()}
        f = _structure("Field", d)(
            n=part.n,
            nodes=part.n // d,
            solved=c.solved,
            frames=part.n_frame_rows,
            row=s.frame_rows[c.number].start,
            sways=int(part.shared_columns),
            beta=part.field.forms.stiffness_damping,
            b=b_.ctypes.data,
            z=z.ctypes.data,
            solve=ctypes.cast(call, ctypes.c_void_p),
            **pointers,
        )
        self._kept += [b_, z, call, f]
        mean = (TOO_LARGE * part.size) ** 2 * part.field.n_global / d
        return kind(
            m=c.count,
            at_v=s.slices[1][c.number].start,
            at_q=s.slices[0][c.number].start,
            at_x=at,
            mass=part.mass_total,
            large=mean,
            field=ctypes.addressof(f),
        )

    def look(self) -> None:
        """Take the angular velocities above which a body is to be warned of; those warned of have none."""
        for b, c in self.fields.items():
            self.bodies[b].spin = np.inf if c.part.warned else c.part.spin_to_check**2
        for b, (_, part) in self.parts.items():
            known = part.warned or part.constants.stiffening is not None
            self.bodies[b].spin = np.inf if known else part.first_frequency**2

    def _markers(self, used: np.ndarray) -> Any:
        """The markers that rows refer to."""
        s, mk, d = self.system, self.system.markers, self.system.motions.dim
        kind, made = _structure("Marker", d), []
        for i in used:
            one = kind(frame=int(mk.frame[i]), surface=int(i in mk.surface), p=(ctypes.c_double * d)(*mk.position[i]))
            if one.surface:
                on_field = one.frame in self.fields
                k = self.fields[one.frame].number if on_field else self.parts[one.frame][0]
                ports = mk.port[np.searchsorted(mk.surface, i)] - s.port_slice(k).start
                one.reference = self._keep(s.parts[k].reference[ports])
                if on_field:
                    one.slot = self._keep(self.fields[one.frame].slot[ports].astype(np.int32))
                else:
                    one.ports = self._keep(s.parts[k].port_matrix[ports])
                    self._bends(one, self.parts[one.frame][1], ports)
            made.append(one)
        return (kind * max(len(made), 1))(*made)

    def _bends(self, one: Any, part: ReducedPart, ports: np.ndarray) -> None:
        """What makes the ports of a marker of second order."""
        if part.shortening is None or part.shortening.G is None:
            return
        N = part.shortening.N[ports]
        mine = np.flatnonzero(np.abs(N).max(axis=0) > 0)
        if mine.size:
            one.bends, one.N, one.G = len(mine), self._keep(N[:, mine]), self._keep(part.shortening.G[mine])
            one.now = self._keep(np.zeros((len(ports), part.n)))

    def _rows(self, used: np.ndarray) -> dict[str, np.ndarray]:
        """Constraint rows: kinds, markers, and directions in the axes that markers turn with."""
        s, m, d = self.system, self.m, self.system.motions.dim
        R = s.markers.rotation
        out: dict[str, np.ndarray] = {k: np.zeros(m, np.int32) for k in ("kind", "ma", "mb")}
        out |= {k: np.zeros((m, d)) for k in ("e", "e1", "f")} | {"length": np.ones(m)}
        for batch, rows in s.batches:
            kind = KINDS[type(batch)]
            known = batch.items.constants
            e, f = known.get("e", np.zeros((len(rows), d))), known.get("f", np.zeros((len(rows), d)))
            out["kind"][rows] = kind
            out["ma"][rows], out["mb"][rows] = np.searchsorted(used, batch.a), np.searchsorted(used, batch.b)
            out["e"][rows] = e if kind == 0 else (R[batch.a] @ e[..., None])[..., 0]
            out["e1"][rows] = (R[batch.a] @ known.get("g", e)[..., None])[..., 0]
            out["f"][rows] = (R[batch.b] @ f[..., None])[..., 0]
            out["length"][rows] = known.get("length", 1.0)
        return out

    def step(self, blocks: list[tuple[Array, int]], out: int, t: float) -> int:
        """One step from the blocks (newest first, with their addresses) into the block at ``out``; the kernel's verdict."""
        for batch, rows in self.driven:
            self.offset[rows] = batch.offsets(t)[0]
        p, g = self.parameters, self.system.gravity(t)
        p[GX : GX + len(g)] = g
        p[HISTORY] = len(blocks) - 1
        at = [b[1] for b in blocks]
        at += [at[-1]] * (3 - len(at))
        return int(self.lib.step(self.address, p.ctypes.data, at[0], at[1], at[2], self.offset.ctypes.data, out))


class FieldColumns:
    """H of a floating body: the inertia columns, the ports in the solver's columns, and those that markers need beside them."""

    def __init__(self, system: System, i: int, part: Any, block: Block) -> None:
        self.number, self.part, self.block = system.fields[i][0], part, block
        mk, first = system.markers, system.port_slice(self.number)
        wanted = [x for x in np.unique(mk.port) - first.start if 0 <= x < part.n_port]
        self.ports = np.concatenate((block.used, np.setdiff1d(wanted, block.used))).astype(int)
        k = part.inertia_columns.shape[1]
        self.solved, self.count = k + len(block.used), k + len(self.ports)
        self.slot = np.full(part.n_port, -1)  # column of H less the inertia columns
        self.slot[self.ports] = np.arange(len(self.ports))
        rows = np.arange(part.n_frame_rows)
        self.frame_slots = rows if part.shared_columns else k + self.slot[rows]

    def arrays(self) -> dict[str, np.ndarray]:
        """The field's arrays for the kernel."""
        p, f, d = self.part, self.part.field, self.part.field.dim
        ports = sp.csc_matrix(p.port_columns(self.ports))
        at, W, Y = self.frame_slots, self.block.W, self.block.Y
        B = W.diagonal()[at].copy()
        mixed = np.linalg.solve(np.diag(B) + W[np.ix_(at, at)], W[at])
        start, cols, values = f.M.getValuesCSR()
        K = sp.csr_matrix(f.K.getValuesCSR()[::-1], shape=(p.n, p.n)).tobsr((d, d))
        return {
            "X": f.X,
            "Q": p.inertia_columns.T,
            "port": ports.data,
            "port_start": ports.indptr.astype(np.int32),
            "port_col": ports.indices.astype(np.int32),
            "Y": (Y - Y[:, at] @ mixed).T,
            "HY": W - W[:, at] @ mixed,
            "B": B,
            "frame_slot": at.astype(np.int32),
            "inertia": p.inertia,
            "moment": p.moment if p.column_version else np.zeros(d),
            "M_start": start.astype(np.int32),
            "M_col": cols.astype(np.int32),
            "M": values,
            "K_start": K.indptr.astype(np.int32),
            "K_col": K.indices.astype(np.int32),
            "K": K.data,
        }


def _profile(nb: int, m: int, fa: np.ndarray, fb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Order of the rows (reverse Cuthill-McKee), first column and start of each place in the profile, its size."""
    rows = np.concatenate((np.arange(m), np.arange(m)))
    body = np.concatenate((fa, fb))
    keep = body < nb
    touch = sp.csr_matrix((np.ones(int(keep.sum())), (rows[keep], body[keep])), shape=(m, nb))
    graph = (touch @ touch.T).tocsr()
    place = np.zeros(m, np.int32)
    if m:
        place[reverse_cuthill_mckee(graph, symmetric_mode=True)] = np.arange(m, dtype=np.int32)
    pairs = graph.tocoo()
    first = np.arange(m, dtype=np.int32)
    np.minimum.at(first, place[pairs.row], place[pairs.col])
    width = np.arange(m) - first + 1
    start = np.concatenate(([0], np.cumsum(width)[:-1])).astype(np.int64) if m else np.zeros(0, np.int64)
    return place, first, start, int(width.sum())


def _contributions(
    nb: int, fa: np.ndarray, fb: np.ndarray, order: np.ndarray, first: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of Jacobian blocks (2 row + side) that meet on one body, and where their product goes."""
    on: list[list[int]] = [[] for _ in range(nb)]
    for side, frames in enumerate((fa, fb)):
        for row, body in enumerate(frames):
            if body < nb:
                on[body].append(2 * row + side)
    found = []
    for entries in on:
        for x in entries:
            for y in entries:
                i, j = int(order[x // 2]), int(order[y // 2])
                if i >= j:
                    found.append((x, y, int(start[i]) + j - int(first[i])))
    ci, cj, cdest = np.array(found, dtype=np.int64).reshape(-1, 3).T
    return ci.astype(np.int32), cj.astype(np.int32), cdest


def kernel_library(system: System) -> Any:
    """The compiled library for a system, or None where the NumPy path has to do."""
    return library(system.motions.dim) if supports(system) else None


def kernel_of(system: System, blocks: list[Block] | None = None) -> Kernel | None:
    """The kernel of a system, or None where the NumPy path has to do."""
    lib = kernel_library(system)
    if lib is None:
        return None
    kernel = Kernel(system, lib, blocks)
    return kernel if kernel.size <= PROFILE_LIMIT else None
