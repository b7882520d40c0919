"""The search of contact looks at all points and obstacles together, whatever their order."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.mechanics.contact.obstacles import way_over

BLOCK = Path(__file__).resolve().parents[1] / "meshes/block.py"
SHAPES = [
    fmbd.HalfSpace((0, 0, -0.1), (0.1, 0, 1)),
    fmbd.Sphere(0.3, (0.1, 0, 0)),
    fmbd.SignedDistance(lambda x: np.hypot(x[0], x[2]) - 0.2),
    fmbd.Cylinder(0.2, (0, 1, 0.3), length=0.7),
    fmbd.Sphere(2.0, inside=True),
    fmbd.Box((0.3, 0.4, 0.5), (0, 0.1, 0), rotation=(0.1, 0.2, 0.3, 0.9)),
    fmbd.Cylinder(0.25, (1, 1, 0)),
    fmbd.Box((0.2, 0.2, 0.6)),
    fmbd.HalfSpace((0, 1, 0), (0, -1, 0.2)),
]


def swing(t: float) -> Any:
    """A prescribed obstacle that turns about z."""
    return (0.1 * t, 0.2, 0.0), (0.0, 0.0, np.sin(t), np.cos(t))


def scene_of(chosen: list[int]) -> Any:
    """A ball and corners against shapes on the ground, on a body, and prescribed, in turn."""
    base = fmbd.RigidBody("base", 5.0, (1.0, 2.0, 3.0), (0.1, -0.2, 0.3))
    body = fmbd.RigidBody("body", 1.0, (0.1, 0.2, 0.3), (0.4, 0.5, 0.8))
    made = fmbd.Scene("many")
    made.add(base, body)
    sides = [fmbd.ball(body, 0.05, center=(0.1, 0, 0)), fmbd.corners(body, [(0.2, 0.1, -0.3), (-0.2, 0.3, 0.1)])]
    for k in chosen:
        held: Any = ({}, {"on": base}, {"motion": swing})[k % 3]
        obstacle = fmbd.Obstacle(f"obstacle {k}", SHAPES[k % len(SHAPES)], **held)
        made.add(fmbd.contact(f"{k}", sides[k % 2], obstacle, friction=0.1 * k))
    return made


def looked_at(chosen: list[int]) -> Any:
    """The system, and its contacts at a time in a place and with a step."""
    system, state, _ = scene_of(chosen).build()
    q = system.compose(state.q, 0.3 * np.random.default_rng(1).standard_normal(system.n_v))
    return system, q, system.contacts.rows(system, 0.4, q, way=way_over(0.4, 0.1))


def test_all_pairs_at_once_are_each_by_itself() -> None:
    order = [int(k) for k in np.random.default_rng(2).permutation(18)[:9]]
    _, _, rows = looked_at(order)
    one_by_one = [looked_at([k])[2] for k in order]
    for name in ("gap", "normal", "friction", "restitution", "drift", "trace"):
        # a pair without friction has no tangents when it is alone
        found = [getattr(r, name) for r in one_by_one]
        if name == "drift":
            found = [x if x.shape[1] else np.zeros((len(x), 2)) for x in found]
            keep = rows.friction > 0
            assert rows.drift[keep] == pytest.approx(np.concatenate(found)[keep], abs=1e-14)
            continue
        assert getattr(rows, name) == pytest.approx(np.concatenate(found), abs=1e-12), name
    assert rows.N.core == pytest.approx(np.concatenate([r.N.core for r in one_by_one]), abs=1e-12)


def test_rows_are_the_derivatives_of_gaps_for_every_shape() -> None:
    system, q, rows = looked_at(list(range(18)))
    v = np.random.default_rng(3).standard_normal(system.n_v)
    after, before = (system.contacts.touch(system, 0.4, system.compose(q, s * 1e-6 * v)).gap for s in (1, -1))
    assert system.contacts.times(system, rows.N, v) == pytest.approx((after - before) / 2e-6, rel=1e-6, abs=1e-7)


@pytest.mark.mpi
def test_rows_of_one_surface_against_several_obstacles() -> None:
    """Nodes of one trace in several pairs, points of a rigid body between them."""
    mesh = fmbd.read_gmsh(BLOCK, size=(0.6, 0.3), cells=4, origin=(-0.3, 0.2))
    block = fmbd.FloatingBody("block", mesh, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3))
    body = fmbd.RigidBody("body", 1.0, 0.1, (0, -0.5))
    made = fmbd.Scene("block")
    made.add(block, body)
    for k, side in enumerate(
        (block.surface("bottom"), fmbd.ball(body, 0.1), block.surface("top"), block.surface("bottom"))
    ):
        on = body if k == 3 else None
        made.add(fmbd.contact(f"{k}", side, fmbd.Obstacle(f"o{k}", fmbd.Sphere(0.1 + 0.1 * k), on=on), friction=0.1))
    system, state, _ = made.build()
    rng = np.random.default_rng(4)
    v = np.zeros(system.n_v)
    v[: system.contacts.n_core] = rng.standard_normal(system.contacts.n_core)
    local = system.local_v(v, 0)
    local[:] = rng.standard_normal(len(local))
    rows = system.contacts.rows(system, 0.0, state.q)
    after, before = (system.contacts.touch(system, 0.0, system.compose(state.q, s * 1e-6 * v)).gap for s in (1, -1))
    assert system.contacts.times(system, rows.N, v) == pytest.approx((after - before) / 2e-6, rel=1e-6, abs=1e-7)
    assert list(np.unique(rows.trace[system.contacts.pair == 1])) == [-1]
    assert set(rows.trace[system.contacts.pair != 1]) == {0}

    near = rng.random(len(rows.gap)) < 0.3
    some, expected = system.contacts.rows(system, 0.0, state.q, near=near), rows.take(near)
    for name in ("gap", "normal", "friction", "restitution", "drift", "trace"):
        assert getattr(some, name) == pytest.approx(getattr(expected, name), abs=1e-15), name
    assert some.L.core == pytest.approx(expected.L.core, abs=1e-15)
    moved = [system.contacts.times(system, x.L, v) for x in (some, expected)]
    assert moved[0] == pytest.approx(moved[1], abs=1e-14)
    assert moved[0][:: some.components] == pytest.approx(system.contacts.times(system, some.N, v), abs=1e-14)


@pytest.mark.parametrize("motion", [True, False])
def test_rows_of_some_are_taken_from_those_of_all(motion: bool) -> None:
    order = list(range(9)) if motion else [0, 1, 3, 4]
    system, q, rows = looked_at(order)
    near = np.random.default_rng(5).random(len(rows.gap)) < 0.5
    some, expected = system.contacts.rows(system, 0.4, q, way=way_over(0.4, 0.1), near=near), rows.take(near)
    for name in ("gap", "normal", "friction", "restitution", "drift", "trace"):
        assert getattr(some, name) == pytest.approx(getattr(expected, name), abs=1e-15), name
    assert some.L.core == pytest.approx(expected.L.core, abs=1e-15)


def test_gaps_are_those_of_the_shapes() -> None:
    """Against each shape by itself, at the place of the point in the axes of its obstacle."""
    chosen = list(range(9))
    system, q, _ = looked_at(chosen)
    seen = system.contacts.touch(system, 0.4, q)
    for i, k in enumerate(chosen):
        at = system.contacts.pair == i
        distance, _ = SHAPES[k].evaluate(seen.relative[at])
        assert seen.gap[at] == pytest.approx(distance - (0.0 if k % 2 else 0.05), abs=1e-14), k


def test_the_work_of_a_search_does_not_grow_with_the_pairs() -> None:
    """Python calls of one look at the gaps, with 2 and with 20 balls over planes."""
    calls = []
    for number in (2, 20):
        scene = fmbd.Scene("balls")
        for i in range(number):
            body = fmbd.RigidBody(f"{i}", 1.0, (0.1,) * 3, (i, 0, 1))
            floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0, 0), (0, 0, 1)))
            scene.add(body, fmbd.contact(f"at {i}", fmbd.ball(body, 0.1), floor))
        system, state, _ = scene.build()
        system.contacts.touch(system, 0.0, state.q)

        count = [0]
        sys.setprofile(lambda _frame, event, _arg, n=count: n.__setitem__(0, n[0] + event.endswith("call")))
        system.contacts.touch(system, 0.0, state.q)
        sys.setprofile(None)
        calls.append(count[0])
    assert calls[1] == calls[0]


def test_poses_of_moving_obstacles_are_asked_for_once_a_time() -> None:
    """By rows, gaps and drifts alike, whatever the order of the times of a step."""
    asked: list[float] = []

    def slide(t: float) -> Any:
        asked.append(t)
        return (0.1 * t, 0.2 * t, 0.0), None

    body = fmbd.RigidBody("body", 1.0, (0.1, 0.2, 0.3), (0.4, 0.5, 0.8))
    made = fmbd.Scene("belt")
    belt = fmbd.Obstacle("belt", fmbd.HalfSpace((0, 0, 0), (0.1, 1, 0)), motion=slide)
    made.add(body, fmbd.contact("feet", fmbd.corners(body, [(0.2, 0.1, -0.3), (-0.2, 0.3, 0.1)]), belt, friction=0.2))
    system, state, _ = made.build()
    asked.clear()
    gaps = [system.contacts.touch(system, t, state.q.copy()).gap for t in (0.0, 0.1, 0.05, 0.1)]
    rows = system.contacts.rows(system, 0.05, state.q, way=way_over(0.0, 0.1))
    assert sorted(asked) == [0.0, 0.05, 0.1]
    assert gaps[1] == pytest.approx(gaps[3], abs=0.0)
    assert rows.gap == pytest.approx(gaps[2], abs=0.0)
    assert not np.allclose(gaps[0], gaps[1])
    assert np.abs(rows.drift).max() > 1e-3
