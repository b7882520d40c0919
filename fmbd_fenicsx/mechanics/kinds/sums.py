"""Sums of coordinates as a kind without kernels: compiled code adds up what those of the terms tell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import ClassVar

from .derivation import Kind
from .expressions import ZERO


@dataclass(frozen=True, eq=False)
class SumKind(Kind):
    """The kind of sums of terms between frames; a frame that several terms have in common stands once. ``into``: of each entry of
    the rows of the terms, one term after another, which output of the sum it adds to.
    """

    into: tuple[int, ...] = ()
    asked: ClassVar[bool] = True


@cache
def sum_kind(terms: tuple[Kind, ...], frames: tuple[int, ...]) -> SumKind:
    """The kind of sums of terms of these kinds; ``frames``: which frame of the sum is A and which is B of each term."""
    twist = 3 * (terms[0].dim - 1)
    each = [twist * frames[2 * k + x // twist] + x % twist for k, term in enumerate(terms) for x in term.entries]
    entries = tuple(sorted(set(each)))
    outputs = {"value": [ZERO] * (1 + len(entries)), "rates": [], "tangent": []}
    into = tuple(1 + entries.index(x) for x in each)
    return SumKind("sum", terms[0].dim, {}, entries, (), outputs, [], terms[0].frames, into=into)
