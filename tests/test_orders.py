"""Orders of positions, velocities and multipliers of every scheme in every form, within 0.15 of the theory on both sides.

A planar pendulum (1 m, 9.81 m/s^2) with constant steps against its angle by DOP853; the orders that theory gives for index-3
systems: Hairer, Lubich and Roche, doi:10.1007/BFb0093947. Half-step multipliers of RATTLE: ``test_rattle``; the stiff spring
pendulum: ``test_stiff_pendulum``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dae_problems import observed

import fmbd_fenicsx as fmbd

# scheme, orders of (q, v, lambda), steps in 1.5 s: where the error is asymptotic and above roundoff
TABLE: list[tuple[Any, tuple[int, int, int], tuple[int, ...]]] = [
    (fmbd.Radau(2, fmbd.Index3(), None), (3, 2, 1), (40, 80, 160)),
    (fmbd.Radau(2, fmbd.Index2(), None), (3, 3, 2), (40, 80, 160)),
    (fmbd.Radau(2, fmbd.Index1(), None), (3, 3, 3), (40, 80, 160)),
    (fmbd.Radau(2, fmbd.GGL(), None), (3, 3, 2), (40, 80, 160)),
    (fmbd.Radau(3, fmbd.Index3(), None), (5, 3, 2), (40, 60, 80)),
    (fmbd.Radau(3, fmbd.Index2(), None), (5, 5, 3), (20, 30, 40)),
    (fmbd.Radau(3, fmbd.Index1(), None), (5, 5, 5), (16, 24, 36)),
    (fmbd.Radau(3, fmbd.GGL(), None), (5, 5, 3), (20, 30, 40)),
    (fmbd.GeneralizedAlpha(0.8), (2, 2, 2), (80, 160, 320)),
    (fmbd.GeneralizedAlpha(0.8, form=fmbd.GGL()), (2, 2, 2), (80, 160, 320)),
    (fmbd.Rattle(), (2, 2, 2), (80, 160, 320)),
    (fmbd.BDF(1, fmbd.Index3(), None), (1, 1, 1), (160, 320, 640)),
    (fmbd.BDF(2, fmbd.Index3(), None), (2, 2, 2), (80, 160, 320)),
    (fmbd.BDF(3, fmbd.Index3(), None), (3, 3, 3), (80, 160, 320)),
    (fmbd.BDF(1, fmbd.Index2(), None), (1, 1, 1), (160, 320, 640)),
    (fmbd.BDF(2, fmbd.Index2(), None), (2, 2, 2), (80, 160, 320)),
    (fmbd.BDF(3, fmbd.Index2(), None), (3, 3, 3), (80, 160, 320)),
    (fmbd.HalfExplicit(rtol=None), (4, 4, 4), (40, 80, 160)),
    (fmbd.EnergyMomentum(), (2, 2, 2), (40, 80, 160)),
]


def label(scheme: Any) -> str:
    form = getattr(scheme, "form", None)
    return scheme.name if form is None or form.name in scheme.name else f"{scheme.name}, {form.name}"


@pytest.mark.parametrize(("scheme", "expected", "steps"), TABLE, ids=[label(row[0]) for row in TABLE])
def test_orders(scheme: Any, expected: tuple[int, int, int], steps: tuple[int, ...]) -> None:
    found = observed(scheme, steps, 1.5 if label(scheme).startswith("Radau IIA(3), Index1") else 1.0)
    assert (np.abs(found - np.array(expected)) < 0.15).all(), found
