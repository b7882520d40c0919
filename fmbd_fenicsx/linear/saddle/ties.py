"""Rows that tie bodies to one another, or hold them, by trace multipliers: sum_k B_k u_k = g."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ...errors import InputError
from ...fem.traces.mortar import Mortar
from ...fem.traces.multipliers import Multipliers
from ...fem.traces.traces import Trace


@dataclass(frozen=True, eq=False)
class TraceTie:
    """Rows of (1): sum_k B_k u_k = g, with the multipliers' space where the rows come from one.

    ``columns``: (number of the body, B_k (rows, n_owned d) on this rank); ``multipliers`` and ``components`` say that
    the rows are the functions of a space times that many components (d for a full tie, 1 for a normal one); None for
    other rows. ``sides``: (number of the body, its surface, scalar coupling with all nodes of the surface), for
    preconditioners.
    """

    name: str
    columns: tuple[tuple[int, sp.csr_matrix], ...]
    multipliers: Multipliers | None = None
    components: int = 1
    sides: tuple[tuple[int, Trace, sp.csr_matrix], ...] = ()

    @property
    def rows(self) -> int:
        """Rows, the same on all ranks."""
        return int(self.columns[0][1].shape[0])


def hold(name: str, body: int, multipliers: Multipliers) -> TraceTie:
    """int mu . u = g on a surface: weak Dirichlet data; g = :meth:`.Multipliers.integrals` of the data, by rows."""
    d = multipliers.trace.dim
    B = multipliers.coupling()
    sides = ((body, multipliers.trace, B),)
    return TraceTie(name, ((body, _vector(multipliers.trace.columns(B), d)),), multipliers, d, sides)


def tie(name: str, slave: int, master: int, coupling: Mortar) -> TraceTie:
    """int mu . (u_slave - u_master o pi) = 0 over the overlap."""
    d = coupling.slave_trace.dim
    own = _vector(coupling.slave_trace.columns(coupling.slave), d)
    other = _vector(coupling.master_trace.columns(coupling.master), d)
    return TraceTie(name, _merged(slave, own, master, -other), coupling.multipliers, d, _sides(slave, master, coupling))


def slide(name: str, slave: int, master: int, coupling: Mortar) -> TraceTie:
    """int mu n . (u_slave - u_master o pi) = 0: normal only, n the mean normal of the slave (flat surfaces).

    Raises:
        InputError: the surface is curved, so that no single normal exists.
    """
    t = coupling.slave_trace
    n = t.mean_normal
    if not t.flat:
        raise InputError(
            f'Tie "{name}": {t.label} is curved (mean normal of length {np.linalg.norm(n):.3f}); a sliding '
            "tie needs a flat surface."
        )
    N = sp.csr_matrix(n[None, :])
    own = sp.kron(t.columns(coupling.slave), N, format="csr")
    other = sp.kron(coupling.master_trace.columns(coupling.master), N, format="csr")
    return TraceTie(name, _merged(slave, own, master, -other), coupling.multipliers, 1, _sides(slave, master, coupling))


def _sides(slave: int, master: int, c: Mortar) -> tuple[tuple[int, Trace, sp.csr_matrix], ...]:
    return ((slave, c.slave_trace, c.slave), (master, c.master_trace, c.master))


def _merged(a: int, A: sp.csr_matrix, b: int, B: sp.csr_matrix) -> tuple[tuple[int, sp.csr_matrix], ...]:
    return ((a, (A + B).tocsr()),) if a == b else ((a, A), (b, B))


def _vector(B: sp.csr_matrix, d: int) -> sp.csr_matrix:
    return sp.kron(B, sp.identity(d), format="csr")
