"""Compiled steps of systems with floating elastic fields: the driver needs the fields' factors of a step's size first.

Its tables go on with other factors when the size of steps changes, and in other runs of the system.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...stepping import UNOBSERVED, Observers
from .alpha_driver import AlphaDriver, alpha_driver
from .compiled_stepper import CompiledAlphaStepper

if TYPE_CHECKING:
    from ....linear.blocks.field_blocks import FactoredField
    from ....mechanics.placements import Approach
    from ....system.compiled.tape import Openness, Tape


NEXT = 3  # block of a ring that a step writes


class FieldStepper(CompiledAlphaStepper):
    """The same; the first new tangent of a frame with mean axes is NumPy's."""

    def _use(self, driver: AlphaDriver) -> None:
        super()._use(driver)
        driver.tables.renewed, driver.tables.user = self._renewed, self
        driver.tables.look_at_end = self._look_at_end

    def _renewed(self, t: float, increments: dict[int, Approach]) -> list[FactoredField]:
        """The fields' blocks with new tangents, for the driver in use, at the state that it evaluated last."""
        _, q, v, a, _, lam = self.driver.block(NEXT)
        ev = self.system.at(t, q, v)
        ev.forces = a, lam  # whose stress the tangents take
        return self.solver.renew_fields(ev, increments)

    def _look_at_end(self) -> None:
        """Refuse the end of a step that stores more than there was, as :meth:`AlphaStepper._stays`."""
        after = self.driver.block(NEXT)
        self._stays(self.driver.state(), after[0], after[1])

    def _march(self, h: float, steps: int, observers: Observers = UNOBSERVED) -> int:
        return super()._march(h, steps, observers) if not self.fresh and self._ready(h) else 0

    def tape(self, judged: Openness) -> Tape | None:
        """Room for records, as soon as there are factors of a step."""
        return super().tape(judged) if not self.fresh and self._bound() else None

    @property
    def is_driven(self) -> bool:
        """As :meth:`AlphaStepper.is_driven`."""
        return not self.fresh and self._bound()

    def _ready(self, h: float) -> bool:
        """Whether the driver has the solver's factors, and these are those of a step of size h (s)."""
        return bool(self.solver.blocks) and self.solver.weights.ck == self.scheme.rule(h).weights.ck and self._bound()

    def _bound(self) -> bool:
        """Whether there is a driver with the solver's present factors, for the steps of this stepper."""
        solver = self.solver
        parts = (part for _, part in self.system.fields)
        current = solver.blocks and all(b.in_use == part.in_use for b, part in zip(solver.blocks, parts, strict=True))
        if not solver.eliminates or not current:
            return False
        tables = None if self._driver is None else self._driver.tables
        if tables is not None and tables.user is self and tables.blocks is solver.blocks:
            return True
        self._settle()
        found = self._driver_of_factors()
        if found is not None:
            self._use(found)
        return found is not None

    def _driver_of_factors(self) -> AlphaDriver | None:
        """The driver with the solver's present factors: the one in use, where its tables go on with them."""
        solver, driver = self.solver, self._driver
        if driver is not None and driver.tables.take(solver.blocks):
            return driver
        return alpha_driver(self.system, redundant=solver.core.redundant, blocks=solver.blocks)
