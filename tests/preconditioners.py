"""Preconditioners of the multipliers that the package's own is compared with: S itself, its lumped form, a scaled mass."""

from __future__ import annotations

from dataclasses import dataclass

import scipy.sparse as sp

from fmbd_fenicsx.linear.presets.multiplier_schur import Schur
from fmbd_fenicsx.linear.saddle.precondition import Group, lumped
from fmbd_fenicsx.linear.saddle.saddle import SaddlePoint


@dataclass(frozen=True)
class Exact:
    """S itself (dense, needs inertia): three MINRES iterations whatever the system (Murphy, Golub and Wathen,
    doi:10.1137/S1064827599355153), where signs and transposes are right.
    """

    def groups(self, saddle: SaddlePoint) -> list[Group]:
        """One group for all ties; collective."""
        solver = Schur(limit=saddle.n_multipliers).solver(saddle, "exact_")
        S = sp.csr_matrix(solver.complement)
        solver.destroy()
        return [("multipliers", list(range(len(saddle.ties))), S)]


@dataclass(frozen=True)
class Lumped:
    """B diag(E)^-1 B^T, tie by tie."""

    def groups(self, saddle: SaddlePoint) -> list[Group]:
        """One group for each tie; collective."""
        return [(t.name, [i], lumped(saddle, i)) for i, t in enumerate(saddle.ties)]


@dataclass(frozen=True)
class ScaledMass:
    """h M_lambda / G, the h-weighted L2 product, tie by tie."""

    def groups(self, saddle: SaddlePoint) -> list[Group]:
        """One group for each tie."""
        groups = []
        for i, t in enumerate(saddle.ties):
            assert t.multipliers is not None
            moduli = [saddle.elastic[k].ck * saddle.elastic[k].modulus for k, _ in t.columns]
            scale = sum(t.multipliers.trace.h / modulus for modulus in moduli)
            S = sp.kron(scale * t.multipliers.mass(), sp.identity(t.components), format="csr")
            groups.append((t.name, [i], S))
        return groups
