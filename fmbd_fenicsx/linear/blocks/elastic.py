"""The elastic block of one body, with the sizes of it that preconditioners are scaled by."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...fem.fields import Field


@dataclass(frozen=True, eq=False)
class Elastic:
    """The block cm M + ck K of one body."""

    body: Field
    cm: float
    ck: float = 1.0

    @property
    def rows(self) -> int:
        """Rows on this rank."""
        return self.body.n * self.body.dim

    @property
    def size(self) -> float:
        """Diameter of the body, m."""
        return self.body.size

    @cached_property
    def moduli(self) -> tuple[float, float]:
        """Mean moduli of shear and of uniaxial strain, Pa: the elastic energies of such deformations over
        the volume.
        """
        b, d = self.body, self.body.dim
        shear: list[float] = []
        axial: list[float] = []
        for i in range(d):
            for j in range(d):
                # unit strains e_i x_j; two stretches against each other are a shear, too
                u = np.zeros((b.n, d))
                u[:, i] = b.X[:, j]
                (axial if i == j else shear).append(float(u.ravel() @ b.stiffness(u.ravel())))
                if i == j:
                    k = (i + 1) % d
                    u[:, k] = -b.X[:, k]
                    shear.append(float(u.ravel() @ b.stiffness(u.ravel())) / 4.0)

        volume = b.mass_total / b.mean_density
        return tuple(float(x) for x in b.total(np.array([np.mean(shear), np.mean(axial)])) / volume)  # type: ignore[return-value]

    @property
    def depth(self) -> float:
        """Length sqrt(ck G / (cm rho)) over which a surface force reaches into the body within a step, m."""
        return float(np.sqrt(self.ck * self.moduli[0] / (self.cm * self.body.mean_density)))
