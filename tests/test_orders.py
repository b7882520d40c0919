"""Orders of positions, velocities and multipliers of every scheme in every form, within 0.15 of the theory on both sides.

A planar pendulum (1 m, 9.81 m/s^2) with constant steps against its angle by DOP853; the orders that theory gives for index-3
systems: Hairer, Lubich and Roche, doi:10.1007/BFb0093947. Half-step multipliers of RATTLE: ``test_rattle``; the stiff spring
pendulum: ``test_stiff_pendulum``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from dae_problems import observed, pendulum, pendulum_at, spinning_top

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import plane_stress
from fmbd_fenicsx.run.accuracy.orders import expected_orders
from fmbd_fenicsx.schemes.implicit.implicit_stepper import ImplicitStepper
from fmbd_fenicsx.schemes.own_marching import OwnMarch

# scheme, orders of (q, v, lambda), steps in 1.5 s: where the error is asymptotic and above roundoff
TABLE: list[tuple[Any, tuple[int, int, int], tuple[int, ...]]] = [
    (fmbd.Radau(2, fmbd.Index3(), None), (3, 2, 1), (40, 80, 160)),
    (fmbd.Radau(2, fmbd.Index2(), None), (3, 3, 2), (40, 80, 160)),
    (fmbd.Radau(2, fmbd.Index1(), None), (3, 3, 3), (40, 80, 160)),
    (fmbd.Radau(2, fmbd.GGL(), None), (3, 3, 2), (40, 80, 160)),
    (fmbd.Radau(3, fmbd.Index3(), None), (5, 3, 2), (40, 60, 80)),
    (fmbd.Radau(3, fmbd.Index2(), None), (5, 5, 3), (20, 30, 40)),
    (fmbd.Radau(3, fmbd.Index1(), None), (5, 5, 5), (16, 24, 36)),
    (fmbd.Radau(3, fmbd.GGL(), None), (5, 5, 3), (20, 30, 40)),
    (fmbd.GeneralizedAlpha(0.8), (2, 2, 2), (80, 160, 320)),
    (fmbd.GeneralizedAlpha(0.8, form=fmbd.GGL()), (2, 2, 2), (80, 160, 320)),
    (fmbd.Rattle(), (2, 2, 2), (80, 160, 320)),
    (fmbd.BDF(1, fmbd.Index3(), None), (1, 1, 1), (160, 320, 640)),
    (fmbd.BDF(2, fmbd.Index3(), None), (2, 2, 2), (80, 160, 320)),
    (fmbd.BDF(3, fmbd.Index3(), None), (3, 3, 3), (80, 160, 320)),
    (fmbd.BDF(1, fmbd.Index2(), None), (1, 1, 1), (160, 320, 640)),
    (fmbd.BDF(2, fmbd.Index2(), None), (2, 2, 2), (80, 160, 320)),
    (fmbd.BDF(3, fmbd.Index2(), None), (3, 3, 3), (80, 160, 320)),
    (fmbd.HalfExplicit(rtol=None), (4, 4, 4), (40, 80, 160)),
    (fmbd.EnergyMomentum(), (2, 2, 2), (40, 80, 160)),
]


def label(scheme: Any) -> str:
    form = getattr(scheme, "form", None)
    return scheme.name if form is None or form.name in scheme.name else f"{scheme.name}, {form.name}"


@pytest.mark.parametrize(("scheme", "expected", "steps"), TABLE, ids=[label(row[0]) for row in TABLE])
def test_orders(scheme: Any, expected: tuple[int, int, int], steps: tuple[int, ...]) -> None:
    found = observed(scheme, steps, 1.5 if label(scheme).startswith("Radau IIA(3), Index1") else 1.0)
    assert (np.abs(found - np.array(expected)) < 0.15).all(), found


@pytest.mark.parametrize(
    ("scheme", "rtol", "closed"),
    [
        *((fmbd.HalfExplicit, rtol, 1e-12) for rtol in (1e-3, 1e-6, 1e-9)),
        *((fmbd.ExplicitRungeKutta, rtol, 1e-13) for rtol in (1e-4, 1e-8, 1e-11)),
    ],
)
def test_errors_of_explicit_schemes_follow_the_tolerance(scheme: Any, rtol: float, closed: float) -> None:
    run = fmbd.solve(pendulum(), t_end=1.0, scheme=scheme(rtol))
    x, v, lam = pendulum_at(1.0)
    assert np.abs(run["x"][-1] - x).max() < 5 * rtol
    assert np.abs(run["v"][-1] - v).max() < 10 * rtol
    assert abs(abs(run.state.lam[0]) - lam) < 50 * rtol
    assert run.drift[0] < closed and run.drift[1] < 1e-12
    assert run.counters["jacobians"] == 0


@pytest.mark.parametrize("make", [pendulum, spinning_top])
@pytest.mark.parametrize(
    ("scheme", "counts", "order"),
    [(fmbd.HalfExplicit(None), (20, 80), 3.7), (fmbd.ExplicitRungeKutta(None), (2, 4), 6.3)],
    ids=["half-explicit", "Runge-Kutta"],
)
def test_values_between_the_ends_of_explicit_steps(
    scheme: Any, counts: tuple[int, int], order: float, make: Any
) -> None:
    """Positions, velocities and, as these are solved for, reactions are of order 4 and 7; also with rotations in space."""
    scene = make()
    if make is spinning_top:
        body = scene.bodies["top"]
        scene.sensor("x", fmbd.position(body, point=(0.1, 0.2, 0.3)))
        scene.sensor("v", fmbd.velocity(body))
        scene.sensor("force", fmbd.reaction("tip"))
    output = fmbd.Output(times=tuple(np.linspace(0.013, 0.247, 14)), energy=False)
    exact = fmbd.solve(scene, t_end=0.25, scheme=fmbd.Radau(5, rtol=1e-12), output=output)
    runs = [fmbd.solve(scene, t_end=0.25, dt=0.25 / n, scheme=scheme, output=output) for n in counts]
    for name in scene.sensors:
        errors = [np.abs(run[name] - exact[name]).max() for run in runs]
        assert np.log(errors[0] / errors[1]) / np.log(counts[1] / counts[0]) > order, (name, errors)


@pytest.mark.parametrize(
    ("scheme", "share"),
    [
        (fmbd.BDF(2, fmbd.StateSpace(), None), 1e-4),
        (fmbd.Radau(3, fmbd.StateSpace(), None), 1e-4),
        (fmbd.BDF(form=fmbd.StateSpace(), rtol=1e-7), 2e-6),  # 0.7 to 19 tolerances, 2.8 in the middle
        (fmbd.Radau(3, fmbd.Overdetermined(), 1e-7), 1e-6),
    ],
    ids=lambda x: x.name if hasattr(x, "name") else "",
)
def test_accelerations_of_what_joints_prescribe(scheme: Any, share: float) -> None:
    """A slider that a crank drives: places and velocities follow from joints alone, so that they tell nothing of multipliers,
    and Newton's iteration once left these as they were foretold, further off from step to step.
    """
    scene, r, l, T = fmbd.Scene("driven slider"), 0.2, 0.6, 1.2
    crank, rod = fmbd.RigidBody("crank", 0.9, 3e-3, (0.1, 0.0)), fmbd.RigidBody("rod", 1.4, 0.04, (0.5, 0.0))
    slider = fmbd.RigidBody("slider", 2.0, 0.1, (0.8, 0.0))
    scene.add(crank, rod, slider, fmbd.revolute("A", fmbd.ground, crank, center=(0, 0)))
    scene.add(fmbd.revolute("B", crank, rod, center=(r, 0)), fmbd.revolute("C", rod, slider, center=(r + l, 0)))
    scene.add(fmbd.prismatic("D", fmbd.ground, slider, axis=(1, 0), center=(r + l, 0)))
    turned = np.polynomial.Polynomial([0, 0, 0, 0, 3.0, -0.5])
    motion = [turned, turned.deriv(), turned.deriv(2)]
    scene.add(fmbd.drive_rotation("motor", fmbd.ground, crank, lambda t: tuple(float(f(t)) for f in motion)))
    scene.sensor("a", fmbd.acceleration(slider))

    run = fmbd.solve(scene, t_end=T, dt=None if scheme.rtol else T / 160, scheme=scheme)
    phi, rate, second = (f(run.times) for f in motion)
    s, c = r * np.sin(phi), r * np.cos(phi)
    w = np.sqrt(l * l - s * s)
    # x = c + w, its first and second derivatives by the angle, and in time
    slope, bend = -s - s * c / w, -c - (c * c - s * s) / w - (s * c) ** 2 / w**3
    exact = bend * rate**2 + slope * second
    assert np.abs(run["a"][:, 0] - exact).max() < share * np.abs(exact).max()


@pytest.mark.parametrize("in_parts", [False, True])
@pytest.mark.parametrize(
    "scheme", [fmbd.Radau(3, rtol=1e-8), fmbd.Radau(2, fmbd.Index2(), 1e-8), fmbd.BDF(rtol=1e-8)], ids=label
)
def test_torques_of_a_given_motion(scheme: Any, in_parts: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Places of a driven arm are those of its drive in steps of any size, and no test of errors asks for the torque; 3e-6 to 2e-5
    of it were off at the ends of steps and between them.
    """
    if in_parts:
        monkeypatch.setattr(OwnMarch, "_chooses_alike", property(lambda self: False))
    m, l, J, g = 1.5, 0.4, 0.1, 9.81
    arm = fmbd.RigidBody("arm", m, J, (l, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    motor = fmbd.drive("motor", fmbd.angle(pin), lambda t: 0.8 * np.sin(2.0 * t))
    scene = fmbd.Scene("arm", gravity=(0.0, -g))
    scene.add(arm, pin, motor)
    scene.sensor("torque", fmbd.reaction(motor))
    for output in (fmbd.Output(), fmbd.Output(times=tuple(np.linspace(0.011, 0.98, 37)))):
        run = fmbd.solve(scene, t_end=1.0, scheme=scheme, output=output)
        t = run.times
        exact = 3.2 * (J + m * l * l) * np.sin(2.0 * t) - m * g * l * np.cos(0.8 * np.sin(2.0 * t))  # on the ground
        assert np.abs(run["torque"][:, -1] - exact).max() < 2e-8 * np.abs(exact).max()


def driven_with_rod(mesh: Any) -> fmbd.Scene:
    """A crank of given motion, an arm, and a stiff rod that hangs on it."""
    rod = fmbd.FloatingBody("rod", mesh, density=100.0, elastic=plane_stress(2e11, 0.3), stiffness_damping=1e-3)
    arm = fmbd.RigidBody("arm", 20.0, 2.0, (-0.5, 0.0))
    crank = fmbd.RigidBody("crank", 5.0, 0.3, (-1.25, 0.0))
    bearing = fmbd.revolute("bearing", fmbd.ground, crank, center=(-1.5, 0.0))
    motor = fmbd.drive("motor", fmbd.angle(bearing), lambda t: 0.5 * np.sin(6.0 * t) ** 3)
    knee = fmbd.revolute("knee", crank, arm, center=(-1.0, 0.0))
    pin = fmbd.revolute("pin", arm, rod.surface("pin"), center=(0.0, 0.0))
    scene = fmbd.Scene("driven", gravity=(0.0, -9.81))
    scene.add(rod, arm, crank, bearing, motor, knee, pin)
    sensors = {"motor": fmbd.reaction(motor), "pin": fmbd.reaction(pin), "arm": fmbd.acceleration(arm)}
    for name, sensor in sensors.items():
        scene.sensor(name, sensor)
    return scene


def worst_of_rod(mesh: Any, scheme: Any, dt: float | None, times: np.ndarray, then: Callable[[], None]) -> float:
    """The largest error of the sensors at the times (s), as shares of their ranges; ``then`` is called between both runs."""
    end, output = float(times[-1]), fmbd.Output(times=tuple(times), progress=False)
    exact = fmbd.solve(driven_with_rod(mesh), t_end=end, dt=6e-4, scheme=fmbd.Radau(3, rtol=None), output=output)
    then()
    run = fmbd.solve(driven_with_rod(mesh), t_end=end, dt=dt, scheme=scheme, output=output)
    offs = {name: np.sqrt(np.mean((run[name] - x) ** 2)) / np.abs(x).max() for name, x in exact.series.items()}
    return float(max(offs.values()))


@pytest.mark.mpi
def test_reactions_of_an_elastic_body(rod_mesh: Any) -> None:
    """Those of a run with steps of 10 us, on one rank and on several; of the stages they are off by 0.02 and 0.04 N."""
    scene = driven_with_rod(rod_mesh(dim=2, h=0.5))
    run = fmbd.solve(scene, t_end=0.015, dt=5e-3, scheme=fmbd.Radau(2, rtol=None), output=fmbd.Output(progress=False))
    assert run["motor"][-1] == pytest.approx(-62.350046, abs=1e-4)
    assert run["pin"][-1] == pytest.approx((1.007995, 11.592996), abs=2e-4)


@pytest.mark.parametrize("between", [False, True])
@pytest.mark.parametrize("in_parts", [False, True])
@pytest.mark.parametrize(
    ("scheme", "share"),
    [(fmbd.Radau(2, rtol=None), 5e-6), (fmbd.BDF(order=2, rtol=None), 1e-3), (fmbd.Radau(3, rtol=1e-6), 3e-7)],
    ids=("Radau(2)", "BDF(2)", "Radau(3), own steps"),
)
def test_reactions_of_an_elastic_body_in_every_way(
    scheme: Any, share: float, in_parts: bool, between: bool, rod_mesh: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At ends of steps and between them; of the stages they are off by 7 to 1 000 times as much."""
    times = np.linspace(0.1013, 0.1987, 14) if between else np.linspace(0.1, 0.2, 21)

    def then() -> None:
        if in_parts:
            monkeypatch.setattr(ImplicitStepper, "_in_one_call", lambda *given: False)

    assert worst_of_rod(rod_mesh(dim=2, h=0.25), scheme, None if scheme.rtol else 5e-3, times, then) < share


@pytest.mark.parametrize("scheme", [fmbd.Radau(2, form, None) for form in (fmbd.GGL(), fmbd.Index2())], ids=label)
def test_multipliers_that_are_read_have_the_order_of_velocities(scheme: Any) -> None:
    """Those of the stages have the order of their number."""
    scene = spinning_top()
    scene.sensor("force", fmbd.reaction("tip"))
    exact = fmbd.solve(scene, t_end=0.2, scheme=fmbd.Radau(5, rtol=1e-12))
    ends = [fmbd.solve(scene, t_end=0.2, dt=0.2 / n, scheme=scheme) for n in (20, 40)]
    errors = [np.abs(run["force"][-1] - exact["force"][-1]).max() for run in ends]
    assert np.log2(errors[0] / errors[1]) > scheme.order - 0.3
    assert expected_orders(scheme, scene, ends[0].system)["force"] == scheme.order
