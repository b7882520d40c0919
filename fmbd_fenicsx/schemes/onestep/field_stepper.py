"""Compiled steps of systems with floating elastic fields: the driver needs the fields' factors of a step's size first.

There is one driver for each set of factors that the solver keeps, so that steps may change between a few sizes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .alpha_driver import AlphaDriver, alpha_driver
from .compiled_stepper import CompiledAlphaStepper

if TYPE_CHECKING:
    from ...linear.blocks.field_blocks import FactoredField
    from ...rotations import Array
    from ...run.judges.energy_check import Watch
    from ...system.compiled.recording import Openness, Tape


NEXT = 3  # block of a ring that a step writes


class FieldStepper(CompiledAlphaStepper):
    """The same; the first step of a size, and the first new tangent of a frame with mean axes, are NumPy's."""

    def __init__(self, data: Any, driver: AlphaDriver | None) -> None:
        self._drivers: list[AlphaDriver] = []  # the one used last is the last
        super().__init__(data, driver)

    def _use(self, driver: AlphaDriver) -> None:
        super()._use(driver)
        driver.tables.renewed = self._renewed

    def _renewed(self, t: float, increments: dict[int, Array]) -> list[FactoredField]:
        """The fields' blocks with new tangents, for the driver in use, at the state that it evaluated last."""
        _, q, v, a, _, lam = self.driver.block(NEXT)
        ev = self.system.at(t, q, v)
        ev.forces = a, lam  # whose stress the tangents take
        self.driver.field_blocks = self.solver.renew_fields(ev, increments)
        return self.solver.blocks

    def _first_march(self, h: float, watch: Watch | None = None, tape: Tape | None = None) -> int:
        return 0

    def _march(self, h: float, steps: int, watch: Watch | None = None, tape: Tape | None = None) -> int:
        return super()._march(h, steps, watch, tape) if not self.fresh and self._ready(h) else 0

    def tape(self, judged: Openness) -> Tape | None:
        """Room for records, as soon as there are factors of a step."""
        return super().tape(judged) if not self.fresh and self._bound() else None

    def _ready(self, h: float) -> bool:
        """Whether the driver has the solver's factors, and these are those of a step of size h (s)."""
        return bool(self.solver.blocks) and self.solver.weights.ck == self.scheme.rule(h).weights.ck and self._bound()

    def _bound(self) -> bool:
        """Whether there is a driver with the solver's present factors."""
        solver = self.solver
        if solver.split is not None or not solver.blocks:
            return False
        if self._driver is None or self._driver.field_blocks is not solver.blocks:
            found = self._driver_of_factors()
            if found is None:
                return False
            self._settle()
            self._use(found)
        return True

    def _driver_of_factors(self) -> AlphaDriver | None:
        """The driver with the solver's present factors, an earlier one where there is one."""
        solver = self.solver
        found = next((d for d in self._drivers if d.field_blocks is solver.blocks), None)
        if found is None:
            found = alpha_driver(self.system, redundant=solver.core.redundant, blocks=solver.blocks)
        if found is not None:
            others = [d for d in self._drivers if d is not found]
            self._drivers = [*others, found][-solver.elastic.kept :]
        return found
