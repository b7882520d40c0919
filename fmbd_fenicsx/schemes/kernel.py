"""The arrays of one system as the compiled step (``step.c``) reads them.

A system is bodies (rigid or reduced, each with its frame), markers, and rows of elementary constraints between markers. The
rows' factor is kept in profile storage after a reverse Cuthill-McKee order.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import reverse_cuthill_mckee

from ..mechanics import constraints as ct
from ..mechanics.limits import TOO_LARGE
from ..mechanics.reduced import ReducedPart
from ..rotations import Array
from ..system.system import System
from .compiled import library

KINDS = {ct.Coincident: 0, ct.Along: 1, ct.Perpendicular: 2, ct.Distance: 3}
PROFILE_LIMIT = 4_000_000  # entries of the factor
LOOK = 3  # verdict: something to be warned of or refused by the NumPy path
# fmt: off
(H, AM, AF, GAMMA, BETA, GX, GY, GZ, TOL, FLOOR, LENGTH, THETA, SLOW, MAXIT, HISTORY, PATIENCE, ITERATIONS, LOCAL,
 RESIDUAL) = range(19)
# fmt: on


def _structure(name: str, dim: int = 0) -> type[ctypes.Structure]:
    """The C structures Body, Marker (for its dimension) and System."""
    i, r, p, n = ctypes.c_int, ctypes.c_double, ctypes.c_void_p, ctypes.c_long
    rot = 2 * dim - 3
    fields: dict[str, list[tuple[str, Any]]] = {
        "Body": [(x, i) for x in ("m", "at_v", "at_q", "at_x")]
        + [(x, r) for x in ("mass", "large", "spin")]
        + [(x, p) for x in ("inertia", "S", "T", "V", "modal", "K", "C", "stress", "chol", "U")],
        "Marker": [("frame", i), ("surface", i), ("reference", p), ("ports", p), ("p", r * dim)]
        + [("x", r * dim), ("arm", r * dim), ("R", r * dim**2)]
        + [("lever", r * dim), ("turn", r * dim**2), ("Z", r * rot**2)],
        "System": [(x, i) for x in ("nb", "markers", "m", "nc", "n", "nq")]
        + [(x, n) for x in ("profile_size", "jac_size")]
        + [(x, p) for x in ("body", "marker", "kind", "ma", "mb", "e", "e1", "f", "length", "order", "first", "start")]
        + [
            (x, p)
            for x in ("ci", "cj", "cdest", "on", "js", "profile", "jac", "tangent", "W", "g", "y", "R", "work", "units")
        ],
    }
    return type(name, (ctypes.Structure,), {"_fields_": fields[name]})


def supports(system: System) -> bool:
    """Whether the kernel covers a system: rigid and reduced bodies, the elementary constraints, gravity."""
    parts = all(type(p) is ReducedPart and not p.constants.loads for p in system.parts)
    plain = system.markers.section is None and not (
        system.forces or system.contacts or system.port_constraints or system.traces
    )
    kinds = all(type(batch) in KINDS for batch, _ in system.batches)
    return parts and plain and kinds and system.n_frames > 0


class Kernel:
    """The arrays of one system, and its steps."""

    def __init__(self, system: System, lib: Any) -> None:
        self.system, self.lib = system, lib
        self.n, self.nq, self.m = system.n_v, system.n_q, system.n_lam
        self.block_size = 1 + self.nq + 3 * self.n + self.m
        self._kept: list[Any] = []
        nb, d = system.n_frames, system.motions.dim
        self.parts = {p.frame: (k, p) for k, p in enumerate(system.parts) if isinstance(p, ReducedPart)}
        widths = np.array([system.motions.n_twist + (self.parts[b][1].n if b in self.parts else 0) for b in range(nb)])
        self.bodies = self._bodies(widths)
        numbers = [x for batch, _ in system.batches for x in (*batch.a, *batch.b)]
        used = np.unique(np.array(numbers, dtype=int))
        arrays = self._rows(used)
        frame = np.append(system.markers.frame[used], nb)  # a row without markers does not exist
        fa, fb = frame[arrays["ma"]], frame[arrays["mb"]]
        blocks = np.stack((fa, fb), axis=1).ravel()
        wide = np.append(widths, 0)[blocks]
        arrays["on"] = blocks.astype(np.int32)
        arrays["js"] = np.where(blocks < nb, np.cumsum(wide) - wide, -1).astype(np.int64)
        order, first, start, self.size = _profile(nb, self.m, fa, fb)
        ci, cj, cdest = _contributions(nb, fa, fb, order, first, start)
        arrays |= {"order": order, "first": first, "start": start, "ci": ci, "cj": cj, "cdest": cdest}
        jac = int(wide.sum())
        sizes = {"profile": self.size, "jac": jac, "tangent": jac, "W": jac, "g": self.m, "y": self.m}
        arrays |= {k: np.zeros(max(x, 1)) for k, x in sizes.items()}
        arrays["work"] = np.zeros(4 * self.n + self.m)
        arrays["R"] = np.tile(np.eye(d), (nb + 1, 1, 1))
        arrays["units"] = np.array(system.units, dtype=float)
        counts = (nb, len(used), self.m, len(ci), self.n, self.nq, self.size, jac)
        pointers = {k: self._keep(x) for k, x in arrays.items()}
        markers = self._markers(used)
        body, marker = ctypes.addressof(self.bodies), ctypes.addressof(markers)
        self.c = _structure("System")(*counts, body=body, marker=marker, **pointers)
        self._kept.append(markers)
        self.address = ctypes.addressof(self.c)
        self.parameters, self.offset = np.zeros(19), np.zeros(max(self.m, 1))
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
            k, part = self.parts[b]
            c, m = part.constants, part.n
            T = c.T.transpose(1, 0, 2, 3)  # [b, a] = T_ab
            pairs = ((2, 1), (0, 2), (1, 0)) if d == 3 else ((1, 0),)
            arrays = {
                "S": c.S,
                "T": T,
                "V": np.stack([T[..., i, j] - T[..., j, i] for i, j in pairs], axis=-1),
                "modal": np.trace(c.T[1:, 1:], axis1=2, axis2=3),
                "K": c.K,
                "C": c.D,
                "chol": np.zeros((widths[b], widths[b])),
                "U": np.zeros((m + 1) * (d * d + 2 * d - 3) + 2 * m),
            }
            if c.stiffening is not None:
                arrays["stress"] = c.stiffening.transpose(0, 2, 1)
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

    def look(self) -> None:
        """Take the angular velocities above which a body is to be warned of; those warned of have none."""
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
                k, part = self.parts[one.frame]
                ports = mk.port[np.searchsorted(mk.surface, i)] - s.port_slice(k).start
                one.reference, one.ports = self._keep(part.reference[ports]), self._keep(part.port_matrix[ports])
            made.append(one)
        return (kind * max(len(made), 1))(*made)

    def _rows(self, used: np.ndarray) -> dict[str, np.ndarray]:
        """Constraint rows: kinds, markers, and directions in the axes that markers turn with."""
        s, m, d = self.system, self.m, self.system.motions.dim
        R = s.markers.rotation
        out: dict[str, np.ndarray] = {k: np.zeros(m, np.int32) for k in ("kind", "ma", "mb")}
        out |= {k: np.zeros((m, d)) for k in ("e", "e1", "f")} | {"length": np.ones(m)}
        for batch, rows in s.batches:
            kind = KINDS[type(batch)]
            e1 = np.cross(batch.axis, batch.e) if d == 3 else np.stack((-batch.e[:, 1], batch.e[:, 0]), -1)
            out["kind"][rows] = kind
            out["ma"][rows], out["mb"][rows] = np.searchsorted(used, batch.a), np.searchsorted(used, batch.b)
            out["e"][rows] = batch.e if kind == 0 else (R[batch.a] @ batch.e[..., None])[..., 0]
            out["e1"][rows] = (R[batch.a] @ e1[..., None])[..., 0]
            out["f"][rows] = (R[batch.b] @ batch.f[..., None])[..., 0]
            out["length"][rows] = batch.length
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


def kernel_of(system: System) -> Kernel | None:
    """The kernel of a system, or None where the NumPy path has to do."""
    if not supports(system):
        return None
    lib = library(system.motions.dim)
    if lib is None:
        return None
    kernel = Kernel(system, lib)
    return kernel if kernel.size <= PROFILE_LIMIT else None
