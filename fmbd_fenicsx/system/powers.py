"""The power of everything that gives energy to the bodies of a scene or takes it, one by one.

    d/dt (kinetic + elastic + weight) = sum of w . twist over force elements + sum of lambda . g_t over joints
                                        + loads and damping of elastic bodies + (g - g_end) . p                (1)

A joint at rest works nothing; a drive gives lambda . g_t, because G v = -g_t and its force is -G^T lambda. Springs are elements
here: what they take, they keep.
"""

from __future__ import annotations

import numpy as np

from ..mechanics.forces.force_elements import Loads
from ..mechanics.placements import FrameMotion
from ..rotations import Array
from .evaluation import Evaluation
from .layout import State


def powers(ev: Evaluation, state: State) -> dict[str, float]:
    """Power (W) that each element gives to the bodies in a state, the right side of (1); collective."""
    return {**_elements(ev), **_drives(ev, state), **_bodies(ev, state), **_weight(ev)}


def unlisted(ev: Evaluation, state: State) -> list[str]:
    """Bodies whose loads and damping cannot be told from their other forces: their work is in no entry of :func:`powers`."""
    return [p.name for k, p in enumerate(ev.system.parts) if p.given(*_moved(ev, state, k)) is None]


def power_of(loads: Loads, ev: Evaluation) -> Array:
    """Power (W) that each element of a batch gives to the bodies, (m,): wrench times twist, summed over its markers."""
    assert ev.kin.twist is not None
    each = zip(loads.markers, ev.asked(loads, "wrenches"), strict=True)
    first, *rest = ((wrench * ev.kin.twist[marker]).sum(1) for marker, wrench in each)
    return np.asarray(sum(rest, first))


def _elements(ev: Evaluation) -> dict[str, float]:
    """Wrenches times twists of both markers, by the name of the force."""
    found: dict[str, float] = {}
    for loads in ev.system.forces:
        # a controller acts at several places under one name
        for force, value in zip(loads.forces, power_of(loads, ev), strict=True):
            found[force.name] = found.get(force.name, 0.0) + float(value)
    return found


def _drives(ev: Evaluation, state: State) -> dict[str, float]:
    """lambda . g_t, by the name of the joint, of those that have ever moved by themselves."""
    rate = ev.constraint_rate()

    return {b.name: float(state.lam[b.rows] @ rate[b.rows]) for b in ev.system.blocks}


def _bodies(ev: Evaluation, state: State) -> dict[str, float]:
    """Loads and damping of elastic bodies and rods: "name, damping" and so on."""
    s = ev.system
    found: dict[str, float] = {}
    for k, part in enumerate(s.parts):
        given = part.given(*_moved(ev, state, k)) or {}
        found |= {f"{part.name}, {kind}": value for kind, value in given.items()}
    for elements in s.elements:
        given = elements.given(ev.t, ev.pose, ev.twist)
        found |= {f"{elements.name}, {kind}": value for kind, value in given.items()}
    return found


def _moved(ev: Evaluation, state: State, k: int) -> tuple[FrameMotion, tuple[Array, Array]]:
    """Motion of the frame of part k, and its local coordinates and their rates."""
    s = ev.system
    frame = s.parts[k].frame
    accel = s.twists(state.a)[frame]
    motion = FrameMotion(ev.t, ev.rotation[frame], ev.twist[frame], accel, s.gravity(ev.t))

    return motion, (s.local_q(ev.q, k), s.local_v(state.v, k))


def _weight(ev: Evaluation) -> dict[str, float]:
    """What gravity gives beyond the weight's energy, which is that of its lasting value."""
    missing = ev.system.gravity(ev.t) - ev.system.gravity.lasting

    return {"gravity": float(missing @ ev.momenta()[0])} if missing.any() else {}


def contact_works(state: State) -> dict[str, float]:
    """Work (J) of contact and friction since the start, as the scheme of the run counts it."""
    from .sensors.contact import ContactState

    if not isinstance(state, ContactState) or state.contact is None:
        return {"contact": 0.0, "friction": 0.0}
    normal, friction = state.contact.work[:2]
    return {"contact": float(normal), "friction": float(friction)}
