"""What a run in progress remembers, written and read by one and the same method of each worker.

A worker with a memory (a time stepper, an error norm) says what it keeps, and of which kind each attribute is:

    class Stepper(TimeStepper):
        keeps = {"state": Memory.state, "A": Memory.like_v, "count": plain(), "norm": worker}

When a checkpoint is written each value is taken note of; when it is read, the attribute gets the value of the checkpoint.
Numbers, strings, arrays, lists, tuples, dictionaries and dataclasses of these are :func:`plain` and equal on all ranks. What is
distributed has kinds of its own: it is kept in an order that does not depend on the number of ranks
(:mod:`fmbd_fenicsx.fem.numbering`). A worker whose memory is more than values, say a factor that is made again, adds to the
method ``remember``, which does both.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from ..errors import InputError
from .layout import State
from .system import System


class Memory:
    """Names and values of one worker; ``reading`` tells the direction. Methods with arrays of fields are collective."""

    def __init__(self, system: System, values: dict[str, Any] | None = None) -> None:
        self.system, self.reading = system, values is not None
        self.values: dict[str, Any] = {} if values is None else values

    def inside(self, name: str) -> Memory:
        """The memory of a worker inside this one."""
        if self.reading:
            return Memory(self.system, self.values[name])
        made = Memory(self.system)
        self.values[name] = made.values
        return made

    def each(self, name: str, items: Sequence[tuple[Any, ...]], width: int) -> Iterator[tuple[Memory, tuple[Any, ...]]]:
        """A memory for each of several tuples of that width; the tuples hold None when reading."""
        count = self(f"{name} count", len(items))
        for k in range(count):
            yield self.inside(f"{name} {k}"), (None,) * width if self.reading else items[k]

    def __call__(self, name: str, value: Any, *types: type) -> Any:
        """Plain data, equal on all ranks; ``types``: the dataclasses that it may hold."""
        if self.reading:
            return _made(self.values[name], {t.__name__: t for t in types})
        self.values[name] = _plain(value)
        return value

    # -- distributed --------------------------------------------------------------------------------------------
    def nodal(self, name: str, x: Any, numbering: Any) -> Any:
        """Values at the nodes that this rank owns, (n k,); ``numbering`` None: equal on all ranks."""
        if numbering is None:
            return self(name, x)
        if self.reading:
            return numbering.pick(self.values[name])
        self.values[name] = numbering.collect(x)
        return x

    def like_v(self, name: str, x: Any) -> Any:
        """An array like v."""
        return self._parts(name, x, self.system.slices[1])

    def past(self, name: str, x: Any) -> list[tuple[float, Any, Any]]:
        """Earlier values: times, arrays like v, multipliers."""
        return [(i("t", t), i.like_v("a", a), i("lam", lam)) for i, (t, a, lam) in self.each(name, x, 3)]

    def like_q(self, name: str, x: Any) -> Any:
        """An array like q."""
        return self._parts(name, x, self.system.slices[0])

    def _parts(self, name: str, x: Any, slices: list[slice]) -> Any:
        fields = self.system.fields
        if not fields:
            return self(name, x)
        inner = self.inside(name)
        first = slices[fields[0][0]].start
        core = inner("core", None if self.reading else x[:first])
        own = []
        for k, part in fields:
            mine = None if self.reading else x[slices[k]]
            own.append(inner.nodal(f"part {k}", mine, part.field.numbering))
        return np.concatenate((core, *own)) if self.reading else x

    def candidates(self, name: str, x: Any, pair: int | None = None) -> Any:
        """Rows of the contacts' candidates, (m, ...), or of those of one pair."""
        if "candidate order" not in self.system.cache:
            self.system.cache["candidate order"] = _order(self.system)
        order = self.system.cache["candidate order"]
        if pair is not None:
            counts = [p.count for p in self.system.contacts.pairs]
            first = sum(counts[:pair])
            order = order[first : first + counts[pair]] - first
        if not self.reading:
            self.values[name] = x[order]
            return x
        out = np.empty_like(self.values[name])
        out[order] = self.values[name]
        return out

    def state(self, name: str, s: Any) -> Any:
        """A state, with contact forces where it has some."""
        m = self.inside(name)
        none = s is None
        t = m("t", None if none else s.t)
        q = m.like_q("q", None if none else s.q)
        v = m.like_v("v", None if none else s.v)
        a = m.like_v("a", None if none else s.a)
        lam = m("lam", None if none else s.lam)
        from .sensors.contact import ContactForces, ContactState

        forces = s.contact if isinstance(s, ContactState) else None
        if not m("touched", forces is not None):
            return State(t, q, v, a, lam) if self.reading else s

        found = {}
        for f in dataclasses.fields(ContactForces):
            keep = m if f.name in ("names", "time", "impulse", "work") else m.candidates
            found[f.name] = keep(f.name, getattr(forces, f.name, None))
        return ContactState(t, q, v, a, lam, ContactForces(**found)) if self.reading else s


Keep = Callable[[Memory, str, Any], Any]  # how a value goes to a memory by its name, and back


def plain(*types: type) -> Keep:
    """Plain data, equal on all ranks; ``types``: the dataclasses that it may hold."""
    return lambda m, name, value: m(name, value, *types)


def worker(m: Memory, name: str, value: Any) -> Any:
    """A worker inside this one, with a memory of its own; None where there is none."""
    if value is not None:
        value.remember(m.inside(name))
    return value


class Remembering:
    """A worker with a memory. ``keeps``: its attributes that a checkpoint holds, each with its kind; None: it does not say."""

    keeps: ClassVar[Mapping[str, Keep] | None] = None

    def remember(self, m: Memory) -> None:
        """Write what is kept to a memory, or take it from there; collective.

        Raises:
            InputError: a worker of the user's own that does not say what it keeps.
        """
        if self.keeps is None:
            raise InputError(
                f"{type(self).__module__}.{type(self).__qualname__} does not say what it remembers: give it keeps = {{...}}, "
                "see docs/contributing.md, or leave out checkpoint."
            )
        for name, keep in self.keeps.items():
            setattr(self, name, keep(m, name, getattr(self, name)))


def _order(system: System) -> np.ndarray:
    """Candidates sorted by pair, then by the number of their node that does not depend on the ranks; collective."""
    pair, nodes = [], []
    for i, p in enumerate(system.contacts.pairs):
        at = p.trace_nodes
        if at is not None:
            trace = system.contacts.traces[p.slave.trace]
            at = trace.body_nodes.numbering.of[trace.global_numbers[at]]
        nodes.append(np.arange(p.count) if at is None else at)
        pair.append(np.full(p.count, i))
    return np.lexsort((np.concatenate(nodes), np.concatenate(pair)))


def _plain(x: Any) -> Any:
    """Dataclasses as tuples ("dataclass", name, fields), all the way down."""
    if dataclasses.is_dataclass(x) and not isinstance(x, type):
        return ("dataclass", type(x).__name__, {f.name: _plain(getattr(x, f.name)) for f in dataclasses.fields(x)})
    if type(x) in (list, tuple):
        return type(x)(_plain(y) for y in x)
    return {k: _plain(y) for k, y in x.items()} if type(x) is dict else x


def _made(x: Any, types: dict[str, type]) -> Any:
    """Back from :func:`_plain`."""
    if type(x) is tuple and len(x) == 3 and isinstance(x[0], str) and x[0] == "dataclass":
        return types[x[1]](**{k: _made(y, types) for k, y in x[2].items()})
    if type(x) in (list, tuple):
        return type(x)(_made(y, types) for y in x)
    return {k: _made(y, types) for k, y in x.items()} if type(x) is dict else x
