"""Constant steps of Radau and BDF in the driver (driver/implicit.c): what it lends of a scheme, and the room that it works in."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping

import numpy as np

from ...rotations import Array
from .states.convergence import Convergence
from .states.stages import StageRoom
from .tables.structures import address_of

COEFFICIENTS = "c W values middle basis stage_basis".split()  # of Radau
# what a state keeps first
RATE, KNOWN, TANGENTS, FACTORED, INCREMENTS, RESIDUAL, RESIDUAL_SCALE = range(WORK := 7)
_INT, _POINTER, _REAL = ctypes.c_int, ctypes.c_void_p, ctypes.c_double


class Implicit(ctypes.Structure):
    """``Implicit`` of implicit.c."""

    _fields_ = (
        *((name, _POINTER) for name in "stages patterns convergence data masses room mixed".split()),
        *((name, _POINTER) for name in COEFFICIENTS),
        ("order", _INT),
        *((name, _REAL) for name in "factored failed rtol floor slow longer".split()),
    )


class ImplicitRoom:
    """Lends the ``stages`` of a scheme with its coefficients; ``order``: of a multistep scheme."""

    def __init__(self, stages: StageRoom, coefficients: Mapping[str, Array], order: int = 0) -> None:
        self.stages, structure = stages, stages.structure
        system, points = structure.couplings.system, stages.c.points
        n, n_q, size = structure.n, system.n_q, structure.size
        mixed = np.empty((max(points, order + 1) + 5) * n + 2 * (n_q + size))
        self._kept = [mixed, *(np.ascontiguousarray(x) for x in coefficients.values())]
        self.c = Implicit(
            stages=stages.address, patterns=structure.address, data=address_of(stages.data),
            masses=address_of(structure.masses), room=structure.room_address, mixed=address_of(mixed), order=order,
            **dict(zip(coefficients, map(address_of, self._kept[1:]), strict=True)),
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
