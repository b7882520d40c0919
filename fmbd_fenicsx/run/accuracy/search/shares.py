"""Tolerances of sensors, and the shares of them that the stated errors of a run take."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ....checks import typed
from ....errors import InputError, near, require
from ....log import log
from ....system.scene.scene import Scene
from ..certificate import FLOOR, Certificate, Statement, moving
from ..deviation import Deviation
from ..equal_steps import ASTRAY
from ..orders import expected_orders, highest_order, of_the_scheme

if TYPE_CHECKING:
    from ...result import Run

AIM = 0.6  # share of the tolerance below which the error of space, or of modes, is brought: its estimate is the coarser one
WHOLE, SAFE = 0.8, 0.9  # shares that all kinds together are brought below, and must be
ITERATED = 0.2  # what Newton's iteration may take: known of a mean step, the largest leave a few times as much
# times the room up to which an error that is told by chance is asked again, as it may be a tenth; and ratio of two such
DOUBTED = 3.0
UNKNOWN = ("", "-", "?")  # units that are none

Tolerance = Mapping[str, Any]  # sensor -> number in its unit, or Relative


@dataclass(frozen=True)
class Relative:
    """A share of the range (largest less smallest value) of a sensor."""

    share: float


@dataclass(frozen=True)
class Allowed:
    """The ``share`` of the tolerance that errors take, and the ``room`` that there is for those of time. ``rough``: what else
    depends on the steps of a run whose error is too large is asked again later. ``sensors``: those with a tolerance. ``last``:
    whether the run may be the last one, which other errors may forbid: about how large that of time is tells the next steps then.
    """

    sensors: tuple[str, ...]
    share: Callable[[dict[str, Deviation]], float]
    room: float
    rough: bool
    last: bool = True

    def lets(self, errors: dict[str, Deviation]) -> bool:
        """Whether errors of time have that room."""
        return self.share(errors) <= self.room

    def nearly_lets(self, errors: dict[str, Deviation]) -> bool:
        """Whether errors of a run that may be the last one have about that room, or none where they are not what they seem."""
        return self.last and bool(errors) and self.share(errors) <= DOUBTED * self.room


@typed
def relative(share: float) -> Relative:
    """A tolerance as a share of the range of the sensor: ``tol={"tip": relative(1e-3)}``."""
    require(bool(np.isfinite(share)) and share > 0, f"relative({share}): the share must be positive.")
    require(
        share < 1.0,
        f"relative({share:g}): such an error is as large as all that the sensor does. Give a share below 1.",
    )
    require(share >= FLOOR, f"relative({share:g}) is below what roundoff allows, about {FLOOR:g}.")
    return Relative(float(share))


def check_tolerances(scene: Scene, tol: Tolerance) -> None:
    """Tolerances of known sensors, positive."""
    require(bool(tol), "tol must name a sensor: tol={'tip': 1e-4}.")
    for name, value in tol.items():
        require(isinstance(name, str), f"tol: {name!r} is no name of a sensor: tol={{'tip': 1e-4}}.")
        if name not in scene.sensors:
            whole = next((sensor for sensor in scene.sensors if name.startswith(f"{sensor} ")), None)
            hint = whole and f'A tolerance holds for all components of a sensor: tol={{"{whole}": {value!r}}}.'
            raise InputError(f'tol: no sensor "{name}". {hint or near(name, scene.sensors)}')
        if isinstance(value, Relative):
            continue

        # a length is measured in m, an angle in rad: of a number without a unit nobody knows what it allows
        unit = scene.sensors[name].unit
        require(
            unit.strip() not in UNKNOWN,
            f'tol of "{name}" is {value!r}, but this sensor has no unit. Give the sensor its unit '
            '(unit="rad" where it is made), or a share of its range: relative(1e-3).',
        )

        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        require(
            number and bool(np.isfinite(value)) and value > 0,
            f'tol of "{name}" is {value!r}: give a positive number in {unit}, or relative(1e-3).',
        )


def check_floor(scene: Scene, spans: Mapping[str, float], tol: Tolerance) -> None:
    """Tolerances not below roundoff, whose share of the range of a sensor a run tells; ``spans``: of those that move.

    Raises InputError where one is below.
    """
    for name, value in tol.items():
        _above_floor(name, scene.sensors[name].unit, value, spans.get(name, 0.0))


def _limit(statement: Statement, value: Any) -> float:
    """The tolerance of a sensor in its unit, not below roundoff; raises InputError where it is below."""
    return _above_floor(statement.sensor, statement.unit, value, statement.span)


def _above_floor(sensor: str, unit: str, value: Any, span: float) -> float:
    """The tolerance of a sensor with this range, in its unit; see :func:`check_floor`."""
    limit, floor = _plain(value, span), FLOOR * span
    require(limit >= floor, f'tol of "{sensor}", {limit:g} {unit}, is below what roundoff allows: about {floor:.1e}.')
    return limit


def _plain(value: Any, span: float) -> float:
    """The tolerance of a sensor with this range, in its unit."""
    limit = value.share * span if isinstance(value, Relative) else float(value)
    return limit if limit > 0 else np.inf  # a sensor that does not move has no error to speak of


def largest_share(errors: Mapping[str, Deviation], spans: Mapping[str, float], tol: Tolerance) -> float:
    """The largest of some errors over its tolerance, sensor by sensor; ``spans``: of those that move, which shares refer to."""
    return max(errors[n].size / _plain(x, spans.get(n, 0.0)) for n, x in tol.items())


def share(made: Certificate, sensor: str, value: Any, kind: str) -> float:
    """One kind of error over the tolerance; infinite where it could not be stated."""
    if kind in made.unstated:
        return np.inf
    error = getattr(made[sensor], kind)
    return 0.0 if error is None else float(error / _limit(made[sensor], value))


def worst(made: Certificate, tol: Tolerance) -> float:
    """The largest stated error over its tolerance; infinite where a kind of error could not be stated."""
    shares = [made[name].sum / _limit(made[name], value) for name, value in tol.items()]
    return np.inf if made.unstated else max(shares)


def safe(made: Certificate, tol: Tolerance) -> bool:
    """Whether the stated errors leave room for that of the estimates themselves."""
    fixed = max(share(made, n, x, kind) for n, x in tol.items() for kind in ("space", "modes"))
    iterated = max(share(made, n, x, "algebra") for n, x in tol.items())
    return worst(made, tol) <= SAFE and fixed <= AIM and iterated <= ITERATED


def alone(run: Run, made: Certificate, tol: Tolerance) -> bool:
    """Whether no run with other steps shows the motion of a run, and its error is more than a tenth of what a sensor does: that
    of many periods within few steps may be any.
    """
    orders, highest = expected_orders(run.scheme, run.scene, run.system), highest_order(run.scheme, run.system)
    astray = [n for n in tol if (made[n].time or 0.0) > ASTRAY * made[n].span > 0.0]
    return any(not of_the_scheme((orders[n], highest), run.observed_order.get(n, np.nan)) for n in astray)


def warn_of_still(run: Run, tol: Tolerance) -> None:
    """Sensors that do not move, whose range a share is asked of, where a user sees it."""
    moves = moving(run.series, run.scene.sensors, FLOOR)
    for name in [n for n, x in tol.items() if isinstance(x, Relative) and n not in moves]:
        run.warnings.append(
            f'"{name}" does not move in this run: a share of its range, 0, is no tolerance, and nothing was asked of its error. '
            f'Give a number in its unit, tol={{"{name}": ...}}; if it has to move, look at what is to move it.'
        )
        log.warning("%s", run.warnings[-1])
