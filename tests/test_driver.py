"""The compiled driver: every force, drive and law on its path, in the plane and in space, with the digits of the NumPy path."""

from __future__ import annotations

import itertools
import tracemalloc
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from chains import chain
from test_compiled import pair, stepper_of
from test_kernel import flexible

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import FmbdError, LawError
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.linear.driver_solver import DriverSolver
from fmbd_fenicsx.schemes.onestep.alpha.alpha_stepper import AlphaStepper
from fmbd_fenicsx.schemes.onestep.alpha.compiled_stepper import CompiledAlphaStepper
from fmbd_fenicsx.system.compiled.choice import driver_states
from fmbd_fenicsx.system.compiled.order import Elimination, Fronts, RowGroup, joint_tree, loop_of
from fmbd_fenicsx.system.compiled.tables.structures import zeros_of
from fmbd_fenicsx.system.compiled.tables.tables import Tables
from fmbd_fenicsx.system.evaluation import Evaluation


def links(n: int, dim: int) -> fmbd.Scene:
    """A chain; in space with skew hinges."""
    scene = fmbd.Scene("links", gravity=(0.2, -9.81, 0.3)[:dim])
    before: Any = fmbd.ground
    for i in range(n):
        inertia = 2e-5 if dim == 2 else np.diag([1e-6, 2e-5, 2.1e-5])
        link = fmbd.RigidBody(f"{i}", 0.02, inertia, ((i + 0.5) * 0.1, 0.0, 0.0)[:dim])
        axis = (0, 0, 1) if i % 2 == 0 or dim == 2 else (0, 0.6, 0.8)
        scene.add(link, fmbd.revolute(f"hinge {i}", before, link, center=(i * 0.1, 0, 0)[:dim], axis=axis))
        before = link
    return scene


def joint_springs(dim: int) -> fmbd.Scene:
    scene = links(4, dim)
    for i, joint in enumerate(list(scene.joints.values())):
        scene.add(fmbd.joint_spring(f"spring {i}", fmbd.angle(joint), stiffness=0.1, damping=1e-3, free=0.1 * i))
    return scene


def suspended(dim: int) -> fmbd.Scene:
    """A body on spring-dampers, one of them with a law in Python."""
    inertia = 0.02 if dim == 2 else (0.017, 0.017, 0.027)
    body = fmbd.RigidBody("body", 4.0, inertia, (0.0, 0.0, 0.0)[:dim])
    scene = fmbd.Scene("suspended", gravity=(0, -9.81, 0)[:dim])
    scene.add(body)
    for i, (x, z) in enumerate(itertools.product((-0.1, 0.1), (-0.1, 0.1))):
        ends = (2 * x, 0.5, 2 * z)[:dim], (x, 0.05, z)[:dim]
        scene.add(fmbd.Spring(f"{i}", fmbd.ground, body, *ends, stiffness=2000.0, damping=5.0, length=0.4))
    ends = (0.3, -0.5, 0.1)[:dim], (0.0, -0.05, 0.0)[:dim]
    scene.add(fmbd.Spring("law", fmbd.ground, body, *ends, law=lambda s, rate, t: 100 * s + 1e4 * s**3 + 2 * rate + t))
    return scene


def loaded(dim: int) -> fmbd.Scene:
    """Every load in time, fixed in space and in the body, and a law of the whole motion of a point."""
    scene = links(2, dim)
    first, last = scene.bodies.values()

    def turn(t: float) -> Any:
        return 1e-3 * np.sin(20 * t) if dim == 2 else 1e-3 * np.array([1.0, np.sin(20 * t), 0.5])

    scene.add(
        fmbd.force("force", last, lambda t: 0.1 * np.array([np.sin(20 * t), 1, t])[:dim], point=(0.2, 0, 0)[:dim])
    )
    scene.add(
        fmbd.force(
            "follower", last, lambda t: 0.1 * np.array([t, 1, 1.0])[:dim], point=(0.2, 0, 0)[:dim], follower=True
        )
    )
    scene.add(fmbd.torque("torque", first, turn), fmbd.torque("couple", last, turn, follower=True))
    scene.add(
        fmbd.own_force("drag", last, None, lambda t, a: (-0.02 * a.v, -1e-5 * a.w), points=((0.2, 0, 0)[:dim], None))
    )
    scene.add(fmbd.effort("motor", fmbd.angle(scene.joints["hinge 0"]), lambda t: 0.01 * np.sin(t)))
    pd = fmbd.joint_spring(
        "pd", fmbd.angle(scene.joints["hinge 1"]), law=lambda s, rate, t: 0.05 * (s - t) + 1e-3 * rate
    )
    scene.add(pd)
    return scene


def driven(dim: int) -> fmbd.Scene:
    scene = links(3, dim)
    scene.add(fmbd.drive("drive", fmbd.angle(scene.joints["hinge 0"]), lambda t: 20 * t + t**2))
    scene.add(fmbd.gear("gear", fmbd.angle(scene.joints["hinge 0"]), fmbd.angle(scene.joints["hinge 1"]), ratio=-0.5))
    return scene


def redundant(dim: int) -> fmbd.Scene:
    """A hinge twice, and a spring beside it."""
    scene = joint_springs(dim)
    scene.add(fmbd.revolute("again", fmbd.ground, scene.bodies["0"], center=(0, 0, 0)[:dim]))
    return scene


def tyre(dim: int) -> fmbd.Scene:
    wheel = fmbd.RigidBody(
        "wheel", 10.0, 0.1 if dim == 2 else (0.1, 0.1, 0.2), (0.0, 0.29, 0.0)[:dim], velocity=(3.0, 0, 0)[:dim]
    )
    scene = fmbd.Scene("tyre", gravity=(0, -9.81, 0)[:dim], gravity_ramp=0.05)
    scene.add(wheel)
    up = (0.0, 1.0, 0.0)
    road = lambda x, t: 0.01 * np.sin(10 * x[0])  # noqa: E731
    scene.add(fmbd.Tyre("tyre", wheel, None, (0, 0.29, 0)[:dim], None, road, 0.3, 1e5, 100.0, up))
    return scene


def bushings(dim: int) -> fmbd.Scene:
    """Soft and stiff bushings between bodies and to the ground, with axes of their own, full matrices, far deflected."""
    rng = np.random.default_rng(3)
    n = 3 if dim == 2 else 6
    scene, before = fmbd.Scene("bushings", gravity=(0.2, -9.81, 0.3)[:dim]), fmbd.ground
    turn = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    for i in range(3):
        inertia = 2e-5 if dim == 2 else np.diag([1e-5, 2e-5, 2.1e-5])
        link = fmbd.RigidBody(f"{i}", 0.02, inertia, ((i + 0.5) * 0.1, 0.0, 0.0)[:dim])
        M = rng.normal(size=(n, n))
        scale = np.diag([20.0] * dim + [0.05] * (n - dim))
        K = scale @ (M @ M.T + n * np.eye(n)) @ scale
        center = (i * 0.1, 0.01 * i, 0.02)[:dim]
        scene.add(link, fmbd.bushing(f"b{i}", before, link, stiffness=K, damping=2e-3 * K, center=center, axes=turn))
        before = link
    return scene


def net(dim: int) -> fmbd.Scene:
    """Bodies and point masses in turn, tied to their neighbours: fronts have any number of pivots, gaps in what they lead to."""
    scene, at = fmbd.Scene("net", gravity=(0, -9.81, 0)[:dim]), {}
    inertia = {2: 5e-4, 3: (5e-4, 7e-4, 5e-4)}[dim]
    for i, j in np.ndindex(5, 5):
        place = np.array((0.1 * i, 0.1 * j, 0.01 * i * j)[:dim])
        if (i + j) % 2:
            mass = fmbd.PointMass(f"{i} {j}", 0.05, place)
        else:  # tied beside its centre
            mass = fmbd.RigidBody(f"{i} {j}", 0.1, inertia, place + 0.02)
        at[i, j] = place, mass if i else fmbd.ground
        if i:
            scene.add(mass)
    for (i, j), (place, one) in at.items():
        for far, other in (at[x] for x in {(i + 1, j), (i, j + 1)} & at.keys() if i or x[0]):
            law = {"stiffness": 1e5, "damping": 300.0, "length": np.linalg.norm(far - place)}
            scene.add(fmbd.Spring(f"tie {len(scene.forces)}", one, other, place, far, **law))
    return scene


SCENES = [joint_springs, suspended, loaded, driven, redundant, tyre, bushings, net]


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("make", SCENES, ids=lambda f: f.__name__)
def test_same_motion_as_numpy(make: Any, dim: int) -> None:
    assert isinstance(stepper_of(make(dim)), CompiledAlphaStepper)
    fast, slow = pair(lambda: make(dim), t_end=0.1, dt=1e-3)
    assert fast.counters["compiled_steps"] == 100
    # dependent rows take a second iteration, which closes them
    allowed = 300 if make is redundant else slow.counters["newton_iterations"] + 5
    assert fast.counters["newton_iterations"] <= allowed
    size = np.abs(slow.state.q).max()
    assert np.abs(fast.state.q - slow.state.q).max() < 2e-8 * size
    assert np.abs(fast.state.a - slow.state.a).max() < 1e-4 * np.abs(slow.state.a).max()
    if slow.state.lam.any():
        assert np.abs(fast.state.lam - slow.state.lam).max() < 1e-5 * np.abs(slow.state.lam).max()


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_marching_many_steps_is_stepping_often(dim: int) -> None:
    """Ten records or all: the same bits, with the energy guard and without."""
    for energy in (True, False):
        ends = [
            fmbd.solve(joint_springs(dim), t_end=0.2, dt=1e-3, output=fmbd.Output(every=k, energy=energy)).state
            for k in (1, 20)
        ]
        assert all(np.array_equal(getattr(ends[0], x), getattr(ends[1], x)) for x in ("q", "v", "a", "lam"))


ELEMENTS = {
    "motor": lambda name, on: fmbd.motor(name, on, target=lambda t: 0.3 * np.sin(4 * t), kp=0.1, kd=1e-3, limit=0.02),
    "held": lambda name, on: fmbd.motor(name, on, target=0.2, kp=0.1, kd=1e-3),
    "pid": lambda name, on: fmbd.pid(
        name, on, target=lambda t: 0.3 * np.sin(4 * t), gains=(0.1, 0.5, 1e-3), limit=0.02
    ),
    "stop": lambda name, on: fmbd.elastic_stop(name, on, upper=0.02, lower=-0.02, stiffness=1.0, damping=1e-3),
    "friction": lambda name, on: fmbd.joint_friction(name, on, coulomb=5e-3, static=7e-3, speed=0.2, viscous=1e-4),
    "dry friction": lambda name, on: fmbd.dry_friction(name, on, limit=5e-3, stick=5.0, damping=2e-3),
}


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("element", ELEMENTS)
def test_efforts_by_formulas_with_their_memory(element: str, dim: int) -> None:
    """Motion, efforts, energies and memory are those of NumPy; recorded rarely, so that many steps are made in one call."""

    def scene() -> fmbd.Scene:
        made = links(3, dim)
        for i, joint in enumerate(list(made.joints.values())):
            made.add(ELEMENTS[element](f"{element} {i}", fmbd.angle(joint)))
        made.sensor("effort", fmbd.element_effort(made.forces[f"{element} 0"]))
        made.sensor("end", fmbd.position(list(made.bodies.values())[-1]))
        return made

    fast, slow = pair(scene, t_end=0.2, dt=1e-3, output=fmbd.Output(every=25), newton=fmbd.Newton(tolerance=1e-10))
    assert fast.counters["compiled_steps"] == 200
    assert np.abs(fast["end"] - slow["end"]).max() < 1e-10
    assert np.ptp(slow["effort"]) > 1e-3
    assert np.abs(fast["effort"] - slow["effort"]).max() < 1e-9
    for kind, energy in slow.energy.items():
        assert np.abs(fast.energy[kind] - energy).max() < 1e-10, kind
    for mine, other in zip(fast.system.forces, slow.system.forces, strict=True):
        for a, b in zip(mine.formulas(), other.formulas(), strict=True):
            if a.kept is not None and b.kept is not None:
                assert np.abs(b.kept()[:, :1]).max() > 1e-4
                assert np.abs(a.kept() - b.kept()).max() < 1e-9


@pytest.mark.compiled
def test_parts_of_steps_know_the_acceleration_of_the_last_one() -> None:
    """Steps in parts, whose ends are rounded to the grid of whole ones, do not fall back on an older acceleration."""
    ends = []
    for compiled_ in (True, False):
        stepper = stepper_of(joint_springs(2), fmbd.GeneralizedAlpha(compiled=compiled_))
        for k in range(30):
            stepper.advance(1e-3)
            stepper.state = replace(stepper.state, t=(k + 1) * 1e-3)
        ends.append(stepper.state)
    assert np.abs(ends[0].q - ends[1].q).max() < 1e-11


@pytest.mark.compiled
@pytest.mark.parametrize("make", [loaded, driven, joint_springs, bushings, flexible], ids=lambda f: f.__name__)
def test_stabilised_form(make: Any) -> None:
    """Both levels closed in compiled steps as in NumPy: the same motion, velocities and multipliers."""
    dim = 3
    runs = [
        fmbd.solve(make(dim), t_end=0.05, dt=1e-3, scheme=fmbd.GeneralizedAlpha(0.8, fmbd.GGL(), compiled=c))
        for c in (True, False)
    ]
    fast, slow = runs
    assert fast.counters["compiled_steps"] == 50
    assert abs(fast.counters["newton_iterations"] - slow.counters["newton_iterations"]) <= 5
    for name, bar in (("q", 1e-9), ("v", 1e-7), ("lam", 1e-4)):
        x, y = getattr(fast.state, name), getattr(slow.state, name)
        assert np.abs(x - y).max(initial=0.0) <= bar * np.abs(y).max(initial=0.0), name
    ev = fast.system.at(fast.state.t, fast.state.q, fast.state.v)
    slip = ev.jacobian.times(fast.state.v) + ev.constraint_rate()
    assert np.abs(slip).max(initial=0.0) < 1e-7 * max(np.abs(fast.state.v).max(), 1.0)


def hinged_twice(dim: int) -> fmbd.Scene:
    """Two links, the first in two equal hinges."""
    scene = links(2, dim)
    twin = fmbd.revolute("again", fmbd.ground, scene.bodies["0"], center=(0.0,) * dim)
    scene.add(twin)
    return scene


def rolling_wheel(dim: int) -> fmbd.Scene:
    """A wheel on a slope, and a weight that hangs on its axle by a rod in two hinges where one is enough."""
    scene = fmbd.Scene("wheel", gravity=(0.5, 1.0, -9.81))
    wheel = fmbd.RigidBody(
        "wheel", 1.0, (0.02, 0.04, 0.02), (0, 0, 0.3), velocity=(1.5, 0, 0), angular_velocity=(0.3, 5, 0.5)
    )
    weight = fmbd.RigidBody("weight", 0.5, (0.01, 0.01, 0.01), (0, 0, 0.2), velocity=(1.5, 0, 0))
    scene.add(wheel, weight)
    scene.add(fmbd.rolling("road", fmbd.ground, wheel, shape=fmbd.Wheel(0.3, axis=(0, 1, 0)), normal=(0, 0, 1)))
    for k in range(2):
        scene.add(fmbd.revolute(f"axle {k}", wheel, weight, center=(0, 0.1 * k, 0.3), axis=(0, 1, 0)))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize(("make", "dim"), [(hinged_twice, 2), (hinged_twice, 3), (rolling_wheel, 3)])
def test_stabilised_form_of_dependent_rows_and_of_rows_on_velocities(make: Any, dim: int) -> None:
    """The same motion and reactions as in NumPy; both levels are closed."""
    fast, slow = (
        fmbd.solve(
            make(dim),
            t_end=0.2,
            dt=1e-3,
            scheme=fmbd.GeneralizedAlpha(0.8, fmbd.GGL(), compiled=c),
            newton=fmbd.Newton(1e-8),
        )
        for c in (True, False)
    )
    assert fast.counters["compiled_steps"] == 200
    for name, bar in (("q", 1e-9), ("v", 1e-8), ("lam", 1e-4)):
        x, y = getattr(fast.state, name), getattr(slow.state, name)
        assert np.abs(x - y).max() <= bar * np.abs(y).max(), name
    assert max(fast.drift) < 1e-9


@pytest.mark.compiled
@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()], ids=str)
@pytest.mark.parametrize("tolerance", [1e-6, 1e-10])
def test_dependent_rows_take_the_increments_that_they_take_in_numpy(form: Any, tolerance: float) -> None:
    """What softens dependent rows costs no increment, leaves nothing open and nothing in the multipliers."""
    fast, slow = (
        fmbd.solve(
            hinged_twice(2),
            t_end=0.1,
            dt=1e-3,
            scheme=fmbd.GeneralizedAlpha(0.8, form, compiled=c),
            newton=fmbd.Newton(tolerance),
        )
        for c in (True, False)
    )
    assert fast.counters["compiled_steps"] == 100
    assert abs(fast.counters["newton_iterations"] - slow.counters["newton_iterations"]) <= 2
    np.testing.assert_allclose(fast.state.lam, slow.state.lam, rtol=0, atol=1e-8 * np.abs(slow.state.lam).max())


@pytest.mark.compiled
def test_counted_angles_over_many_turns_between_records() -> None:
    """Twenty turns a record, with a gear and a sensor."""
    scene = links(1, 3)
    wheel = scene.bodies["0"]
    other = fmbd.RigidBody("other", 0.1, (1e-4, 1e-4, 1e-4), (1.0, 0, 0))
    scene.add(other, fmbd.revolute("axle", fmbd.ground, other, center=(1.0, 0, 0)))
    assert wheel is not other
    first, second = fmbd.angle(scene.joints["hinge 0"]), fmbd.angle(scene.joints["axle"])
    scene.add(fmbd.drive("drive", first, lambda t: 600.0 * t), fmbd.gear("gear", first, second, ratio=0.5))
    scene.sensor("turned", second)
    run = fmbd.solve(scene, t_end=1.0, dt=1e-3, output=fmbd.Output(every=200))
    assert np.abs(run["turned"][:, 0] - 300.0 * run.times).max() < 1e-6


@pytest.mark.compiled
def test_energies_are_those_of_the_evaluation() -> None:
    for make in (
        lambda: joint_springs(2),
        lambda: joint_springs(3),
        lambda: suspended(3),
        lambda: bushings(2),
        lambda: bushings(3),
        lambda: flexible(2),
        lambda: flexible(3),
    ):
        stepper = stepper_of(make())
        for _ in range(5):
            state = stepper.advance(1e-3)
        at = state.t, state.q, state.v
        told = driver_states(stepper.system)
        assert told is not None
        found = told.energies(told.at(*at).alone)
        wanted = list(Evaluation(stepper.system, *at).energies().values())
        assert found is not None
        assert np.abs(found[0] - wanted).max() < 1e-10 * max(np.abs(wanted).max(), 1e-3)


@pytest.mark.compiled
def test_law_that_raises_is_one_error_with_its_name() -> None:
    scene = suspended(2)

    def law(s: float, rate: float, t: float) -> float:
        if t > 0.02:
            raise RuntimeError("broken")
        return 100.0 * s

    scene.add(fmbd.Spring("bad", fmbd.ground, scene.bodies["body"], (0.5, 0.0), (0.1, 0.0), law=law))
    with pytest.raises(LawError, match='"bad".*broken'):
        fmbd.solve(scene, t_end=0.1, dt=1e-3)


def counting() -> Any:
    """A law that answers with the number of its call."""
    calls = itertools.count()
    return lambda s, rate, t: float(next(calls))


BAD = {
    "raises": (lambda: lambda s, rate, t: {}[t] if t > 0.0205 else s, "failed at t = 0.021 s: KeyError"),
    "nan": (lambda: lambda s, rate, t: np.nan if t > 0.0205 else s, "returned .nan. at t = 0.021 s"),
    "shape": (
        lambda: lambda s, rate, t: [s, s] if t > 0.0205 else s,
        r"returned shape \(2,\) at t = 0.021 s, expected \(1,\)",
    ),
    "text": (lambda: lambda s, rate, t: "x" if t > 0.0205 else s, "returned 'x' at t = 0.021 s, expected numbers"),
    "state": (counting, "and then 1.0 for equal arguments at t = 0 s"),
}


@pytest.mark.compiled
@pytest.mark.parametrize("path", [True, False], ids=["compiled", "NumPy"])
@pytest.mark.parametrize("fault", BAD)
def test_laws_that_cannot_be_used_are_one_error_with_name_and_time(fault: str, path: bool) -> None:
    law, message = BAD[fault]
    scene = links(2, 2)
    scene.add(fmbd.joint_spring("odd one", fmbd.angle(scene.joints["hinge 1"]), law=law()))
    with pytest.raises(FmbdError, match=f'"odd one".*{message}'):
        fmbd.solve(scene, t_end=0.1, dt=1e-3, scheme=fmbd.GeneralizedAlpha(0.8, compiled=path))


def test_tree_is_grown_from_the_ground() -> None:
    groups = [RowGroup((0,), (0, 1), False), RowGroup((0, 1), (2, 3), False), RowGroup((1,), (4,), False)]
    assert joint_tree(2, groups) == {0: [0], 1: [2]}


@pytest.mark.parametrize("shape", ["chain", "tree", "star", "ring"])
def test_fronts_solve_and_fill_nothing_where_bodies_form_a_tree(shape: str) -> None:
    """A chain of any length has fronts of one size; the factor's storage is proportional to the number of bodies."""
    storage = []
    for n in (20, 40):
        parent = {"chain": range(-1, n - 1), "tree": [(i - 1) // 2 for i in range(n)], "star": [-1, *[0] * (n - 1)]}
        links_ = list(enumerate(parent.get(shape, range(-1, n - 1))))
        groups = [RowGroup((i,) if p < 0 else (p, i), (2 * i, 2 * i + 1), False) for i, p in links_]
        if shape == "ring":
            groups.append(RowGroup((0, n - 1), (2 * n, 2 * n + 1), False))
        unknowns = [3 * i + np.arange(3) for i in range(n)]
        unknowns += [3 * n + np.array(g.rows) for g in groups]
        fronts = Fronts(unknowns, groups, set())
        assert sum(f.pivots for f in fronts.fronts) == 3 * n + 2 * len(groups)
        storage.append(fronts.storage)
    assert storage[1] < 2.3 * storage[0]


def fronts_of(bodies: int, groups: list[RowGroup], pairs: set[tuple[int, int]]) -> Fronts:
    """Fronts of bodies in the plane."""
    unknowns = [3 * i + np.arange(3) for i in range(bodies)]
    unknowns += [3 * bodies + np.array(g.rows) for g in groups]
    return Fronts(unknowns, groups, pairs)


def test_wheels_geared_to_one_fill_nothing() -> None:
    """A row of two joints' coordinates is eliminated with the wheel that has no other."""
    n = 100
    hinges = [RowGroup((i,), (2 * i, 2 * i + 1), False, frozenset([(0, 1 + i)])) for i in range(n)]
    gears = [RowGroup((0, i), (2 * n + i - 1,), True, frozenset([(0, 1), (0, 1 + i)])) for i in range(1, n)]
    largest = max(len(f.unknowns) for f in fronts_of(n, hinges + gears, set()).fronts)
    assert largest <= 9


def test_a_row_of_many_joints_comes_after_their_bodies() -> None:
    """Eliminated with one of them it would couple all the others."""
    n = 100
    hinges = [RowGroup((i - 1, i) if i else (0,), (2 * i, 2 * i + 1), False, frozenset([(i, 1 + i)])) for i in range(n)]
    every = RowGroup(tuple(range(n)), (2 * n,), True, frozenset((i, 1 + i) for i in range(n)))
    assert max(len(f.unknowns) for f in fronts_of(n, [*hinges, every], set()).fronts) <= 12


def test_coupled_joints_that_leave_nothing_free_come_after_their_bodies() -> None:
    """A coupling of coordinates of other joints, or of one that leaves no more, has no pivot on its body alone."""
    one = RowGroup((0,), (0, 1), False, frozenset([(0, 1)]))
    held = RowGroup((1,), (2, 3, 4), False, frozenset([(0, 2)]))
    for ends in ([(0, 2)], [(5, 6)]):
        coupling = RowGroup((0, 1), (5,), True, frozenset(ends))
        steps = Elimination([3, 3], [one, held, coupling], set()).run()
        assert steps[-1][0] == [4]


def test_bodies_with_many_joints_lead() -> None:
    """Rods between one shaft and sliders, which the ground leads to first: loops close beside the shaft, in small fronts."""
    n = 60
    guides = [RowGroup((1 + i,), (2 * i, 2 * i + 1), False) for i in range(n)]
    rods = [
        RowGroup((a, 1 + n + i), (2 * (n * (1 + k) + i), 2 * (n * (1 + k) + i) + 1), False)
        for i in range(n)
        for k, a in enumerate((1 + i, 0))
    ]
    shaft = RowGroup((0,), (6 * n, 6 * n + 1), False)
    assert max(len(f.unknowns) for f in fronts_of(1 + 2 * n, [*guides, *rods, shaft], set()).fronts) <= 15


def test_nets_have_few_large_fronts() -> None:
    """Storage of a net of 20 by 20 bodies: fronts of one node each take four times as much."""
    n = 20
    pairs = {(i, i + 1) for i in range(n * n - 1) if (i + 1) % n} | {(i, i + n) for i in range(n * n - n)}
    fronts = fronts_of(n * n, [], pairs)
    needed = sum(len(f.unknowns) * f.pivots for f in fronts.fronts)
    assert fronts.storage < 5 * needed


def test_arrays_of_the_driver_begin_with_lines_of_the_cache() -> None:
    for x, address in zeros_of({"one": 3, "none": 0, "others": (2, 5)}).values():
        assert address % 64 == 0
        assert address == x.__array_interface__["data"][0] or not x.size


def sampled(dim: int) -> fmbd.Scene:
    """Links under two sampled controllers, one of the user's own with a memory, and with dry friction in a hinge."""
    scene = links(3, dim)
    tip, hinges = scene.bodies["2"], [fmbd.angle(h) for h in scene.joints.values()]

    def law(t: float, y: Any, z: Any) -> Any:
        return (-0.05 * y["angle"] - 0.01 * y["speed"][:1] + z, z + 1e-3 * y["angle"])

    reads = {"angle": hinges[2], "speed": fmbd.velocity(tip)}
    scene.add(fmbd.pid("pid", hinges[0], target=lambda t: 0.3, gains=(0.5, 0.1, 0.02), every=0.01))
    scene.add(fmbd.controller("own", reads=reads, acts=hinges[1], law=law, memory=(0.0,), every=0.007))
    scene.add(fmbd.dry_friction("dry", hinges[2], limit=1e-4, stick=0.1))
    scene.sensor("tip", fmbd.position(tip))
    scene.sensor("push", fmbd.acceleration(tip))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_sampled_controllers_hold_their_efforts_in_compiled_steps(dim: int) -> None:
    """The same motion and jumps as in NumPy; samples are taken when they are due, and Python is not asked between them."""
    fast, slow = (
        fmbd.solve(sampled(dim), t_end=0.1, dt=1e-3, scheme=fmbd.GeneralizedAlpha(compiled=c)) for c in (True, False)
    )
    assert fast.counters["compiled_steps"] == 100
    for name, bar in (("tip", 1e-9), ("push", 1e-4)):
        assert np.abs(fast[name] - slow[name]).max() <= bar * np.abs(slow[name]).max()

    asked = []
    scene = sampled(dim)
    controller = scene.forces["own"]
    scene.forces["own"] = replace(controller, law=lambda t, y, z: (asked.append(t), controller.law(t, y, z))[1])
    fmbd.solve(scene, t_end=0.1, dt=1e-3)
    assert np.allclose(sorted(set(asked)), 0.007 * np.arange(15))
    assert len(asked) <= 16  # once more at the start


@pytest.mark.compiled
@pytest.mark.parametrize("rtol", [None, 1e-4])
def test_samples_leave_the_tables_of_steps_as_they_are(rtol: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps go on behind a sample with the tables that they have: none more for ten samples than for two."""
    made, begin = [], Tables.__init__

    def counted(self: Tables, *given: Any, **more: Any) -> None:
        made.append(self)
        begin(self, *given, **more)

    monkeypatch.setattr(Tables, "__init__", counted)
    counts = []
    for t_end in (0.015, 0.055):
        made.clear()
        fmbd.solve(sampled(2), t_end=t_end, dt=1e-3, scheme=fmbd.GeneralizedAlpha(rtol=rtol))
        counts.append(len(made))
    assert counts[0] == counts[1] > 0


@pytest.mark.compiled
def test_first_steps_behind_samples_of_a_field_are_compiled(rod_mesh: Any) -> None:
    """With the driver of the steps before; the same motion as in NumPy."""

    def run(compiled: bool, every: float = 2e-3) -> fmbd.Run:
        rod = fmbd.FloatingBody("rod", rod_mesh(2, 0.1), density=100.0, elastic=fmbd.materials.linear_elastic(1e7, 0.3))
        scene = fmbd.Scene("arm", gravity=(0, -9.81))
        hinge = fmbd.revolute("hinge", fmbd.ground, rod.surface("pin"), center=(0, 0))
        scene.add(rod, hinge, fmbd.pid("motor", fmbd.angle(hinge), target=0.1, gains=(20, 5, 0.1), every=every))
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        return fmbd.solve(scene, t_end=0.012, dt=1e-3, scheme=fmbd.GeneralizedAlpha(compiled=compiled))

    fast, slow = run(True), run(False)
    assert fast.counters["compiled_steps"] == 12
    assert np.abs(fast["tip"] - slow["tip"]).max() <= 1e-10

    # steps that did not fail leave tangents and columns that serve on: five samples, each with its first step
    more = fast.counters["back_solves"] - run(True, every=1.0).counters["back_solves"]
    assert 0 < more <= 50


@pytest.mark.compiled
def test_a_step_goes_on_where_the_driver_refuses_a_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    """Later increments of a step keep its matrix: where that was the driver's, which makes no second one, NumPy makes it."""
    whole = fmbd.solve(links(4, 2), t_end=0.05, dt=5e-3).state
    of_solver, of_driver = StepSolver.prepare, DriverSolver.prepare
    kept: list[bool] = []

    def told(solver: StepSolver, *given: Any, keep: bool = False) -> None:
        kept.append(keep)
        of_solver(solver, *given, keep=keep)

    def once_a_step(solver: DriverSolver, *given: Any, **more: Any) -> bool:
        solver.ready = False
        return not kept[-1] and of_driver(solver, *given, **more)

    monkeypatch.setattr(StepSolver, "prepare", told)
    monkeypatch.setattr(DriverSolver, "prepare", once_a_step)
    monkeypatch.setattr(CompiledAlphaStepper, "march", lambda *_: 0)
    monkeypatch.setattr(CompiledAlphaStepper, "advance", AlphaStepper.advance)
    parts = fmbd.solve(links(4, 2), t_end=0.05, dt=5e-3).state
    assert sum(kept) >= 10
    assert np.abs(parts.q - whole.q).max() < 1e-9


def hinged_grid(n: int) -> fmbd.Scene:
    """Bars along the edges of n x n squares, hinged at their ends, some of them in line with their neighbours."""
    scene, ends = fmbd.Scene("grid", gravity=(0.0, -9.81)), {}
    for (i, j), (right, down) in product(np.ndindex(n, n), [(1, 0), (0, 1)]):
        if max(i + right, j + down) == n:
            continue
        bar = fmbd.RigidBody(f"{i} {j} {right}", 0.1, 1e-4, (0.1 * (i + right / 2), -0.1 * (j + down / 2)))
        scene.add(bar)
        for node in ((i, j), (i + right, j + down)):
            ends.setdefault(node, []).append(bar)
    for (i, j), bars in ends.items():
        for k, two in enumerate(pairwise(bars)):
            scene.add(fmbd.revolute(f"{i} {j} {k}", *two, center=(0.1 * i, -0.1 * j)))
    scene.add(fmbd.revolute("held", fmbd.ground, ends[0, 0][0], center=(0.0, 0.0)))
    scene.sensor("corner", fmbd.sensors.position(ends[n - 1, n - 1][-1]))
    return scene


@pytest.mark.compiled
def test_loops_that_their_neighbours_would_lock_are_eliminated_after_their_bodies() -> None:
    """Two bars in line leave nothing free along them while what they hang on stands: rows wait for all bodies of their loop."""
    fast, slow = pair(lambda: hinged_grid(8), t_end=5e-3, dt=1e-3)
    assert fast.counters["compiled_steps"] == 5
    np.testing.assert_allclose(fast["corner"], slow["corner"], rtol=0, atol=1e-9)


@pytest.mark.parametrize("ends", [(3, 5), (5,), (2, 5)])
def test_a_loop_is_what_moves_beside_one_body(ends: tuple[int, ...]) -> None:
    """Bodies 0 1 2 3 one behind another, 4 5 behind 1."""
    parent = {0: -1, 1: 0, 2: 1, 3: 2, 4: 1, 5: 4}
    assert loop_of(ends, parent) == {(3, 5): {2, 3, 4, 5}, (5,): {0, 1, 4, 5}, (2, 5): {2, 4, 5}}[ends]


def test_forces_of_time_act_beside_joints_that_are_there_twice() -> None:
    """Tables that are made anew when rows turn out to depend know nothing of functions of time yet."""

    def made(hinges: int) -> fmbd.Run:
        scene = fmbd.Scene("pushed")
        link = fmbd.RigidBody("link", mass=2.0, inertia=0.5, position=(1.0, 0.0))
        scene.add(link, *(fmbd.revolute(f"hinge {k}", fmbd.ground, link, center=(0, 0)) for k in range(hinges)))
        scene.add(fmbd.force("push", link, lambda t: (0.0, 3.0 * np.cos(t)), point=(1.5, 0.0)))
        scene.sensor("end", fmbd.position(link))
        return fmbd.solve(scene, t_end=0.02, dt=1e-3)

    assert made(2)["end"][-1] == pytest.approx(made(1)["end"][-1], abs=1e-12)


@pytest.mark.compiled
def test_the_place_of_an_entry_takes_no_room_for_all_fronts() -> None:
    """A start asks some times for each body: all fronts at each question would be the square of their number."""
    peaks = []
    for n in (30, 600):
        fronts = Tables(chain(n)[0].build()[0], redundant=0).fronts
        assert len(fronts.fronts) >= n // 2
        fronts.place([0], [0])
        tracemalloc.start()
        fronts.place([0], [0])
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + 1000
