"""Contact of rods with obstacles by their radius."""

from __future__ import annotations

import numpy as np
import pytest
from test_compiled_contact import in_numpy

import fmbd_fenicsx as fmbd

SECTION = fmbd.RodSection.circle(youngs_modulus=1e6, poisson_ratio=0.3, density=1000.0, radius=0.02)
FLOOR = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0, 0), normal=(0, 0, 1)))


def test_rows_are_the_derivative_of_the_gaps():
    """A bent rod near a ball that a moving body carries."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (0.5, 0.2, 0), (1, 0, 0)], SECTION, elements=2, degree=2)
    bob = fmbd.RigidBody("bob", 1.0, (0.1, 0.2, 0.3), position=(0.4, 0.1, 0.5))
    ball = fmbd.Obstacle("ball", fmbd.Sphere(0.2, (0.1, 0, 0)), on=bob)
    scene = fmbd.Scene("near")
    scene.add(bob, rod, fmbd.contact("touch", fmbd.contacts.along(rod, 0.02), ball, friction=0.5))
    system, state, _ = scene.build()
    rng = np.random.default_rng(3)
    q = system.compose(state.q, 0.1 * rng.standard_normal(system.n_v))
    v, e = rng.standard_normal(system.n_v), 1e-6

    rows = system.contacts.rows(system, 0.0, q)
    after, before = (system.contacts.touch(system, 0.0, system.compose(q, s * e * v)).gap for s in (1, -1))
    np.testing.assert_allclose(system.contacts.times(system, rows.N, v), (after - before) / (2 * e), rtol=1e-7)
    assert len(rows.gap) == len(rod.nodes)

    # a force on all points does the work of the rows
    force = rng.standard_normal(len(rows.gap))
    work = system.contacts.transposed(system, rows.N, force) @ v
    assert work == pytest.approx(force @ system.contacts.times(system, rows.N, v), rel=1e-12)


def test_a_rod_falls_and_lies_on_a_floor():
    """Its weight stands on the nodes, whose centres are at the radius above the floor."""
    rod = fmbd.Rod("rod", [(-0.2, 0, 0.025), (0.2, 0, 0.025)], SECTION, elements=2, degree=1, damping=2e-3)
    scene = fmbd.Scene("drop", gravity=(0, 0, -9.81))
    scene.add(rod, fmbd.contact("land", fmbd.contacts.along(rod, 0.02), FLOOR))
    scene.sensor("force", fmbd.sensors.contact_force("land"))
    scene.sensor("end", fmbd.sensors.position(rod.surface("end")))
    run = fmbd.solve(scene, t_end=0.1, dt=2e-3, scheme=fmbd.Moreau())

    weight = 1000 * np.pi * 0.02**2 * 0.4 * 9.81
    np.testing.assert_allclose(run["force"][-1], (0, 0, weight), rtol=1e-8, atol=1e-9)
    assert run["end"][-1][2] == pytest.approx(0.02, abs=1e-5)
    assert np.diff(run.total_energy).max() < 1e-10 * run.total_energy[0]


@pytest.mark.parametrize("compiled", [True, False], ids=["C", "NumPy"])
def test_a_stiff_ring_bounces(compiled, monkeypatch):
    """Its first iterates have stresses far from those of the middle of a step: a matrix of these alone leads nowhere."""
    if not compiled:
        in_numpy(monkeypatch)
    radius, thick, scene = 0.3, 0.004, fmbd.Scene("ring", gravity=(0, -9.81, 0))
    section = fmbd.RodSection.circle(youngs_modulus=2e10, poisson_ratio=0.3, density=1200.0, radius=thick)
    floor, halves = fmbd.HalfSpace((0, -radius - thick, 0), (0, 1, 0)), []
    for side in (1, -1):

        def half(u, side=side):
            return side * radius * np.sin(np.pi * u), -side * radius * np.cos(np.pi * u), 0.0

        halves.append(fmbd.Rod(f"{side}", half, section, elements=3, normal=(0, 0, 1), velocity=(0, -3.001, 0)))
    for a, b in (halves, halves[::-1]):
        touch = fmbd.contact(f"contact {a.name}", fmbd.contacts.along(a, thick), floor, friction=0.6)
        scene.add(a, touch, fmbd.fixed(f"weld {a.name}", a.surface("end"), b.surface("start")))
    run = fmbd.solve(scene, t_end=0.03, dt=1e-3, scheme=fmbd.Moreau())
    assert run.counters.get("halved_steps", 0) == 0
    assert run.counters.get("compiled_steps", 0) == (30 if compiled else 0)
    assert run.counters["newton_iterations"] < 10 * 30


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_a_rope_around_a_cylinder(friction):
    """Half a turn around a fixed cylinder: it slips when one end's force exceeds the other's by exp(mu pi) (Eytelwein);
    a few nodes stand for the half turn, so the bounds are a fifth below and a tenth above."""
    R, r, pull = 0.1, 0.005, 1.0
    rope = fmbd.RodSection((2e3, 2e2, 2e2, 1e-4, 1e-4, 1e-4), mass=0.05, inertia=(2e-6, 1e-6, 1e-6))
    bent = lambda u: _around(u, R + r, 0.15)  # noqa: E731
    rod = fmbd.Rod("rope", bent, rope, elements=12, degree=1, damping=1e-3)
    drum = fmbd.Obstacle("drum", fmbd.Cylinder(R, (0, 1, 0)))
    slip = np.exp(friction * np.pi)

    def speed(ratio):
        scene = fmbd.Scene("capstan")
        scene.add(rod, fmbd.contact("wrap", fmbd.contacts.along(rod, r), drum, friction=friction))
        ramp = lambda t: min(t / 0.05, 1.0)  # noqa: E731
        scene.add(fmbd.forces.force("left", rod.surface("start"), lambda t: (0, 0, -pull * ramp(t))))
        scene.add(fmbd.forces.force("right", rod.surface("end"), lambda t: (0, 0, -pull * ratio * ramp(t))))
        scene.sensor("end", fmbd.sensors.velocity(rod.surface("end")))
        return -fmbd.solve(scene, t_end=0.12, dt=1e-3, scheme=fmbd.Moreau())["end"][-1][2]

    assert abs(speed(1.0 + 0.8 * (slip - 1.0))) < 1e-3
    assert speed(1.1 * slip) > 0.3


def _around(u, radius, leg):
    """Up a leg, half a turn over the drum, down the other leg; u in [0, 1]."""
    s = u * (2 * leg + np.pi * radius)
    if s < leg:
        return (-radius, 0.0, s - leg)
    angle = (s - leg) / radius
    if angle > np.pi:
        return (radius, 0.0, -(s - leg - np.pi * radius))
    return (-radius * np.cos(angle), 0.0, radius * np.sin(angle))


def test_bad_input():
    rod = fmbd.Rod("rod", [(0, 0, 1), (1, 0, 1)], SECTION)
    with pytest.raises(fmbd.errors.InputError, match="radius"):
        fmbd.contacts.along(rod, 0.0)
    other = fmbd.Rod("other", [(0, -1, 0), (0, 1, 0)], SECTION)
    with pytest.raises(
        fmbd.errors.InputError, match='"other" cannot be the master: contact between rods is not offered'
    ):
        fmbd.contact("crossing", fmbd.contacts.along(rod, 0.02), fmbd.contacts.along(other, 0.02))
    with pytest.raises(fmbd.errors.InputError, match="no mesh whose surface could touch"):
        fmbd.contact("ends", rod.surface("end"), other.surface("end"))
    with pytest.raises(fmbd.errors.InputError, match="overlap at the start by 0.01"):
        scene = fmbd.Scene("low", gravity=(0, 0, -9.81))
        low = fmbd.Rod("low", [(0, 0, 0.01), (1, 0, 0.01)], SECTION)
        scene.add(low, fmbd.contact("land", fmbd.contacts.along(low, 0.02), FLOOR))
        fmbd.solve(scene, t_end=0.1, dt=1e-3, scheme=fmbd.Moreau())
