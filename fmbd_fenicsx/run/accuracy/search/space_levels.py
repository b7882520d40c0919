"""Errors in space from runs on several levels of meshes, and the spaces that errors are measured against."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ....errors import InputError
from ....log import log
from ....system.scene.refinement import FEW, cheap_levels, finer_space, refined
from ....system.scene.scene import Scene
from ...built import Built, build
from ...recording.recorder import Recorder
from ..deviation import Deviation, scaled

EXPECTED = 4.0  # ratio of the errors in a space and in the next finer one
AHEAD = EXPECTED / (EXPECTED - 1.0)  # the error of the finer space counts as at most a quarter of that of the given one
ROUNDOFF = 1e-9  # differences below this share of a sensor tell no rate
FALLING = 3.0  # from one level to the next; below, the differences of levels do not tell the error
SLOWER = 0.75  # share of a rate that errors may fall with
NEXT = 4 * FEW  # unknowns of a body up to which elements of half the size cost no more than a higher degree
UNENDED = "the run with finer spaces did not end"


def unended(error: Exception) -> str:
    """Why there is no error in space, where a user sees it."""
    log.warning("no error in space: the run with finer spaces did not end: %s", error)
    return f"{UNENDED}: {error}"


def space_deviations(coarse: Recorder, fine: Recorder, why: str) -> tuple[dict[str, Deviation], str]:
    """(2) from what both have recorded, and what could not be stated, with what was not before (``why``)."""
    errors = {}
    for name, x in coarse.series.items():
        if x.shape == fine.series[name].shape:
            errors[name] = Deviation(coarse.times, AHEAD * (fine.series[name] - x))
        else:
            why = f'"{name}" has other values on another mesh'
    return errors, why


def from_below(
    given: Recorder,
    below: Recorder,
    rates: Mapping[str, float],
    levels: int,
    enough: Callable[[dict[str, Deviation]], bool],
    raised: int = 0,
) -> dict[str, Deviation] | None:
    """Error in space of each sensor from a run on a mesh so many ``levels`` coarser, each expected to be better by its rate r:

        x - x_h ~ (x_h - x_H) / (r^levels - 1)                                                                       (1)

    for r = 4 what (2) of :func:`space_error` takes for granted too. None where it is not ``enough`` if the rate were only the
    share :data:`SLOWER` of it, and where a sensor has other values on each mesh. Where degrees were ``raised`` in so many of the
    levels the rate is none that may be lower: linear elements lock, and at a corner a degree gains as much as two halvings.
    """
    apart = {}
    for name, x in given.series.items():
        if x.shape != below.series[name].shape:
            return None
        apart[name] = Deviation(given.times, x - below.series[name])
    least = {n: (SLOWER * r) ** (levels - raised) * r**raised for n, r in rates.items()}
    if not enough({n: scaled(x, 1.0 / (least[n] - 1.0)) for n, x in apart.items()}):
        return None
    return {n: scaled(x, 1.0 / (rates[n] ** levels - 1.0)) for n, x in apart.items()}


def levels_compared(
    highest: Mapping[str, float], given: Recorder, below: Recorder, lowest: Recorder, gaps: tuple[int, int] = (1, 1)
) -> dict[str, Deviation] | None:
    """Error in space of each sensor from runs on two levels below, n = ``gaps[0]`` halvings of the elements and m = ``gaps[1]``
    more away, errors falling by r from level to level, at most by the ``highest``:

        x - x_h ~ (x_h - x_H) / (r^n - 1),     r^n (r^m - 1) / (r^n - 1) = |x_H - x_HH| / |x_h - x_H|                 (1)

    in the maximum norm over time. None where errors do not fall by :data:`FALLING` or more, so that the next difference is open,
    and where a sensor has other values on each mesh.
    """
    n, m = gaps
    errors = {}
    for name, x in given.series.items():
        y, z = below.series[name], lowest.series[name]
        if not x.shape == y.shape == z.shape:
            return None

        near, far = x - y, float(np.abs(y - z).max(initial=0.0))
        size = float(np.abs(near).max(initial=0.0))
        if size <= ROUNDOFF * float(np.abs(x).max(initial=0.0)):
            errors[name] = Deviation(given.times, near)
            continue
        rate = _rate(far / size, n, m, highest[name])
        if rate is None:
            return None
        errors[name] = Deviation(given.times, near / (rate**n - 1.0))
    return errors


def _rate(ratio: float, n: int, m: int, highest: float) -> float | None:
    """r of (1) of :func:`levels_compared`, at most the ``highest``; None where it is below :data:`FALLING`."""

    def differences(r: float) -> float:
        return r**n * (r**m - 1.0) / (r**n - 1.0)

    if ratio < differences(FALLING):
        return None
    if ratio >= differences(highest):
        return highest
    if n == m == 1:
        return ratio

    from scipy.optimize import brentq  # a run without a search does not load it

    return float(brentq(lambda r: differences(r) - ratio, FALLING, highest))


def finer_scene(scene: Scene) -> tuple[Scene, str, Built | None]:
    """The scene in finer spaces, what has none, and the system; None where nothing is finer. Collective.

    Ties and contact take some degrees only: where they refuse a higher one, meshes of half the cell size are taken.
    """
    why = ""
    for higher in (True, False):
        finer, without = finer_space(scene, higher=higher)
        why = "" if not without else "no finer space for " + ", ".join(f'body "{n}"' for n in without)
        if finer is scene:
            continue
        try:
            return finer, why, build(finer)
        except InputError as error:
            why = str(error)
    return scene, why, None


def cheap(scene: Scene) -> bool:
    """Whether the next level takes no longer than a higher degree, so that errors are measured against what serves again."""
    return not scene.contacts and cheap_levels(scene, NEXT) > 0


def next_level(scene: Scene) -> tuple[Scene, str, Built] | None:
    """The next level, as :func:`finer_scene` gives finer spaces; None where it is dear, or there is none. Collective."""
    if not cheap(scene):
        return None
    try:
        finer = refined(scene)
        return finer, "", build(finer)
    except InputError:
        return None
