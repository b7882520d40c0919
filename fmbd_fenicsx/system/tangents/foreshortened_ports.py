"""Ports of second order in a system: what bent bodies add to the ports, their rates and accelerations.

See ``mechanics.elastic.foreshortening``. A system without such parts has none of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...mechanics.elastic.foreshortening import Bent
from ...rotations import Array
from ..layout import Layout

if TYPE_CHECKING:
    from ..evaluation import Evaluation


def bend(system: Layout, q: Array) -> dict[int, Bent]:
    """The second order of the ports in a configuration by part."""
    return {k: p.shortening.at(system.local_q(q, k)) for k, p in system.curved}


def port_forces(ev: Evaluation, port: Array) -> list[Array]:
    """Forces on the local coordinates of each part, of forces on the ports (n_port,)."""
    s = ev.system
    forces = [p.port_force(port[s.port_slice(k)], ev.t) for k, p in enumerate(s.parts)]
    for k, bent in ev.bent.items():
        forces[k] = forces[k] + bent.force(port[s.port_slice(k)])
    return forces


def surface_forces(ev: Evaluation, lam: Array) -> Array:
    """Forces of joints (multipliers lam) and of force elements on the ports of all surfaces in use, body axes, (n_port,)."""
    s = ev.system
    port = ev.on_ports(ev.wrenches())[1] if s.forces else np.zeros(s.n_port)
    if s.n_lam:
        port -= ev.jacobian.port.T @ lam
    return port


def pulls(ev: Evaluation, lam: Array) -> dict[int, Array]:
    """:func:`surface_forces` on the surfaces of bent bodies, by part."""
    s = ev.system
    if not s.curved:
        return {}
    port = surface_forces(ev, lam)
    return {k: p.shortening.N.T @ port[s.port_slice(k)] for k, p in s.curved}


def tangent_ports(system: Layout, local: Sequence[Array], t: float) -> list[Array]:
    """Rates of the ports of all fields for rates of their coordinates, with the columns that their tangents hold; collective."""
    ports = system.field_ports(local, t)
    shown = [p.shown for _, p in system.fields]
    return [p if x is None else p + x.along(w) for p, x, w in zip(ports, shown, local, strict=True)]


def port_bias(ev: Evaluation) -> Array:
    """Accelerations of the ports by the rates of the local coordinates alone, (n_port,); collective."""
    assert ev.v is not None
    s = ev.system
    out = np.zeros(s.n_port)
    for k, p in s.curved:
        out[s.port_slice(k)] = p.shortening.bias(s.local_v(ev.v, k))
    return out


def port_acceleration(ev: Evaluation, a: Array) -> Array:
    """Accelerations of the ports, (n_port,), for accelerations a like v; collective."""
    s = ev.system
    out = s.ports(a, ev.t, rates=True)
    for k, bent in ev.bent.items():
        out[s.port_slice(k)] += bent.along(s.local_v(a, k))
    return out + port_bias(ev) if ev.bent else out
