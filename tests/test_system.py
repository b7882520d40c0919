"""The balance of forces is Lagrange's: against derivatives of the energies alone; momenta, power,
Lie-group operations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from motion import Motion, beside, elastic_rod, elastic_scene, first, plane_scene, quasi_velocity, space_scene

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError
from fmbd_fenicsx.mechanics.placements import FrameMotion

STIFFENED = ["stiffened-2", "stiffened-3", "modes-2", "modes-3"]
CASES = ["rigid-2", "rigid-3", "mean-2", "mean-3", "attached-2", "attached-3", *STIFFENED]


def make(
    case: str, mesh: Callable[..., Any], gravity: bool, spring: bool = True, loads: tuple[Any, ...] = ()
) -> Motion:
    """A random motion of a scene with two bodies (and a spring between them); ``loads`` of stiffened ones."""
    kind, dim = case.split("-")
    d = int(dim)
    if kind == "rigid":
        scene, one, two = (plane_scene if d == 2 else space_scene)(*(() if gravity else (None,)))
    elif case in STIFFENED:
        rod = elastic_rod(
            mesh(dim=d, h=0.5, height=0.4), degree=1, frame=fmbd.Attached("pin"), stiffening=True, loads=loads
        )
        scene, rod, two = beside(rod.reduced(modes=3) if kind == "modes" else rod, gravity, d)
        one = rod.surface("tip")
    else:
        frame = fmbd.MeanAxis() if kind == "mean" else fmbd.Attached("tip")
        scene, rod, two = elastic_scene(mesh(dim=d, h=0.5, height=0.4), gravity, degree=1, frame=frame)
        one = rod.surface("tip")
    if spring:
        far = {"point_a": (0.2, 0.3, 0.1)[:d], "point_b": (2.0, 0.5, -0.4)[:d]}
        scene.add(fmbd.Spring("spring", one, two, stiffness=50.0, length=0.4, **far))
    return Motion(scene, deform=0.02)


@pytest.mark.smoke
@pytest.mark.parametrize("case", CASES)
def test_balance_is_lagranges_equation(case: str, rod_mesh: Callable[..., Any]) -> None:
    """delta . (M a + h) = d/dt (dL/dxi') . delta - dL/dxi . delta with L = kinetic - potential energy in
    local coordinates.
    """
    motion = make(case, rod_mesh, True)
    s = motion.system

    def lagrangian(t: float, xi: np.ndarray, rate: np.ndarray) -> float:
        E = s.at(t, s.compose(motion.q, xi), quasi_velocity(s, xi, rate)).energies()
        return E["kinetic"] - E["elastic"] - E["weight"] - E["springs"]

    found = motion.at(0.0).balance(motion.a)
    for _ in range(4):
        e = motion.direction()
        eps = 1e-3

        def momentum(x: float, e: np.ndarray = e) -> float:
            xi, rate = motion.increment(x)
            return (lagrangian(motion.t + x, xi, rate + e) - lagrangian(motion.t + x, xi, rate - e)) / 2

        slope = first(lambda x, e=e: lagrangian(motion.t, x * e, motion.v), eps)
        expected = first(momentum, eps) - slope
        assert abs(s.dot(found, e) - expected) < 1e-8 * (abs(expected) + s.dot(np.abs(found), np.abs(e)))


@pytest.mark.parametrize("case", CASES)
def test_momenta_change_by_the_forces(case: str, rod_mesh: Callable[..., Any]) -> None:
    """Without gravity and springs: p' and L' are the sums of the frames' rows."""
    motion = make(case, rod_mesh, False, spring=False)
    s, ev = motion.system, motion.at(0.0)
    m, d = s.motions, s.motions.dim
    rows = s.twists(ev.balance(motion.a))[:-1]
    p = first(lambda x: motion.at(x).momenta()[0])
    L = first(lambda x: motion.at(x).momenta()[1])
    moment = m.moment(ev.pose[:-1, :d], rows[:, :d]) + m.turn(ev.rotation[:-1], rows[:, d:])
    assert np.abs(rows[:, :d].sum(0) - p).max() < 1e-8 * np.abs(rows).max()
    assert np.abs(moment.sum(0) - L).max() < 1e-8 * np.abs(rows).max()


@pytest.mark.parametrize("case", CASES)
def test_energy_changes_by_the_power_of_the_balance(case: str, rod_mesh: Callable[..., Any]) -> None:
    motion = make(case, rod_mesh, True)
    s = motion.system
    power = s.dot(motion.at(0.0).balance(motion.a), motion.v)
    rate = first(lambda x: sum(motion.at(x).energies().values()))
    assert abs(power - rate) < 1e-8 * (abs(power) + sum(abs(e) for e in motion.at(0.0).energies().values()))


@pytest.mark.parametrize("case", STIFFENED)
def test_weight_is_a_dead_load(case: str, rod_mesh: Callable[..., Any]) -> None:
    """Both act on second-order displacements, by a potential and by the stress of the load: the rows are the same."""
    load = fmbd.loads.body_force(tuple(1000.0 * x for x in (0.5, -9.81, 2.0)[: int(case[-1])]))
    rows = []
    for gravity, loads in ((True, ()), (False, (load,))):
        motion = make(case, rod_mesh, gravity, spring=False, loads=loads)
        s, part = motion.system, motion.system.parts[0]
        balance = motion.at(0.0).balance(motion.a)
        rows.append(np.concatenate((s.twists(balance)[part.frame], s.local_v(balance, 0))))
    np.testing.assert_allclose(*rows, atol=1e-11 * np.abs(rows[0]).max())


@pytest.mark.parametrize("case", STIFFENED)
def test_loads_that_follow_have_the_power_that_is_listed(case: str, rod_mesh: Callable[..., Any]) -> None:
    d = int(case[-1])
    load = fmbd.loads.traction("tip", (-2e3, 5e2, 1e3)[:d], follower=True)
    motion = make(case, rod_mesh, True, loads=(load, fmbd.loads.body_force((10.0, 20.0, -30.0)[:d])))
    s, ev = motion.system, motion.at(0.0)
    power = s.dot(ev.balance(motion.a), motion.v)
    frame = FrameMotion(ev.t, ev.rotation[0], ev.twist[0], None, s.gravity(ev.t))
    given = s.parts[0].given(frame, ev.local(0))
    assert given is not None and set(given) == {"loads"}
    rate = first(lambda x: sum(motion.at(x).energies().values()))
    assert abs(power + given["loads"] - rate) < 1e-8 * (abs(power) + abs(given["loads"]))


@pytest.mark.parametrize("case", ["rigid-2", "rigid-3", "mean-2", "mean-3"])
def test_applied_forces_have_the_power_of_their_points(case: str, rod_mesh: Callable[..., Any]) -> None:
    motion = make(case, rod_mesh, True)
    s, ev = motion.system, motion.at(0.0)
    wrench = np.random.default_rng(9).standard_normal(ev.kin.twist.shape)
    ground = s.markers.frame == s.n_frames
    wrench[ground] = 0.0
    assert abs(s.dot(ev.spread(wrench), motion.v) - float((wrench * ev.kin.twist).sum())) < 1e-11


@pytest.mark.parametrize("case", ["rigid-2", "rigid-3", "mean-3"])
def test_compose_difference_and_rate_belong_together(case: str, rod_mesh: Callable[..., Any]) -> None:
    motion = make(case, rod_mesh, True)
    s = motion.system
    xi = 0.2 * motion.direction()
    q = s.compose(motion.q, xi)
    assert s.max_abs(s.difference(motion.q, q) - xi) < 1e-13
    v = motion.direction()
    rate = s.rate(xi, v)
    assert s.max_abs(quasi_velocity(s, xi, rate) - v) < 1e-12
    # the same from positions: q o exp(xi + s rate) moves with v
    moved = first(lambda x: s.difference(q, s.compose(motion.q, xi + x * rate)))
    assert s.max_abs(moved - v) < 1e-8


def test_follower_force_turns_with_the_body() -> None:
    scene, one, _ = space_scene(None)
    scene.add(fmbd.force("push", one, lambda t: (1.0, 2.0, 3.0), point=(0.9, -0.4, 0.2), follower=True))
    scene.add(fmbd.torque("twist", one, lambda t: (0.3, 0.0, -1.0), follower=True))
    motion = Motion(scene)
    ev = motion.at(0.0)
    w = ev.wrenches()
    R = ev.kin.R[0]
    assert np.abs(w[0, :3] - R @ [1, 2, 3]).max() < 1e-14
    assert np.abs(w[1, 3:] - ev.kin.R[1] @ [0.3, 0, -1]).max() < 1e-14
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14


@pytest.mark.parametrize(
    "value, words",
    [
        ((1.0, np.nan), "returned.*nan"),
        ((1.0, 2.0, 3.0), r"shape \(3,\)"),
        (1.0, "shape"),
        ((np.inf, 0.0), "inf"),
    ],
)
def test_loads_of_wrong_shape_or_nan_are_named(value: Any, words: str) -> None:
    scene, one, _ = plane_scene()
    scene.add(fmbd.force("wind", one, lambda t: value))
    with pytest.raises(CallbackError, match=f'(?s)"wind".*{words}'):
        fmbd.solve(scene, t_end=0.1, dt=0.05)


def test_load_that_turns_bad_later_is_named_with_its_time() -> None:
    scene, one, _ = plane_scene()
    scene.add(fmbd.force("wind", one, lambda t: (1.0, 0.0 if t < 0.06 else np.nan)))
    with pytest.raises(CallbackError, match='"wind".* t = 0.0[67]'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_spring_law_of_wrong_shape_is_named() -> None:
    scene, one, two = plane_scene()
    scene.add(fmbd.Spring("tie", one, two, law=lambda s, rate, t: (1.0, 2.0)))
    with pytest.raises(CallbackError, match='"tie".*shape'):
        fmbd.solve(scene, t_end=0.1, dt=0.05)
