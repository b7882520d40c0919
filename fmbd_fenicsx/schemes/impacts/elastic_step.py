"""Steps of elastic contact: Newton's iteration with the contacts that are near, and without an increment that would only confirm.

Where nothing but smooth functions makes a step with given contacts nonlinear, a second increment is roundoff, or grows with the
square of the first: a step in which both are known foretells that of later ones with the same contacts, whose normals stay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ...mechanics.contact.rows import Rows
from ...mechanics.elastic.absolute import AbsoluteField
from ...mechanics.forces.force_elements import TimeLoads
from ...rotations import Array
from ...system.evaluation import Evaluation
from ...system.system import System
from .contact_newton import ContactStep

if TYPE_CHECKING:
    from .elastic_contact_stepper import ElasticContactStepper

MARGIN = 10.0  # of what is foretold
RELIED = 15  # steps that may rely on one


@dataclass(frozen=True)
class Confirmed:
    """The increments (m) of a step of size h (s) in which a second one confirmed the first.

    ``candidates``: which were near, as text that checkpoints hold; ``relied``: how many steps have relied on it since then.
    """

    h: float
    candidates: str
    first: float
    second: float
    relied: int = 0

    def left(self, size: float) -> float:
        """The error (m) that a first increment of a size leaves in a step alike."""
        return MARGIN * self.second * max(1.0, (size / self.first) ** 2) if self.relied < RELIED else math.inf


def is_smooth(system: System) -> bool:
    """Whether a step with given contacts whose normals stay is linear: so are bodies, none turns, loads depend on time alone."""
    linear = all(isinstance(part, AbsoluteField) and not part.field.nonlinear for _, part in system.fields)
    return linear and not system.n_frames and all(type(loads) is TimeLoads for loads in system.forces)


class ElasticStep(ContactStep):
    """One step with the candidates ``near``, (m,) bool, which begin with the forces of the last step."""

    p: ElasticContactStepper  # type: ignore[assignment]
    tolerance: float  # m, of the newest increment
    q: Array  # at its end

    def __init__(self, stepper: ElasticContactStepper, h: float, near: np.ndarray) -> None:
        super().__init__(stepper, h, stepper.ledger.force[near])
        self.near = near
        self._unconfirmed = self._turned = False  # _turned: whether normals have changed in the iteration

    def solve(self) -> int:
        """As :meth:`ContactStep.solve`."""
        p, candidates = self.p, self.near.tobytes().hex()
        known = p.confirmed
        if known is not None and (known.h, known.candidates) != (self.h, candidates):
            known = None
        history = self.iterate(
            lambda size: math.inf if known is None else known.left(size * self.tolerance) / self.tolerance
        )

        if known is not None and len(history) == 1:
            self._unconfirmed = True
            p.confirmed = replace(known, relied=known.relied + 1)
            return 1

        told = p.smooth and len(history) == 2 and not self._turned
        first, second = (x * self.tolerance for x in history) if told else (0.0, 0.0)
        p.confirmed = Confirmed(self.h, candidates, first, second) if told else None
        return len(history)

    def changes(
        self, touching: tuple[Rows, Array] | None, residuals: tuple[Array, Array], scale: float
    ) -> tuple[Array, Array]:
        """As :meth:`ContactStep.changes`."""
        before = self.contact.rows
        if touching is not None and before is not None and not self._turned:
            self._turned = bool((before.normal != touching[0].normal).any())
        return super().changes(touching, residuals, scale)

    @property
    def end(self) -> Evaluation:
        """The system where the forces of the step act, as it was found."""
        if self._unconfirmed:
            self.ev, self._unconfirmed = self.p.system.at(*self.where()), False
        return self.ev

    def where(self) -> tuple[float, Array, Array]:
        """t, q and v there."""
        raise NotImplementedError
