"""Steps whose sizes error control chooses, in the driver (driver/marches/own_steps.c): what Python lends of that."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...kernel_cache import address_of
from ...rotations import Array
from ..system import System
from .declarations import structure_of
from .tables.resting import Twin
from .tables.structures import Store, array_of, structure

OwnSteps = structure_of("marches/own_steps.c", "OwnSteps")


def _deflections(system: System, deforming: list[tuple[int, Any]], store: Store) -> Any:
    """The parts of these numbers, with the places of their coordinates."""
    one = structure("Deflection", system.motions.dim)
    return array_of(one, len(deforming))(
        *(
            one(
                at_q=system.slices[0][k].start,
                at_v=system.slices[1][k].start,
                n=part.n,
                rms=None if part.rms is None else store.address(part.rms),
            )
            for k, part in deforming
        )
    )


class OwnRoom:
    """Lends an error control: parts that deform, numbers by their names in own_steps.c; ``error``, ``between``: weights of
    estimates, ``orders``: of BDF.
    """

    def __init__(
        self,
        twin: Twin,
        deforming: list[tuple[int, Any]],
        numbers: Mapping[str, float],
        *,
        error: Array | None = None,
        between: Array | None = None,
        orders: ctypes.Structure | None = None,
    ) -> None:
        self._store, self.orders = Store(), orders
        self._marks: Array = np.zeros(0)
        system, own = twin.system, twin.original
        # where coordinates of the core stand
        self._core = np.flatnonzero(twin.velocities(np.repeat((1.0, 0.0), (own.n_core, own.n_v - own.n_core))))
        self._deflections = _deflections(system, deforming, self._store)
        self._arrays = {name: self._store.zeros({name: system.n_v})[name] for name in ("sizes", "speeds", "scale")}
        self.c = OwnSteps(
            deforming=len(deforming), deflection=self._store.structure(self._deflections),
            error=None if error is None else self._store.address(error),
            between=None if between is None else self._store.address(between),
            orders=None if orders is None else ctypes.addressof(orders),
            **{name: address for name, (_, address) in self._arrays.items()}, **numbers,
        )  # fmt: skip
        self.address = ctypes.addressof(self.c)

    def lend(self, sizes: Array, speeds: Array, deflections: Array) -> None:
        """The largest sizes so far."""
        for name, values in (("sizes", sizes), ("speeds", speeds)):
            self._arrays[name][0][self._core] = values
        for one, size in zip(self._deflections, deflections, strict=True):
            one.size = size

    def pass_by(self, marks: Sequence[float]) -> None:
        """The next march hits these times (s), rising, and goes on."""
        self._marks = np.array(marks, dtype=float)
        self.c.mark, self.c.marks, self.c.passed = address_of(self._marks), len(marks), 0

    def told(self) -> tuple[Array, Array, Array]:
        """The largest sizes behind a march."""
        sizes, speeds = (self._arrays[name][0][self._core] for name in ("sizes", "speeds"))
        return sizes, speeds, np.array([one.size for one in self._deflections])


class BentBodies:
    """Room in which norms weigh deformations of rods and frames apart from rigid motions; none without such bodies."""

    def __init__(self, system: Any) -> None:
        sizes = [1 + 36 * len(rod.nodes) for rod in system.elements]
        sizes += [system.motions.dim**2 for part in system.parts if part.mean_rates is not None]
        self._arrays = (np.zeros(system.n_v), np.zeros(sum(sizes))) if sizes else ()

    def lend(self, norm: Any, *, apart: bool) -> None:
        """Give it to a norm, or say that nothing counts apart."""
        norm.bases = None
        if apart and self._arrays:
            norm.bent, norm.bases = map(address_of, self._arrays)
