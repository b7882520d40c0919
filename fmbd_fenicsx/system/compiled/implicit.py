"""Steps of Radau and BDF in the driver (driver/implicit.c): what it lends of a scheme, and the room that it works in."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...kernel_cache import address_of
from ...rotations import Array
from .declarations import enumeration, fields_of
from .states.convergence import Convergence
from .states.stages import PointRoom
from .tables.deflections import deflections_of
from .tables.resting import Twin
from .tables.structures import Store

# what a state keeps first
RATE, KNOWN, TANGENTS, FACTORED, INCREMENTS, RESIDUAL, RESIDUAL_SCALE, WORK = enumeration("RATE", "implicit.c").values()


class Implicit(ctypes.Structure):
    """``Implicit`` of implicit.c."""

    _fields_ = fields_of("implicit.c", "Implicit")


class OwnSteps(ctypes.Structure):
    """``OwnSteps`` of own_steps.c."""

    _fields_ = fields_of("own_steps.c", "OwnSteps")


class Orders(ctypes.Structure):
    """``Orders`` of bdf.c."""

    _fields_ = fields_of("bdf.c", "Orders")

    def lend(self, spans: Mapping[int, Array], uses: int, most: int) -> None:
        """The sizes with which each order amplifies vibrations, (k, 2), s; ``uses``: of these so far, ``most`` of them."""
        self._kept = np.concatenate([np.zeros((0, 2)), *spans.values()])
        self.spans, self.uses, self.most, count = address_of(self._kept), uses, most, 0
        for order in range(len(self.first)):
            self.first[order] = count
            count += len(spans.get(order, ()))


class OwnRoom:
    """Lends an error control: parts that deform, numbers by their names in own_steps.c; ``error``: weights of Radau's estimate,
    ``orders``: of BDF.
    """

    def __init__(
        self,
        twin: Twin,
        deforming: list[tuple[int, Any]],
        numbers: Mapping[str, float],
        *,
        error: Array | None = None,
        orders: Orders | None = None,
    ) -> None:
        self._store, self.orders, self._twin = Store(), orders, twin
        system, own = twin.system, twin.original
        self._fields = own.n_v - own.n_core  # coordinates
        self._deflections = deflections_of(system, deforming, self._store)
        self._arrays = {name: self._store.zeros({name: system.n_v})[name] for name in ("sizes", "speeds", "scale")}
        self.c = OwnSteps(
            deforming=len(deforming), deflection=self._store.structure(self._deflections),
            error=None if error is None else self._store.address(error),
            orders=None if orders is None else ctypes.addressof(orders),
            **{name: address for name, (_, address) in self._arrays.items()}, **numbers,
        )  # fmt: skip
        self.address = ctypes.addressof(self.c)

    def lend(self, sizes: Array, speeds: Array, deflections: Array) -> None:
        """The largest sizes so far."""
        for name, values in (("sizes", sizes), ("speeds", speeds)):
            self._arrays[name][0][:] = self._twin.velocities(np.append(values, np.zeros(self._fields)))
        for one, size in zip(self._deflections, deflections, strict=True):
            one.size = size

    def told(self) -> tuple[Array, Array, Array]:
        """The same behind a march."""
        core = self._twin.original.n_core
        sizes, speeds = (self._twin.forces(self._arrays[name][0])[:core].copy() for name in ("sizes", "speeds"))
        return sizes, speeds, np.array([one.size for one in self._deflections])


class ImplicitRoom:
    """Lends the ``stages`` of a scheme with its coefficients; ``order``: of multistep ones, ``own``: control of its steps."""

    def __init__(
        self, stages: PointRoom, coefficients: Mapping[str, Array], order: int = 0, own: OwnRoom | None = None
    ) -> None:
        self.stages, self.own = stages, own
        stages.weigh_bent(apart=own is not None and own.c.index < 3)
        n, size, points, tables = stages.c.n, stages.c.size, stages.c.points, stages.states.tables
        mixed = np.empty((max(points, order + 1) + 14) * n + 2 * tables.system.n_q + 6 * size + tables.nu)
        self._kept = [mixed, *(np.ascontiguousarray(x) for x in coefficients.values())]
        self.c = Implicit(
            stages=stages.address, mixed=address_of(mixed), order=order, own=None if own is None else own.address,
            **stages.of_tangents(), **dict(zip(coefficients, map(address_of, self._kept[1:]), strict=True)),
        )  # fmt: skip
        self.address = ctypes.addressof(self.c)

    def settle(self, convergence: Convergence, limits: Mapping[str, float]) -> None:
        """When iterations end: ``rtol``, ``floor``, ``slow`` and ``longer`` of implicit.c."""
        self._convergence = convergence
        self.c.convergence = ctypes.addressof(convergence)
        for name, value in limits.items():
            setattr(self.c, name, value)


def work_of(theta: float, *, known: bool) -> Array:
    """What a state keeps first where a march begins: the rate of Newton's iteration, and whether the tangent serves on."""
    work = np.zeros(WORK)
    work[RATE], work[KNOWN] = theta, known
    return work
