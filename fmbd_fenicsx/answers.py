"""Objects around another one: what they do not say themselves is the answer of that one."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any, TypeVar

Kind = TypeVar("Kind", bound=type)


class _Answer:
    """An attribute of instances that is one of another object; instances may have their own."""

    def __init__(self, place: str) -> None:
        self.of = attrgetter(place)

    def __get__(self, instance: Any, kind: type) -> Any:
        return self if instance is None else self.of(instance)


def answered_by(place: str, names: str) -> Callable[[Kind], Kind]:
    """For a class: attributes and methods of these names, with blanks between, are those of the object that instances have at a
    ``place``.
    """

    def of(kind: Kind) -> Kind:
        for name in names.split():
            setattr(kind, name, _Answer(f"{place}.{name}"))
        return kind

    return of
