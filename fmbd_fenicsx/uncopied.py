"""Runs, steppers, equilibria and modes are no data: what to keep of them in place of a copy, and what they have."""

from __future__ import annotations

from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, ClassVar

from .errors import InputError


class Uncopied:
    """What holds compiled tables and matrices of PETSc: copies and pickles are refused, with what to take ``instead``."""

    instead: ClassVar[str]

    if not TYPE_CHECKING:  # type checkers know what there is

        def __getattr__(self, name: str) -> Any:
            """Only what is not there comes here."""
            public = [known for known in dir(self) if not known.startswith("_")]
            close = ", ".join(get_close_matches(name, public, n=3)) or "dir(...) lists all names"
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}; near it: {close}")

    def __deepcopy__(self, memo: Any) -> Any:
        raise self._refusal()

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise self._refusal()

    def _refusal(self) -> InputError:
        return InputError(
            f"{type(self).__name__}: it holds compiled tables, which cannot be copied or pickled. {self.instead}"
        )
