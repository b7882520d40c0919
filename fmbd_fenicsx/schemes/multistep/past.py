"""The past of a multistep method, and the polynomials through it.

With values x_j at times t_j, newest first, and the Lagrange polynomials l_j of these times:

    x(t) = sum_j l_j(t) x_j,        x'(t) = sum_j l_j'(t) x_j                                                       (1)

Configurations are taken as increments xi_j from the newest one, of as many turns as the velocities tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...polynomials import lagrange
from ...rotations import Array
from ...system.layout import State
from ...system.serialisation import Memory
from ...system.system import System

LONGEST = 8  # values that are kept


@dataclass(frozen=True)
class Past:
    """One earlier value: time, configuration, velocity, multipliers."""

    t: float
    q: Array
    v: Array
    mult: Array


def keep_past(m: Memory, name: str, past: list[Past]) -> list[Past]:
    """Past values, in an order that does not depend on the ranks."""
    items = [] if m.reading else [(p.t, p.q, p.v, p.mult) for p in past]
    return [
        Past(i("t", t), i.like_q("q", q), i.like_v("v", v), i("mult", mult))
        for i, (t, q, v, mult) in m.each(name, items, 4)
    ]


def before(system: System, state: State, h: float, mult: Array) -> Past:
    """A value h (s) before the start, by Taylor's formula, for the first predictor."""
    back = -h * state.v + 0.5 * h * h * state.a
    return Past(state.t - h, system.compose(state.q, back), state.v - h * state.a, mult)


def local(system: System, q0: Array, past: list[Past]) -> tuple[Array, Array, Array]:
    """Times (k,), and xi, v of past values in coordinates about the newest configuration q0, (k, n_v) each."""
    t = np.array([p.t for p in past])
    v = np.array([p.v for p in past])
    q = np.array([p.q for p in past])
    return t, increments(system, q0, (t, q, v)), v


def increments(system: System, q0: Array, past: tuple[Array, Array, Array]) -> Array:
    """xi of past values (.., k) of t, q and v, the newest first, in coordinates about configurations q0."""
    t, q, v = past
    # the way back by the trapezoid rule tells how many turns lie between
    ways = 0.5 * (t[..., 1:] - t[..., :-1])[..., None] * (v[..., 1:, :] + v[..., :-1, :])
    guess = np.zeros(v.shape)
    np.add.accumulate(ways, axis=-2, out=guess[..., 1:, :])
    xi = np.array(system.difference(q0, q, near=guess))
    xi[..., 0, :] = 0.0
    return xi


def weights(nodes: Array, t: float) -> Array:
    """l_j(t) of (1), (k,)."""
    return np.array(lagrange([float(x) for x in nodes], t))


def slopes(nodes: Array, t: Array) -> Array:
    """l_j'(t) of (1) at any times (..), 1/s, (.., k)."""
    span = np.ptp(nodes, axis=-1)[..., None]
    powers = ((nodes - t[..., None]) / span)[..., None, :] ** np.arange(nodes.shape[-1])[:, None]
    first = np.eye(nodes.shape[-1])[:, 1:2]
    return np.asarray(np.linalg.solve(powers, first)[..., 0] / span)


def slopes_at_first(nodes: Array) -> Array:
    """l_j'(t) of (1) at the first of the nodes, 1/s, (k,)."""
    # l_j of the others there, over the way to it
    t, others = float(nodes[0]), nodes[1:]
    found = weights(others, t) / (others - t)
    return np.concatenate(([-np.add.reduce(found)], found))
