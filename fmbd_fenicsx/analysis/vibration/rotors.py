"""Whether coefficients of small motions stay as bodies turn: those that spin among others at rest must be round for it, and what
holds a body that goes round must turn with the axes.
"""

from __future__ import annotations

import numpy as np

from ...errors import InputError
from ...rotations import Array
from ...system.layout import State
from ...system.system import System
from ..small_motions.basis import random_motion
from ..small_motions.perturbation import Perturbation
from ..small_motions.steady import MOUNTS, BodySpin
from ..statics.static_newton import StaticNewton

ANGLE = 1.0  # by which bodies are turned, rad
ROUND = 1e-5  # relative difference of forces that is none


def check_round(about: Perturbation, spin: BodySpin) -> None:
    """Refuse bodies whose inertia or stiffness changes as they turn: small motions would have periodic coefficients.

    Elastic bodies in moving frames are taken as round.
    """
    system, s = about.system, about.state
    if any(p.frame in spin.frames for _, p in system.fields):
        return

    none = np.zeros(system.n_lam)
    before = Perturbation(system, State(s.t, s.q, s.v, s.a, none))
    later = spin.turned(system, s.q, ANGLE)
    after = Perturbation(system, State(s.t, later, s.v, s.a, none))
    y = random_motion(about, 0)
    turned = _told_in(system, y, s.q, later)

    for name in ("mass", "damping", "stiffness"):
        force = _told_in(system, _product(before, name, y), s.q, later)
        change = system.max_abs(_product(after, name, turned) - force)
        if change > ROUND * system.max_abs(force):
            raise InputError(
                f"The {name} of {spin.listed} changes as they turn: bodies that spin among others at rest must be round about "
                "their axes. Take the rotation of the whole scene (Spin without bodies) for rotors that are not. "
                + MOUNTS
            )


def _product(about: Perturbation, name: str, y: Array) -> Array:
    """M y, C y or K y."""
    return {"mass": about.mass, "damping": about.damping, "stiffness": about.stiffness}[name](y)


def changes(about: Perturbation, newton: StaticNewton) -> float:
    """How far small motions are led elsewhere as the bodies of a state in motion go on, over these motions; collective.

    The bodies go on as they move until they have turned by ``ANGLE``, at most for the time that is long against all vibrations.
    ``newton`` has its matrix of the state. Elastic bodies in moving frames are taken as round.
    """
    system, s = about.system, about.state
    m = system.motions
    turns = s.v[: system.n_frames * m.n_twist].reshape(-1, m.n_twist)[:, m.dim :]
    fastest = float(np.linalg.norm(turns, axis=1).max(initial=0.0))
    if fastest == 0.0 or system.fields or about.closed is not None:
        return 0.0
    time = min(ANGLE / fastest, newton.tau)

    none = np.zeros(system.n_lam)
    later = np.asarray(system.compose(s.q, time * s.v))
    before, after = (Perturbation(system, State(s.t, q, s.v, s.a, none)) for q in (s.q, later))

    def moved(force: Array, gaps: Array) -> Array:
        return newton.solver.solve(force, gaps)[0]

    y = moved(random_motion(about, 0), none)
    on = _told_in(system, y, s.q, later)
    force, change = np.zeros_like(y), np.zeros_like(y)
    for name, weight in (("mass", time**-2.0), ("damping", 1.0 / time), ("stiffness", 1.0)):
        now = _product(before, name, y)
        force += weight * now
        change += weight * (_told_in(system, _product(after, name, on), later, s.q) - now)

    least = np.finfo(float).tiny
    opened = system.max_abs(moved(0.0 * y, after.rows(on))) / max(system.max_abs(y), least)
    return max(opened, system.max_abs(moved(change, none)) / max(system.max_abs(moved(force, none)), least))


def _told_in(system: System, y: Array, q: Array, later: Array) -> Array:
    """A motion or force like v, its rotations told in the axes that the bodies have later."""
    m = system.motions
    if m.dim == 2:
        return y
    out = y.copy()
    turns = out[: system.n_frames * m.n_twist].reshape(-1, m.n_twist)[:, m.dim :]
    R, S = (m.matrix(system.poses(x))[:-1] for x in (q, later))
    turns[:] = np.einsum("nji,njk,nk->ni", S, R, turns)
    return out
