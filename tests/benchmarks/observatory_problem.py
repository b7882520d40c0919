"""What a problem of the observatory is: a scene, and the value of a sensor at its end that this code did not compute."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd


@dataclass(frozen=True)
class Problem:
    """A scene and the value of its ``sensor`` at ``t_end`` (s).

    ``provenance``: where the reference comes from. ``steps``: of the coarsest run with equal steps. ``exudyn``: the name of its
    model in ``observatory_exudyn.py``, empty where there is none.
    """

    scene: Callable[[], fmbd.Scene]
    t_end: float
    sensor: str
    reference: Callable[[], Any]
    provenance: str
    steps: int = 100
    exudyn: str = ""


def ordinary(f: Callable[[float, Any], Any], start: Any, t_end: float) -> Any:
    """The end of an ordinary differential equation, by SciPy's DOP853 with rtol = 1e-12."""
    return solve_ivp(f, [0.0, t_end], start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
