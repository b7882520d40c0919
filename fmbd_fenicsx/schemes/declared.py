"""What a scheme says of itself beside its name, order and stepper, with what holds for one that says nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache
from typing import TYPE_CHECKING, Any

from ..checks import shown
from ..errors import InputError
from ..system.scene.contents import Contents

if TYPE_CHECKING:
    from .newton import Newton


@dataclass(frozen=True)
class Declared:
    """Members that a scheme may have, one of a user's own too.

    ``rtol``: of its error control, None for constant steps. ``form``: of the equations, see :mod:`.dae`. ``holds``: levels of the
    constraints that hold at the end of a step, where no form says so. ``free_steps``: any size may follow any other.
    ``carries_pressure``: it moves pressures that are unknowns. ``start``: a start of its own, also for scenes with contact.
    ``refusal``: why it does not take what a scene holds, "" where it does.
    ``turn_limit``: angle (rad) by which rows of joints may turn in a step, None for any
    (:mod:`~fmbd_fenicsx.run.judges.turning_rows`).
    ``ends_ahead``: values at the ends of steps are of a higher order than those between them.
    ``takes_given``: under error control it takes steps of any sizes that it is given.
    ``orders``: of positions, velocities, and accelerations with multipliers, where there are any; None: the scheme's in all.
    ``of_friction``: the most of all of them where contacts or joints have friction, whose slips end within steps; None: the same.
    ``corrects``: of systems without fields, accelerations and multipliers that are read are of the order of velocities.
    ``forgets``: nothing is left after a few steps of vibrations that these do not resolve.
    ``finds_memories``: memories of continuous laws are found as the motion is, in the order of positions; else they go by the
    trapezoidal rule.
    ``looks_ahead``: under error control it looks for loads that come within a step before it tries one.
    ``carries_accelerations``: those of a step are told by those of the step before.
    ``early``: bodies rest before the last of their impacts, where these are over within a step, and may do otherwise.
    ``weighs``: under error control increments of Newton's iteration count as shares of its tolerance.
    ``timeless``: no scheme in time at all, as the pictures of a mode. ``compiled``: whether compiled code may evaluate.
    """

    rtol: float | None = None
    form: Any = None
    holds: tuple[int, ...] = ()
    free_steps: bool = False
    carries_pressure: bool = False
    start: Callable[..., Any] | None = None
    refusal: Callable[[Contents], str] | None = None
    turn_limit: float | None = None
    orders: tuple[int, int, int] | None = None
    of_friction: int | None = None
    ends_ahead: bool = False
    takes_given: bool = False
    corrects: bool = False
    forgets: bool = False
    finds_memories: bool = False
    looks_ahead: bool = False
    carries_accelerations: bool = False
    early: bool = False
    weighs: bool = False
    timeless: bool = False
    compiled: bool = True

    @classmethod
    def by(cls, scheme: Any) -> Declared:
        """What a scheme says, with what holds where it says nothing."""
        made = object.__new__(cls)  # asked many times a run, and nothing of it is checked
        made.__dict__.update({name: getattr(scheme, name, default) for name, default in _members()})
        return made

    def refuse(self, name: str, held: Contents) -> str:
        """Why the scheme ``name`` does not take what a scene holds, "" where it does; known before anything is computed."""
        if held.limits and self.start is None:
            return (
                f'{name} has no impacts, and the scene has the joint limit "{held.limits[0]}". Use fmbd.Moreau(), '
                "or fmbd.elastic_stop in its place."
            )

        if held.contacts and self.start is None:
            elastic = () if held.bouncing else ("ContactMidpoint()", "ContactAlpha()")
            bouncing = () if held.massless and elastic else ("Moreau()",)
            return (
                f'{name} does not treat contact, and the scene has "{held.contacts[0]}". '
                f"Use fmbd.{' or fmbd.'.join((*elastic, *bouncing))}."
            )

        if held.pressures and not self.carries_pressure:
            return (
                f'Body "{held.pressures[0]}" has a pressure that is an unknown; {name} does not solve for it. Use '
                "GeneralizedAlpha() with form=Index3(), Radau() or BDF(), or energy=neo_hookean_mixed(...)."
            )

        return "" if self.refusal is None else self.refusal(held)

    @property
    def adaptive(self) -> bool:
        """Whether the scheme chooses its steps."""
        return self.rtol is not None

    def accuracy(self, newton: Newton) -> float:
        """Mean relative error that iterations have left."""
        return newton.share * (self.rtol if self.weighs and self.rtol else newton.tolerance)

    @property
    def levels(self) -> tuple[int, ...]:
        """Levels of the constraints that hold at the end of a step: 0 positions, 1 velocities."""
        if self.form is None:
            return self.holds
        return (0, 1) if self.form.projected else tuple(self.form.levels)


@cache
def _members() -> tuple[tuple[str, Any], ...]:
    """Names of all members, with what holds where a scheme says nothing."""
    return tuple((f.name, f.default) for f in fields(Declared))


def checked_scheme(scheme: Any, what: str = "solve: scheme") -> Any:
    """A scheme's object: neither its class nor its name; ``what`` begins the message."""
    if isinstance(scheme, type):
        raise InputError(f"{what} is the class {scheme.__name__}; make an object of it: {scheme.__name__}(...).")
    if not callable(getattr(scheme, "stepper", None)):
        raise InputError(
            f"{what} {shown(scheme)} must be an object such as fmbd.GeneralizedAlpha() or fmbd.Radau(); see fmbd.schemes."
        )
    return scheme
