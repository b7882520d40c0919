"""Compiled steps: a C kernel for rigid bodies of the plane, built once by the system's compiler and kept in a cache.

The kernel is an optional copy of :mod:`.generalized_alpha`, equation by equation; what it cannot do (forces, elastic parts,
space, constraints close to dependent, Newton's failures with their messages) is left to the NumPy path. Results agree to
roundoff. Without a C compiler everything runs in NumPy.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import reverse_cuthill_mckee

from ..log import log
from ..mechanics import constraints as ct
from ..rotations import Array
from ..system.system import System

SOURCE = Path(__file__).with_name("plane_step.c")
FLAGS = ("-O3", "-ffp-contract=off", "-shared", "-fPIC", "-std=c99")
KINDS = {ct.Coincident: 0, ct.Along: 1, ct.Perpendicular: 2, ct.Distance: 3}
PROFILE_LIMIT = 4_000_000  # entries of the factor
# fmt: off
(H, AM, AF, GAMMA, BETA, GX, GY, TOL, FLOOR, LENGTH, THETA, SLOW, MAXIT, HISTORY, ITERATIONS, LOCAL, PIVOT, RESIDUAL,
 SIZE) = range(19)
# fmt: on


def cache_folder() -> Path:
    """Where compiled kernels are kept: XDG_CACHE_HOME/fmbd_fenicsx, by default in ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "fmbd_fenicsx"


@lru_cache
def library() -> Any:
    """The compiled kernel, or None: built at first use, found in the cache by the hash of its source afterwards."""
    compiler = os.environ.get("CC", "cc").split()
    if shutil.which(compiler[0]) is None:
        log.info("no C compiler %s: rigid steps run in NumPy", compiler[0])
        return None
    text = SOURCE.read_bytes() + repr((compiler, FLAGS)).encode()
    name = f"plane_step_{hashlib.sha256(text).hexdigest()[:20]}"
    try:
        return _load(cache_folder(), name, compiler)
    except (OSError, subprocess.SubprocessError) as error:
        log.info("the compiled step is not available (%s): rigid steps run in NumPy", error)
        return None


def _load(folder: Path, name: str, compiler: list[str]) -> Any:
    """Load the library; a file that does not match its checksum is built again."""
    file, sums = folder / f"{name}.so", folder / f"{name}.sha256"
    good = file.exists() and sums.exists() and sums.read_text() == hashlib.sha256(file.read_bytes()).hexdigest()
    if not good:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as work:
            built = Path(work) / file.name
            command = [*compiler, *FLAGS, "-o", str(built), str(SOURCE), "-lm"]
            subprocess.run(command, check=True, capture_output=True, timeout=60)
            sums.write_text(hashlib.sha256(built.read_bytes()).hexdigest())
            os.replace(built, file)
    found = ctypes.CDLL(str(file))
    found.step.argtypes = [ctypes.c_void_p] * 7
    found.step.restype = ctypes.c_int
    return found


class _CSystem(ctypes.Structure):
    _fields_ = [(n, ctypes.c_int) for n in ("nb", "m", "nc", "unused")] + [
        (n, ctypes.c_void_p)
        for n in (
            *("mass", "kind", "fa", "fb", "pa", "pb", "e", "f", "length", "order", "first", "start"),
            *("ci", "cj", "cbody", "cdest", "profile", "jac", "g", "y", "work", "cs", "tangent", "units"),
        )
    ]


def supports(system: System) -> bool:
    """Whether the kernel covers a system: rigid bodies of the plane, the elementary constraints, gravity."""
    plain = not (system.parts or system.forces or system.contacts or system.port_constraints or system.traces)
    kinds = all(type(batch) in KINDS for batch, _ in system.batches)
    return plain and kinds and system.motions.dim == 2 and system.rigid is not None and system.n_frames > 0


class PlaneKernel:
    """The arrays of one system, and its steps."""

    def __init__(self, system: System, lib: Any) -> None:
        self.system, self.lib = system, lib
        nb, m = system.n_frames, system.n_lam
        self.n, self.m = 3 * nb, m
        self.block_size = 1 + 4 * self.n + m
        a: dict[str, np.ndarray] = {"mass": np.zeros((nb, 3))}
        rigid = system.rigid
        assert rigid is not None
        a["mass"][rigid.frame] = np.array([np.diag(M) for M in rigid.matrices()])
        a |= self._rows()
        order, first, start, size = _profile(nb, m, a["fa"], a["fb"])
        a |= {"order": order, "first": first, "start": start}
        a |= _contributions(nb, a["fa"], a["fb"], order, first, start)
        sizes = {
            "profile": size,
            "jac": 6 * m,
            "g": m,
            "y": m,
            "work": 3 * self.n + m,
            "cs": 2 * (nb + 1),
            "tangent": 6 * m,
        }
        a |= {k: np.zeros(max(x, 1)) for k, x in sizes.items()}
        a["units"] = np.array(system.units, dtype=float)
        self.size, self.arrays = size, {k: np.ascontiguousarray(x) for k, x in a.items()}
        assert set(self.arrays) == {n for n, kind in _CSystem._fields_ if kind is ctypes.c_void_p}  # type: ignore[misc]
        self.c = _CSystem(nb, m, len(a["ci"]), 0, **{k: x.ctypes.data for k, x in self.arrays.items()})
        self.address = ctypes.addressof(self.c)
        self.parameters, self.offset = np.zeros(19), np.zeros(max(m, 1))
        self.parameters[SIZE] = size
        self.driven = [(batch, rows) for batch, rows in system.batches if batch.driven]

    def _rows(self) -> dict[str, np.ndarray]:
        """Constraint rows in body axes."""
        s, m = self.system, self.m
        mk = s.markers
        out: dict[str, np.ndarray] = {k: np.zeros(m, np.int32) for k in ("kind", "fa", "fb")}
        out |= {k: np.zeros((m, 2)) for k in ("pa", "pb", "e", "f")} | {"length": np.ones(m)}
        for batch, rows in s.batches:
            kind = KINDS[type(batch)]
            out["kind"][rows] = kind
            out["fa"][rows], out["fb"][rows] = mk.frame[batch.a], mk.frame[batch.b]
            out["pa"][rows], out["pb"][rows] = mk.position[batch.a], mk.position[batch.b]
            turned = (mk.rotation[batch.a] @ batch.e[..., None])[..., 0]
            out["e"][rows] = batch.e if kind == 0 else turned
            out["f"][rows] = (mk.rotation[batch.b] @ batch.f[..., None])[..., 0]
            out["length"][rows] = batch.length
        return out

    def step(self, blocks: list[tuple[Array, int]], out: int, t: float) -> int:
        """One step from the blocks (newest first, with their addresses) into the block at ``out``; the kernel's verdict."""
        for batch, rows in self.driven:
            self.offset[rows] = batch.offsets(t)[0]
        p, g = self.parameters, self.system.gravity(t)
        p[GX], p[GY] = g[0], g[1]
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
) -> dict[str, np.ndarray]:
    """Pairs of Jacobian blocks that meet on one body, and where their product goes."""
    on: list[list[int]] = [[] for _ in range(nb)]
    for side, frames in enumerate((fa, fb)):
        for row, body in enumerate(frames):
            if body < nb:
                on[body].append(2 * row + side)
    ci, cj, body_, dest = [], [], [], []
    for body, entries in enumerate(on):
        for x in entries:
            for y in entries:
                i, j = int(order[x // 2]), int(order[y // 2])
                if i >= j:
                    ci.append(x)
                    cj.append(y)
                    body_.append(body)
                    dest.append(int(start[i]) + j - int(first[i]))
    return {
        "ci": np.array(ci, np.int32),
        "cj": np.array(cj, np.int32),
        "cbody": np.array(body_, np.int32),
        "cdest": np.array(dest, np.int64),
    }


def kernel_of(system: System) -> PlaneKernel | None:
    """The kernel of a system, or None where the NumPy path has to do."""
    if not supports(system):
        return None
    lib = library()
    if lib is None:
        return None
    kernel = PlaneKernel(system, lib)
    return kernel if kernel.size <= PROFILE_LIMIT else None
