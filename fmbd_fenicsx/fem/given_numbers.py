"""Numbers of a user's own in the forms of a body: DOLFINx constants and functions, whose values matrices and tables keep."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..errors import InputError
from ..ranks import rank_max


class GivenNumbers:
    """The values that compiled ``forms`` of a body had when they were assembled; ``placed``: functions that are no user's."""

    def __init__(self, comm: Any, forms: Iterable[Any], placed: Iterable[Any] = ()) -> None:
        self.comm, given = comm, list(forms)
        own = {id(u._cpp_object) for u in placed if u is not None}
        found = {id(u): u for form in given for u in compat.functions_of(form)}
        self._functions = [u for k, u in found.items() if k not in own]
        self._constants = [compat.reader_of_constants(form) for form in given]
        self._kept = self._now()

    def _now(self) -> list[bytes]:
        values = [*(constants() for constants in self._constants), *(u.x.array for u in self._functions)]
        return [x.tobytes() for x in values]

    @property
    def changed(self) -> bool:
        """Whether one has another value on this rank now."""
        return self._now() != self._kept


def refuse_changed(given: Mapping[str, GivenNumbers], since: str, instead: str) -> None:
    """Refuse others in the forms of bodies, by name, than those kept ``since`` something: what to do ``instead``. Collective.

    Raises:
        InputError: one has changed, on any rank.
    """
    if not given:
        return
    comm = max((x.comm for x in given.values()), key=lambda comm: comm.size)  # bodies of lines are whole on each rank
    changed = rank_max(comm, np.array([float(x.changed) for x in given.values()]))
    for body, here in zip(given, changed, strict=True):
        if here:
            raise InputError(
                f'Body "{body}": a dolfinx Constant or Function in its forms (elasticity, damping, loads or density) has changed '
                f"since {since}: its matrices keep the values from then. {instead}"
            )
