"""Increments of the stages of elastic fields in the driver (field_stages.c), by the matrices of their frequencies."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence

import numpy as np

from ....kernel_cache import address_of
from ....rotations import Array
from ...layout import State
from ..declarations import structure_of
from ..tables.structures import Sizes, zeros_of
from .evaluation import DriverStates
from .field_states import FactoredFieldStates
from .stages import ENDINGS, POINTS, PointRoom, Stages

FieldStages = structure_of("implicit/field_stages.c", "FieldStages")


class FieldStageRoom(PointRoom):
    """Room for p frequencies and k points of a form with these levels of constraints; ``square``: of the entries of lengths."""

    def __init__(self, states: DriverStates, levels: Sequence[int], shape: tuple[int, int], square: Array) -> None:
        system, (p, k) = states.tables.system, shape
        self.states, self.shape, self.twin = states, shape, states.twin
        n, m, frames = system.n_v, system.n_lam, system.n_frames
        size, width = n + len(levels) * m, len(levels) * m
        formulas = states.tables.formulas

        sizes: Sizes = {
            "s": (p, 2), "t": k, "q0": system.n_q, "xi": (k, n), "rate": (k, n), "v": (k, n), "vd": (k, n), "mult": (k, width),
            "couple": (k, k), "inverse": (p, k, 2), "vectors": (k, p, 2), "past": k * ENDINGS, "ends": ENDINGS,
            "kin": (k, n), "low": (k, size), "dxi": (k, n),
            "dv": (k, n), "dmult": (k, width), "push": (2 * k, n), "weigh": (3, n),
            "moved": 6, "judged": 2, "local": system.n_q + 2 * n,
            "sampled": (k, states.calls.written), "slopes": 2 * formulas,
            "given": k * (n + size) + n if formulas else 0,
        }  # fmt: skip
        made = zeros_of(sizes)
        self.arrays = {name: x for name, (x, _) in made.items()}

        twist = system.motions.n_twist
        of_fields: Sizes = {
            "q": system.n_q, "v": n, "a": n, "lam": m, "balance": size, "N": (m, n), "turnings": frames * twist**2 + n,
            "columns": states.tables.c.nu * m, "units": m * (n + m), "reactions": (m, m), "square": n, "before": p, "sizes": p,
            "kin": p * 2 * n, "low": p * 2 * size, "rate": p * 2 * n, "push": p * 2 * n, "x": p * 4 * n, "y": p * 2 * width,
            "b": 2 * n, "c": 2 * (n + m), "given": 2 * m, "found": 2 * m, "room": 3 * n + size,
            "closed": (3, n), "sampled": states.calls.written, **self._pressures(k),
        }  # fmt: skip

        more = zeros_of(of_fields)
        self.known = {name: x for name, (x, _) in more.items()}
        self.known["units"][m * n :] = np.eye(m).ravel()
        self.known["square"][:] = self.twin.velocities(square)
        self._by = np.zeros(p, np.uint64)
        self.fields = FieldStages(
            by=address_of(self._by), length=system.length, pressures=sum(self._counts),
            **{name: address for name, (_, address) in more.items()},
        )  # fmt: skip
        self.c = Stages(
            n=n, m=m, size=size, levels=len(levels), frequencies=p, points=k, first=levels[0] if levels else 0, relax=1.0,
            s=made["s"][1], fields=ctypes.addressof(self.fields),
            **{name: made[name][1] for name in (*POINTS, "given", "slopes")},
        )  # fmt: skip
        self._count_moving()
        self.address = ctypes.addressof(self.c)

    def _pressures(self, points: int) -> Sizes:
        """Sizes of what is there for pressures that are unknowns."""
        carried = [one.part.field for one in self.states.tables.fields if one.part.field.carried]
        self._counts = [field.n_pressure for field in carried]
        count = sum(self._counts)
        return {"pressure": (points, count), "opened": (points, count), "began": count}

    def take_outworn(self) -> State | None:
        """The motion where new tangents of fields are asked for, once; else None."""
        c, known = self.fields, self.known
        if not c.outworn:
            return None
        c.outworn, c.renewed, c.vain = 0, 1, 0
        v, a = map(self.twin.forces, (known["v"], known["a"]))
        return State(float(c.t), self.twin.places(known["q"]), v, a, known["lam"].copy())

    @property
    def origin(self) -> Array:
        """q where the step begins."""
        return self.twin.places(self.arrays["q0"])

    def begin(self, frequencies: Callable[[float], None], start: tuple[Array, ...] | None) -> None:
        """Steps begin: who lends matrices, see tables.py; what closes the start of the first, dq, v and a, or None.

        Matrices of an earlier call do not serve on, so that a run that is taken up makes the same steps.
        """
        self.states.tables.frequencies = frequencies
        self.arrays["t"][:] = np.nan
        self.fields.lent, self.fields.begun = 0.0, start is not None
        if start is not None:
            self.known["closed"][:] = self.twin.velocities(np.array(start))

    def solve_by(self, solvers: Sequence[FactoredFieldStates]) -> None:
        """Take those who have the matrices of the frequencies."""
        self.fields.lent = 0.0
        self._solvers = solvers
        for states in solvers:
            self.states.tables.listening.share(states.tables.listening)
        self._by[:] = [states.address for states in solvers]
        self.known["before"][:] = 0.0
