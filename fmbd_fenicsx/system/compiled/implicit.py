"""Steps of Radau and BDF in the driver (driver/implicit/implicit.c): what it lends of a scheme, and the room that it works in."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping

import numpy as np

from ...kernel_cache import address_of
from ...rotations import Array
from .declarations import enumeration, fields_of
from .own_steps import BentBodies, OwnRoom
from .states.convergence import Convergence
from .states.stages import PointRoom

SOURCE = "implicit/implicit.c"
# what a state keeps first
RATE, KNOWN, TANGENTS, FACTORED, INCREMENTS, RESIDUAL, RESIDUAL_SCALE, WORK = enumeration("RATE", SOURCE).values()


class Implicit(ctypes.Structure):
    """``Implicit`` of implicit.c."""

    _fields_ = fields_of(SOURCE, "Implicit")


class OrdersOfBDF(ctypes.Structure):
    """``Orders`` of bdf.c."""

    _fields_ = fields_of("implicit/bdf.c", "Orders")

    def lend(self, spans: Mapping[int, Array], uses: int, most: int) -> None:
        """The sizes with which each order amplifies vibrations, (k, 2), s; ``uses``: of these so far, ``most`` of them."""
        self._kept = np.concatenate([np.zeros((0, 2)), *spans.values()])
        self.spans, self.uses, self.most, self.taken, count = address_of(self._kept), uses, most, 0.0, 0
        for order in range(len(self.first)):
            self.first[order] = count
            count += len(spans.get(order, ()))


class ImplicitRoom:
    """Lends the ``stages`` of a scheme with its coefficients; ``order``: of multistep ones, ``own``: control of its steps."""

    def __init__(
        self, stages: PointRoom, coefficients: Mapping[str, Array], order: int = 0, own: OwnRoom | None = None
    ) -> None:
        self.stages, self.own = stages, own
        n, size, points, tables = stages.c.n, stages.c.size, stages.c.points, stages.states.tables
        bent = BentBodies(tables.system)
        bent.lend(stages.c, apart=own is not None and own.c.index < 3)
        mixed = np.empty((max(points, order + 1) + 14) * n + 2 * tables.system.n_q + 6 * size + tables.nu)
        self._kept = [mixed, bent, *(np.ascontiguousarray(x) for x in coefficients.values())]
        self.c = Implicit(
            stages=stages.address, mixed=address_of(mixed), order=order, own=None if own is None else own.address,
            **stages.of_tangents(), **dict(zip(coefficients, map(address_of, self._kept[2:]), strict=True)),
        )  # fmt: skip
        self.address = ctypes.addressof(self.c)

    def settle(self, convergence: Convergence, limits: Mapping[str, float]) -> None:
        """When iterations end: ``rtol``, ``floor`` and ``slow`` of implicit.c."""
        self._convergence = convergence
        self.c.convergence = ctypes.addressof(convergence)
        for name, value in limits.items():
            setattr(self.c, name, value)


def work_of(theta: float, *, known: bool) -> Array:
    """What a state keeps first where a march begins: the rate of Newton's iteration, and whether the tangent serves on."""
    work = np.zeros(WORK)
    work[RATE], work[KNOWN] = theta, known
    return work
