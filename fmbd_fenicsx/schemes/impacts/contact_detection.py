"""What all schemes with contact do at a step: find candidates, refuse penetration at the start, refuse
passing through.
"""

from __future__ import annotations

import numpy as np

from ...errors import ConvergenceError, InputError
from ...log import log
from ...mechanics.contact.contact_set import SIGHT, ContactSet
from ...mechanics.contact.obstacle_pair import ObstaclePair
from ...mechanics.contact.rows import Rows, Touch
from ...rotations import Array, tangents_of
from ...system.layout import State
from ...system.system import System

ALLOWED = 1e-8  # penetration at the start, as a share of the model's length


def candidates(
    system: System, contacts: ContactSet, state: State, h: float, *, paired: Array | None = None
) -> tuple[np.ndarray, Array]:
    """Points that may touch within the step, (m,) bool: near now, or at the position reached with the
    present velocity, which comes second.

    ``paired``: the configuration in which surfaces are paired, in place of the present one; overlaps from their new pairing are
    not pushed out then (see :mod:`fmbd_fenicsx.mechanics.contact.mortar`).
    """
    if contacts.searching:
        sight = 2 * h * contacts.fastest(system, state.v)
        if paired is None:
            contacts.update(system, state.q, sight)
        else:
            contacts.update(system, paired, sight, begun=state.q)
    now = contacts.touch(system, state.t, state.q)
    ahead = system.compose(state.q, h * state.v)
    then = contacts.touch(system, state.t + h, ahead)
    _refuse_tunnelling(system, contacts, state, (h, now, then))
    reach = contacts.search(now.gap, then.gap, system.length)
    return (now.gap < reach) | (then.gap < reach), ahead


def in_world(rows: Rows, force: Array) -> Array:
    """Forces (m, d) in world axes from components (m, 1) or (m, d) along normal and tangents."""
    out = force[:, :1] * rows.normal
    if force.shape[1] > 1:
        for k, e in enumerate(tangents_of(rows.normal)):
            out = out + force[:, 1 + k : 2 + k] * e
    return out


def refuse_penetration(system: System, contacts: ContactSet, state: State) -> None:
    """Raise InputError when bodies overlap at the start, naming pair and depth; collective."""
    contacts.update(system, state.q, SIGHT * system.length)
    rows = contacts.touch(system, state.t, state.q)
    near = np.zeros(len(contacts.names), dtype=bool)
    near[contacts.pair[np.isfinite(rows.geometric)]] = True
    for i in np.flatnonzero(~near):
        log.info('contact "%s": the bodies start outside each other\'s search range', contacts.names[i])
    worst = int(np.argmin(rows.geometric))
    depth = -float(rows.geometric[worst])
    if depth > ALLOWED * system.length:
        pair = contacts.pairs[contacts.pair[worst]]
        raise InputError(pair.overlap(system, depth, rows.x[worst], rows.normal[worst]))
    _tell_edges(contacts, rows, ALLOWED * system.length)


def _tell_edges(contacts: ContactSet, touch: Touch, reach: float) -> None:
    """Warn of points that stand on an edge of their obstacle, to a distance (m): roundoff decides which side they touch."""
    touching = touch.geometric < reach
    for k in np.unique(contacts.pair[touching]):
        pair, at = contacts.pairs[k], np.flatnonzero(touching & (contacts.pair == k))
        if isinstance(pair, ObstaclePair) and (edged := pair.shape.edged(touch.relative[at], reach)).any():
            log.warning(
                'contact "%s": a point at %s stands on an edge of its obstacle, where roundoff decides which side it touches; '
                "it may fall past it. Set such points a little inside of the body",
                pair.name,
                np.round(touch.x[at[edged]][0], 6).tolist(),
            )


def tell_rest(contacts: ContactSet, point: int, t: float) -> None:
    """Log that a point's impacts accumulate in the step, at a time t (s)."""
    name = contacts.names[contacts.pair[point]]
    log.info('contact "%s" at t = %.6g s: its impacts accumulate (Zeno); it comes to rest', name, t)


def _refuse_tunnelling(system: System, contacts: ContactSet, state: State, step: tuple[float, Touch, Touch]) -> None:
    """Raise ConvergenceError when a point would pass more than half of an obstacle's thickness in one step;
    collective.
    """
    h, now, then = step
    if not contacts.thin:
        return
    thick = contacts.thickness
    way = np.linalg.norm(then.relative - now.relative, axis=1)
    # far enough to be through, and not behind the surface already
    fast = np.flatnonzero((way > (0.5 + 1e-9) * thick) & (now.gap > -0.1 * thick))
    if not len(fast):
        return

    # only who meets the obstacle on the way counts: places in between, a quarter of the thickness apart
    pieces = min(4 * int(np.ceil(np.max(way[fast] / thick[fast]))) + 1, 1000)
    for k in range(1, pieces + 1):
        part = h * k / pieces
        at = contacts.touch(system, state.t + part, system.compose(state.q, part * state.v))
        hit = fast[at.gap[fast] < -0.25 * thick[fast]]  # deep inside, not sliding along
        if len(hit):
            i = int(hit[0])
            raise ConvergenceError(
                f'Contact "{contacts.names[contacts.pair[i]]}" at t = {state.t:.6g} s: a point moves '
                f"{way[i]:.3g} m in one step of "
                f"{h:.3g} s, more than half of the {thick[i]:.3g} m it would hit, and could pass through. "
                f"Use dt <= {0.5 * h * thick[i] / way[i]:.3g} s."
            )
