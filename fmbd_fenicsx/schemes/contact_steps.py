"""What all schemes with contact do at a step: find candidates, refuse penetration at the start, refuse passing through."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ..contact_rows import ContactSet, Linear, Rows, tangents_of
from ..errors import ConvergenceError, InputError
from ..rotations import Array
from ..system import State, System

ALLOWED = 1e-8  # penetration at the start, as a share of the model's length


def candidates(system: System, contacts: ContactSet, state: State, h: float) -> np.ndarray:
    """Points that may touch within the step, (m,) bool: near now, or at the position reached with the present velocity."""
    now = contacts.rows(system, state.t, state.q).gap
    then = contacts.rows(system, state.t + h, system.compose(state.q, h * state.v)).gap
    reach = contacts.search(now, then, system.length)
    return np.asarray((now < reach) | (then < reach))


def components(rows: Rows) -> Linear:
    """Normal and tangential rows of each point after each other, (m d, ...)."""
    parts = [rows.N, *rows.tangents]
    d, m = len(parts), len(rows.gap)
    order = np.argsort(np.tile(np.arange(m), d), kind="stable")
    core = np.concatenate([p.core for p in parts])[order]
    n = len(rows.N.field)
    return Linear(core, tuple(sp.vstack([p.field[i] for p in parts], format="csr")[order] for i in range(n)))


def in_world(rows: Rows, force: Array) -> Array:
    """Forces (m, d) in world axes from components (m, 1) or (m, d) along normal and tangents."""
    out = force[:, :1] * rows.normal
    if force.shape[1] > 1:
        for k, e in enumerate(tangents_of(rows.normal)):
            out = out + force[:, 1 + k : 2 + k] * e
    return out


def refuse_penetration(system: System, contacts: ContactSet, state: State) -> None:
    """Raise InputError when bodies overlap at the start, naming pair and depth; collective."""
    rows = contacts.rows(system, state.t, state.q)
    if not len(rows.gap):
        return
    worst = int(np.argmin(rows.gap))
    depth = -float(rows.gap[worst])
    if depth > ALLOWED * system.length:
        raise InputError(
            f'Contact "{contacts.names[rows.pair[worst]]}": the bodies overlap at the start by {depth:.3g} m, at '
            f"{np.round(rows.x[worst], 6).tolist()}. Move one of them apart along {np.round(rows.normal[worst], 3).tolist()}."
        )


def refuse_tunnelling(system: System, contacts: ContactSet, state: State, h: float) -> None:
    """Raise ConvergenceError when a point would pass more than half of an obstacle's thickness in one step; collective."""
    now = contacts.rows(system, state.t, state.q)
    thin = np.isfinite(now.thickness)
    if not thin.any():
        return
    moved = contacts.rows(system, state.t + h, system.compose(state.q, h * state.v))
    way = np.linalg.norm(moved.x - now.x, axis=1)
    fast = np.flatnonzero(thin & (way > 0.5 * now.thickness) & (now.gap > -0.1 * now.thickness))
    if not len(fast):
        return
    pieces = 4 * int(np.ceil(np.max(way[fast] / now.thickness[fast]))) + 1
    for k in range(1, min(pieces, 200) + 1):
        part = h * k / min(pieces, 200)
        at = contacts.rows(system, state.t + part, system.compose(state.q, part * state.v))
        hit = fast[at.gap[fast] < 0]
        if len(hit):
            i = int(hit[0])
            safe = 0.5 * h * now.thickness[i] / way[i]
            raise ConvergenceError(
                f'Contact "{contacts.names[now.pair[i]]}" at t = {state.t:.6g} s: a point moves {way[i]:.3g} m in one step of {h:.3g} s, '
                f"more than half of the {now.thickness[i]:.3g} m it would hit, and could pass through. Use dt <= {safe:.3g} s."
            )
