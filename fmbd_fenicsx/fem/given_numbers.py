"""Numbers of a user's own in the forms of a body: DOLFINx constants and functions, whose values matrices and tables keep."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..errors import InputError
from ..ranks import rank_max
from ..rotations import Array


class GivenNumbers:
    """The values that compiled ``forms`` of a body had when they were assembled; ``placed``: functions that are no user's."""

    def __init__(self, comm: Any, forms: Iterable[Any], placed: Iterable[Any] = ()) -> None:
        self.comm, given = comm, list(forms)
        own = {id(u._cpp_object) for u in placed if u is not None}
        found = {id(u): u for form in given for u in compat.functions_of(form)}
        self._functions = [u for k, u in found.items() if k not in own]
        self._constants = [compat.reader_of_constants(form) for form in given]
        self._kept = [x.copy() for x in self._now()]

    def _now(self) -> list[Array]:
        return [*(constants() for constants in self._constants), *(u.x.array for u in self._functions)]

    def refuse_changed(self, body: str, since: str, instead: str) -> None:
        """Refuse others than those that were kept ``since`` something, with what to do ``instead``; collective.

        Raises:
            InputError: one has changed, on any rank.
        """
        same = all(map(np.array_equal, self._now(), self._kept))
        if rank_max(self.comm, np.array(float(not same))) > 0:
            raise InputError(
                f'Body "{body}": a dolfinx Constant or Function in its forms (elasticity, damping, loads or density) has changed '
                f"since {since}: its matrices keep the values from then. {instead}"
            )
