"""Runs and steppers are no data: what to keep of them in place of a copy."""

from __future__ import annotations

from typing import Any, ClassVar

from ..errors import InputError


class Uncopied:
    """What holds compiled tables and matrices of PETSc: copies and pickles are refused, with what to take ``instead``."""

    instead: ClassVar[str]

    def __deepcopy__(self, memo: Any) -> Any:
        raise self._refusal()

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise self._refusal()

    def _refusal(self) -> InputError:
        return InputError(
            f"{type(self).__name__}: it holds compiled tables, which cannot be copied or pickled. {self.instead}"
        )
