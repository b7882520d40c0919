"""Radau and BDF with elastic fields: orders, stiff bodies in large steps, factors kept for a grid of step sizes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dae_problems import march
from profiled import calls_of
from test_compiled_parts import beside_a_field
from test_wave_through_tie import tied_bar
from tolerance_scenes import fe_crank

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError, ConvergenceError, InputError
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.materials import (
    linear_elastic,
    nearly_incompressible,
    neo_hookean_incompressible,
    saint_venant_kirchhoff,
)
from fmbd_fenicsx.schemes.dae import Points
from fmbd_fenicsx.schemes.implicit import field_stages
from fmbd_fenicsx.schemes.implicit.field_stages import FieldEquations
from fmbd_fenicsx.schemes.implicit.implicit_stepper import ImplicitStepper
from fmbd_fenicsx.schemes.implicit.step_newton import StepNewton
from fmbd_fenicsx.schemes.multistep.bdf import BDFStepper
from fmbd_fenicsx.schemes.onestep.radau import RadauStepper
from fmbd_fenicsx.system.compiled.choice import use_driver

T_END = 0.25  # s


def pendulum(mesh: Any, kind: str = "floating", E: float = 5e6, ramp: float = 0.0) -> fmbd.Scene:
    """A rod on a pin under gravity that is switched on within ``ramp`` seconds."""
    if kind == "floating":
        rod: Any = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=linear_elastic(E, 0.3))
    else:
        rod = fmbd.AbsoluteBody("rod", mesh, density=1000.0, energy=saint_venant_kirchhoff(E, 0.3), quadrature=4)
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81, 0.0)[: rod.dim], gravity_ramp=ramp)
    axis = {} if rod.dim == 2 else {"axis": (0, 0, 1)}
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0, 0)[: rod.dim], **axis))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    return scene


def orders(scene: fmbd.Scene, schemes: list[Any], reference: Any, steps: tuple[int, int], t_end: float) -> np.ndarray:
    """Orders of q, v, lambda of each scheme between two numbers of steps, (2, schemes, 3): of the largest errors over the
    instants that all runs share, and of those at the end, which change their sign from step to step.
    """
    system = scene.build()[0]

    def states(scheme: Any, n: int) -> list[Any]:
        return march(scene, scheme, t_end, n, 1e-11)[:: n // steps[0]][1:]

    exact = states(reference, 4 * steps[1])

    def errors(scheme: Any, n: int) -> np.ndarray:
        off = [
            (system.units * system.difference(x.q, y.q), system.units * (y.v - x.v), y.lam - x.lam)
            for x, y in zip(exact, states(scheme, n), strict=True)
        ]
        sizes = np.array([[np.abs(x).max() for x in kinds] for kinds in off])
        return np.stack((sizes.max(axis=0), sizes[-1]))

    coarse, fine = (np.stack([errors(s, n) for s in schemes], axis=1) for n in steps)
    return np.log2(coarse / fine)


def test_orders_of_two_stages_on_the_elastic_pendulum(rod_mesh: Callable[..., Any]) -> None:
    """2 s - 1, s, s - 1 at index 3; 2 s - 1, 2 s - 1, s at index 2; 2 s - 1 in q and v at index 1. The load is smooth; with the
    highest vibrations, which these steps do not resolve, lambda of index 1 stays near s.
    """
    scene = pendulum(rod_mesh(dim=2, h=0.5, height=0.2), ramp=T_END)
    schemes = [fmbd.Radau(2, form, None) for form in (fmbd.Index3(), fmbd.Index2(), fmbd.Index1())]
    found, _ = orders(scene, schemes, fmbd.Radau(3, fmbd.Index2(), None), (20, 40), T_END)
    expected = np.array([[3, 2, 1], [3, 3, 2], [3, 3, 2]])
    assert (found > expected - 0.4).all(), found


@pytest.mark.slow
def test_orders_of_three_stages_by_form(rod_mesh: Callable[..., Any]) -> None:
    """5, 3, 2 at index 3; 5, 5, 3 at index 2 and 1, over all instants: v loses up to one order to the stiffest modes, that of GGL
    to s; lambda gains one.
    """
    scene = pendulum(rod_mesh(dim=2, h=0.5, height=0.2), ramp=T_END)
    schemes = [fmbd.Radau(3, form, None) for form in (fmbd.Index3(), fmbd.Index2(), fmbd.Index1(), fmbd.GGL())]
    found, at_end = orders(scene, schemes, fmbd.Radau(5, fmbd.Index2(), None), (20, 40), T_END)
    least = np.array([[4.7, 3.0, 2.5], [4.8, 4.1, 3.4], [4.8, 4.1, 3.5], [4.8, 3.0, 3.0]])
    assert (found > least).all(), found
    least = np.array([[4.3, 2.8, 1.8], [4.3, 4.5, 2.8], [4.3, 4.5, 2.8], [4.3, 3.3, 2.8]])
    assert (at_end > least).all(), at_end


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "steps", "least"),
    [
        ("tied", (10, 20), (4.8, 4.8, 4.8)),
        ("absolute", (10, 20), (4.6, 3.8, -np.inf)),
        ("absolute", (20, 40), (4.8, 3.6, 4.8)),
    ],
)
def test_orders_of_three_stages_where_rows_are_linear(
    rod_mesh: Callable[..., Any], kind: str, steps: tuple[int, int], least: tuple[float, ...]
) -> None:
    """5 in q, v and lambda of the tied bar in every form; 5 in q and lambda and 3.7 in v of the absolute body, whose stiffest
    vibrations these steps do not resolve.
    """
    scene = tied_bar(2, 1)[0] if kind == "tied" else pendulum(rod_mesh(dim=2, h=0.5, height=0.2), kind, ramp=T_END)
    schemes = [fmbd.Radau(3, form, None) for form in (fmbd.Index3(), fmbd.Index2(), fmbd.Index1(), fmbd.GGL())]
    t_end = 0.1 if kind == "tied" else 0.5 * T_END
    found, at_end = orders(scene, schemes, fmbd.Radau(5, fmbd.Index2(), None), steps, t_end)
    assert ((at_end if steps == (10, 20) else found) > least).all(), (found, at_end)
    assert found == pytest.approx(np.broadcast_to(found[0], found.shape), abs=0.05)


def test_orders_on_a_tied_bar() -> None:
    """A standing wave through a tie of field multipliers. Its rows are linear: every form has full order."""
    scene, _ = tied_bar(2, 1)
    found, _ = orders(scene, [fmbd.Radau(2, fmbd.GGL(), None)], fmbd.Radau(3, fmbd.Index2(), None), (10, 20), 0.1)
    assert (found > [[2.7, 2.5, 2.5]]).all(), found


def test_orders_of_an_absolute_nonlinear_body(rod_mesh: Callable[..., Any]) -> None:
    """The rows of the pin are linear here too."""
    scene = pendulum(rod_mesh(dim=2, h=0.5, height=0.2), "absolute", ramp=T_END)
    found, _ = orders(
        scene, [fmbd.Radau(2, fmbd.Index3(), None)], fmbd.Radau(3, fmbd.Index2(), None), (10, 20), 0.5 * T_END
    )
    assert (found > [[2.7, 1.9, 2.5]]).all(), found


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "least"), [("tied", (2.8, 2.8, 2.8)), ("absolute", (2.8, 2.0, 2.8))])
def test_every_form_has_the_same_orders_where_rows_are_linear(
    rod_mesh: Callable[..., Any], kind: str, least: tuple[float, ...]
) -> None:
    """2 s - 1 in q and lambda for all; v of the absolute body loses to vibrations that these steps do not resolve."""
    scene = tied_bar(2, 1)[0] if kind == "tied" else pendulum(rod_mesh(dim=2, h=0.5, height=0.2), kind, ramp=T_END)
    forms = (fmbd.Index3(), fmbd.Index2(), fmbd.Index1(), fmbd.GGL())
    schemes = [fmbd.Radau(2, form, None) for form in forms]
    t_end = 0.1 if kind == "tied" else 0.5 * T_END
    found, _ = orders(scene, schemes, fmbd.Radau(3, fmbd.Index2(), None), (10, 20), t_end)
    assert (found > least).all(), found
    assert found == pytest.approx(np.broadcast_to(found[0], found.shape), abs=0.01)


@pytest.mark.mpi
@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()], ids=lambda f: f.name)
def test_a_stiff_rod_released_at_once_takes_large_steps(rod_mesh: Callable[..., Any], form: Any) -> None:
    """Vibrations above 1e4 rad/s of amplitudes below the tolerance: 20 steps a second, not 300 a millisecond."""
    scene = pendulum(rod_mesh(dim=2, h=0.5, height=0.1), E=2e11)
    run = fmbd.solve(scene, t_end=1.0, scheme=fmbd.Radau(3, form, 1e-4))
    fine = fmbd.solve(scene, t_end=1.0, dt=1e-3)
    assert np.abs(run["tip"][-1] - fine["tip"][-1]).max() < 3e-4
    assert run.counters["steps"] + run.counters["rejections"] <= 40
    # steps from 1e-3 s or so to 0.1 s: three factors for a decade, and the one at either end
    span = np.log10(np.diff(run.times).max() / np.diff(run.times).min())
    assert run.counters["factorisations"] <= 3 * span + 2


@pytest.mark.parametrize("scheme", [fmbd.Radau(3, rtol=1e-6), fmbd.BDF(rtol=1e-6)], ids=lambda s: s.name)
def test_a_reduced_rod_takes_the_steps_of_its_field(rod_mesh: Callable[..., Any], scheme: Any) -> None:
    """Stiff modes that tremble by less than the tolerance do not hold the steps down; the tip is that of the field."""
    field = fmbd.FloatingBody("rod", rod_mesh(h=0.5), density=2700.0, elastic=linear_elastic(7e10, 0.33))
    runs = []
    for rod in (field, field.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 8))):
        scene = fmbd.Scene("released", gravity=(0.0, -9.81))
        scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
        scene.sensor("tip", fmbd.position(rod.surface("tip")))
        runs.append(fmbd.solve(scene, t_end=0.01, scheme=scheme))

    steps = [run.counters["steps"] for run in runs]
    assert max(steps) < 1.5 * min(steps) + 10
    np.testing.assert_allclose(runs[1]["tip"][-1], runs[0]["tip"][-1], atol=2e-6)


@pytest.mark.parametrize(
    "scheme", [fmbd.Radau(2, fmbd.Index2(), 1e-4), fmbd.BDF(2, fmbd.GGL(), 1e-4)], ids=lambda s: s.name
)
def test_error_control_of_an_absolute_body(rod_mesh: Callable[..., Any], scheme: Any) -> None:
    scene = pendulum(rod_mesh(dim=2, h=0.5, height=0.2), "absolute", ramp=0.2)
    run = fmbd.solve(scene, t_end=0.4, scheme=scheme)
    fine = fmbd.solve(scene, t_end=0.4, dt=5e-4)
    assert np.abs(run["tip"][-1] - fine["tip"][-1]).max() < 2e-3


def test_sizes_that_newton_finds_no_end_of_are_not_tried_in_every_step(rod_mesh: Callable[..., Any]) -> None:
    """A stiff absolute rod turns too far in long steps, for any tangent: 73 tries of 105 steps failed, with 240 factors."""
    scene = pendulum(rod_mesh(dim=2, h=0.5), "absolute", E=2e10)
    run = fmbd.solve(scene, t_end=0.5, scheme=fmbd.Radau(2, rtol=1e-4))
    assert run.counters["rejections"] < 0.2 * run.counters["steps"]
    assert run.counters["factorisations"] < 45


@pytest.mark.parametrize("error", [ConvergenceError, CallbackError])
@pytest.mark.parametrize("scheme, before, times", [(fmbd.Radau(3, rtol=1e-2), 1, 2), (fmbd.BDF(rtol=1e-2), 4, 2)])
def test_a_motion_out_of_range_makes_a_step_smaller(
    scheme: Any, before: int, times: int, error: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After some steps in turn one is foretold with a rod bent by more than its length, or where a law has no value; what has the
    tangent of a step before tries again with a new one first.
    """
    monkeypatch.setattr(ImplicitStepper, "_march_of", lambda _: None)
    iterated, foretold = StepNewton.found, iter([*before * [False], *times * [True]])

    def out_of_range() -> Any:
        raise error("out of range")

    def found(self: Any, state: Any, iterate: Any) -> Any:
        return iterated(self, state, out_of_range if next(foretold, False) else iterate)

    monkeypatch.setattr(StepNewton, "found", found)
    run = fmbd.solve(fe_crank(2), t_end=0.005, scheme=scheme)
    assert run.status == "finished"
    assert run.counters["rejected: forces not finite, or a motion out of range"] == 1


def test_a_law_without_a_value_where_stages_are_foretold() -> None:
    """A mass on a spring that has forces up to a little more than its amplitude."""
    mass = fmbd.RigidBody("mass", 1.0, 0.1, (0.0, 0.0), velocity=(10.0, 0.0))
    guide = fmbd.prismatic("guide", fmbd.ground, mass, axis=(1, 0), center=(0, 0))

    def force(x: float, rate: float, t: float) -> float:
        return 100.0 * x if abs(x) < 1.02 else float("nan")

    scene = fmbd.Scene("range")
    scene.add(mass, guide, fmbd.joint_spring("spring", fmbd.displacement(guide), law=force))
    scene.sensor("x", fmbd.position(mass))
    run = fmbd.solve(scene, t_end=2.0, scheme=fmbd.Radau(3, rtol=0.1))
    assert run.counters["rejected: forces not finite, or a motion out of range"] > 0
    assert run["x"][-1, 0] == pytest.approx(np.sin(20.0), abs=0.05)


def test_high_order_bdf_with_constant_steps_is_refused_for_fields(rod_mesh: Callable[..., Any]) -> None:
    scene = pendulum(rod_mesh(dim=2, h=0.5, height=0.2))
    with pytest.raises(InputError, match="amplifies elastic vibrations"):
        fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=fmbd.BDF(4, fmbd.Index3(), None))


def test_turning_of_local_coordinates(rod_mesh: Callable[..., Any]) -> None:
    """Derivatives of the rates of local coordinates, found once for all frames: what differences along a direction say."""
    scene = pendulum(rod_mesh(dim=3, h=0.5, height=0.2))
    scene.add(fmbd.RigidBody("bob", 1.0, (0.1, 0.2, 0.3), (1.0, 0.0, 0.0)))
    system, start, _ = scene.build()
    rng = np.random.default_rng(2)
    v, real, imaginary = rng.normal(size=(3, system.n_v))
    equations = FieldEquations(system, fmbd.GGL(), StepSolver(system))
    tangent = equations.refresh(replace(start, v=v), np.zeros(equations.n_mult))

    def along(d: np.ndarray) -> np.ndarray:
        return (system.rate(1e-6 * d, v) - system.rate(-1e-6 * d, v)) / 2e-6

    assert tangent.turning(real) == pytest.approx(along(real), abs=1e-8)
    assert tangent.turning(real + 1j * imaginary) == pytest.approx(along(real) + 1j * along(imaginary), abs=1e-8)
    assert np.abs(along(real)).max() > 0.1

    alone, start, _ = pendulum(rod_mesh(dim=3, h=0.5, height=0.2), "absolute").build()  # no frame turns
    equations = FieldEquations(alone, fmbd.GGL(), StepSolver(alone))
    assert equations.refresh(start, np.zeros(equations.n_mult)).turnings.shape == (0, 6, 6)


def test_closing_motions_of_many_multipliers_are_those_of_few(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Many are solved for each time, real and complex ones, where few are kept as a matrix: the same steps."""
    scene = pendulum(rod_mesh(dim=2, h=0.5, height=0.2), ramp=0.1)
    system = scene.build()[0]
    few: list[Any] = []
    many: list[Any] = []
    for found, most in ((few, field_stages.COLUMNS), (many, 0)):
        monkeypatch.setattr(field_stages, "COLUMNS", most)
        found += march(scene, fmbd.Radau(2, fmbd.GGL(), None), 0.1, 4, 1e-11)
    off = system.difference(few[-1].q, many[-1].q)
    assert system.max_abs(few[-1].v) > 0.1
    assert system.max_abs(off) < 1e-11 and system.max_abs(few[-1].v - many[-1].v) < 1e-9


@pytest.mark.mpi
def test_roundoff_of_rates_is_the_same_on_all_ranks(rod_mesh: Callable[..., Any]) -> None:
    """What is roundoff beside the fastest node, which one rank owns, is so in the frames that all hold: no rank goes on alone."""
    system, start, _ = pendulum(rod_mesh(dim=2, h=0.25)).build()
    equations = FieldEquations(system, fmbd.Index3(), StepSolver(system))
    still, rate = np.zeros((2, 1, system.n_v))
    rate[:, 0] = 1e-15
    if system.comm.rank == 0:
        rate[:, -1] = 1.0

    points = Points(still, rate, still, still, np.zeros((1, system.n_lam)))
    equations.origin = start.q
    kin, _ = equations.residual(np.array([start.t]), points)
    assert (kin[:, : system.n_core] == 0.0).all()


def floating(mesh: Any) -> Any:
    return fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=linear_elastic(5e6, 0.3), stiffness_damping=1e-3)


def absolute(mesh: Any) -> Any:
    return fmbd.AbsoluteBody("rod", mesh, density=1000.0, elastic=linear_elastic(5e6, 0.3), stiffness_damping=1e-3)


def stretched(mesh: Any) -> Any:
    return fmbd.AbsoluteBody("rod", mesh, density=1000.0, energy=saint_venant_kirchhoff(5e7, 0.3), quadrature=4)


def pressed(mesh: Any) -> Any:
    return fmbd.FloatingBody(
        "rod", mesh, density=1000.0, elastic=nearly_incompressible(5e6, 0.45), stiffness_damping=1e-4
    )


def rubber(mesh: Any) -> Any:
    """Its pressure is an unknown."""
    return fmbd.AbsoluteBody("rod", mesh, density=1000.0, energy=neo_hookean_incompressible(5e6))


def swing(mesh: Any, dim: int, made: Any = floating) -> fmbd.Scene:
    """A driven rod that swings with a body that spins."""
    rod = made(mesh)
    inertia: Any = 0.1 if dim == 2 else (0.1, 0.2, 0.3)
    bob = fmbd.RigidBody(
        "bob", 2.0, inertia, (1.0, 0.1, 0.0)[:dim], angular_velocity=5.0 if dim == 2 else (1.0, 5.0, 2.0)
    )
    scene = fmbd.Scene("swing", gravity=(0.0, -9.81, 0.0)[:dim])
    pin = fmbd.revolute(
        "pin", fmbd.ground, rod.surface("pin"), center=(0, 0, 0)[:dim], **({} if dim == 2 else {"axis": (0, 0, 1)})
    )
    scene.add(rod, bob, pin, fmbd.drive("drive", fmbd.angle(pin), lambda t: (t**3, 3 * t**2, 6 * t)))
    scene.add(fmbd.spherical("knee", rod.surface("tip"), bob, center=(1.0, 0.05, 0.0)[:dim]))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    return scene


SCHEMES = (
    fmbd.Radau(3, rtol=None),
    fmbd.Radau(3, fmbd.Index3(), None),
    fmbd.Radau(2, fmbd.Index2(), None),
    fmbd.BDF(2, rtol=None),
    fmbd.BDF(1, fmbd.Index3(), None),
)


# in space a step of BDF(2) fails in either way, with increments that grow
CASES = [
    (kind, dim, scheme)
    for kind, dim in ((floating, 2), (floating, 3), (absolute, 2), (stretched, 2), (pressed, 2), (rubber, 2))
    for scheme in SCHEMES
    if not (dim == 3 and scheme.name.startswith("BDF(2)"))
]
CASES += [(floating, 2, fmbd.Radau(5, rtol=None)), (absolute, 2, fmbd.Radau(7, fmbd.Index3(), None))]


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("kind", "dim", "scheme"), CASES, ids=lambda x: getattr(x, "name", getattr(x, "__name__", str(x)))
)
def test_steps_of_one_size_are_calls_of_compiled_code(
    rod_mesh: Callable[..., Any], kind: Any, dim: int, scheme: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Many in one, but for the first of BDF; their states are those of steps that Python makes, with as many increments."""
    scene = swing(rod_mesh(dim=dim, h=0.5, height=0.2), dim, kind)
    output = fmbd.Output(every=10**9, progress=False)
    runs: list[Any] = []
    made: list[int] = []
    for stepper in (RadauStepper, BDFStepper):
        in_parts = stepper._constant
        counted = lambda *given, in_parts=in_parts: (made.append(1), in_parts(*given))[1]  # noqa: E731
        monkeypatch.setattr(stepper, "_constant", counted)

    for parts in (False, True):
        made.clear()
        if parts:
            monkeypatch.setattr(ImplicitStepper, "_march_of", lambda _: None)
        runs.append(fmbd.solve(scene, t_end=0.2, dt=0.01, scheme=scheme, output=output, newton=fmbd.Newton(1e-9)))
        assert len(made) >= 20 if parts else len(made) <= 1

    fast, slow = runs
    assert fast.counters["steps"] == slow.counters["steps"] == 20
    assert fast.counters["newton_iterations"] <= 1.3 * slow.counters["newton_iterations"]
    for name in ("q", "v", "a", "lam"):
        wanted = getattr(slow.state, name)
        assert getattr(fast.state, name) == pytest.approx(wanted, rel=1e-7, abs=1e-7 * np.abs(wanted).max()), name


def beside_a_rod(mesh: Any) -> fmbd.Scene:
    """A viscoelastic rod on the body that spins."""
    scene = swing(mesh, 3)
    section = fmbd.RodSection((2e5, 8e4, 8e4, 50, 40, 40), 2.0, (2e-3, 1e-3, 1e-3), relaxation=[(3.0, 0.01)])
    lash = fmbd.Rod("lash", [(1, 0.1, 0), (1.5, 0.1, 0)], section, elements=2)
    scene.add(lash, fmbd.spherical("end", scene.bodies["bob"], lash.surface("start"), center=(1, 0.1, 0)))
    return scene


def under_control(mesh: Any) -> fmbd.Scene:
    """A rod with a wheel on its tip; what turns both has a fast memory and answers to the motion of the wheel, too."""
    rod, hinges = floating(mesh), []
    scene = fmbd.Scene("controlled", gravity=(0.0, -9.81, 0.0)[: rod.dim])
    tip, axis = (1.0, 0.05, 0.0)[: rod.dim], {} if rod.dim == 2 else {"axis": (0, 0, 1)}
    wheel = fmbd.RigidBody("wheel", 2.0, 0.05 if rod.dim == 2 else (0.05, 0.06, 0.07), tip)
    hinges.append(fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0, 0)[: rod.dim], **axis))
    hinges.append(fmbd.revolute("knee", rod.surface("tip"), wheel, center=tip, **axis))
    pin, knee = map(fmbd.angle, hinges)
    reads = {"s": pin, "s'": fmbd.joint_rate(pin), "k": knee, "x": fmbd.position(wheel), "v": fmbd.velocity(wheel)}

    def law(t: float, y: Any, z: Any) -> tuple[tuple[float, float], float]:
        efforts = -30.0 * y["s"][0] - 2.0 * y["s'"][0] - 300.0 * z[0], -3e4 * z[0] - 3.0 * y["v"][1]
        return efforts, 300.0 * (np.sin(y["k"][0]) + y["x"][1] - 0.05 - z[0])

    scene.add(rod, wheel, *hinges)
    scene.add(fmbd.controller("both", reads=reads, acts=(pin, knee), law=law, memory=(0.0,)))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("kind", "dim", "scheme"),
    [
        (under_control, 2, fmbd.Radau(2, rtol=None)),
        (under_control, 3, fmbd.BDF(2, rtol=None)),
        (under_control, 3, fmbd.Radau(3, rtol=1e-6)),
        (beside_a_rod, 3, fmbd.Radau(3, rtol=None)),
        (beside_a_rod, 3, fmbd.BDF(2, fmbd.Index3(), None)),
        (beside_a_rod, 3, fmbd.Radau(3, rtol=1e-4)),
        (beside_a_field, 2, fmbd.Radau(2, rtol=None)),
    ],
)
def test_beside_rods_and_lines(
    rod_mesh: Callable[..., Any], kind: Any, dim: int, scheme: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Complex matrices have their stiffness, and what they remember: steps are calls of compiled code, as those of Python."""
    scene = kind(rod_mesh(dim=dim, h=0.5, height=0.2))
    sizes: dict[str, Any] = {"t_end": 0.02} if scheme.rtol else {"t_end": 0.02, "dt": 1e-3}
    output = fmbd.Output(every=10**9, progress=False)
    runs: list[Any] = []
    made: list[int] = []
    for stepper, name in ((RadauStepper, "_controlled"), (RadauStepper, "_constant"), (BDFStepper, "_constant")):
        in_parts = getattr(stepper, name)
        counted = lambda *given, in_parts=in_parts: (made.append(1), in_parts(*given))[1]  # noqa: E731
        monkeypatch.setattr(stepper, name, counted)

    for parts in (False, True):
        if parts:
            assert len(made) <= (0.5 * runs[0].counters["steps"] if scheme.rtol else 1)
            monkeypatch.setattr(ImplicitStepper, "_march_of", lambda _: None)
        runs.append(fmbd.solve(scene, scheme=scheme, newton=fmbd.Newton(1e-10), output=output, **sizes))
    fast, slow = runs
    # sizes of own choice differ by what both leave of Newton's iteration; what is not remembered takes a quarter more of them,
    # or of increments
    if not scheme.rtol:
        assert fast.counters["newton_iterations"] <= 1.1 * slow.counters["newton_iterations"]
    assert abs(fast.counters["steps"] - slow.counters["steps"]) <= (0.1 * slow.counters["steps"] if scheme.rtol else 1)
    bars = {"q": 0.5 * scheme.rtol} if scheme.rtol else {"q": 1e-8, "v": 1e-7, "lam": 1e-6}
    for name, share in bars.items():
        wanted = getattr(slow.state, name)
        assert getattr(fast.state, name) == pytest.approx(wanted, rel=0, abs=share * np.abs(wanted).max()), name


@pytest.mark.compiled
@pytest.mark.parametrize("skew", [False, True])
def test_forces_that_python_gives_as_a_whole(
    rod_mesh: Callable[..., Any], skew: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Complex matrices take their slopes, with what these lack of symmetry: compiled steps, as those of Python."""
    scene = swing(rod_mesh(h=0.5, height=0.2), 2)
    slopes = np.array(((-50.0, 30.0 * skew), (-30.0 * skew, -50.0)))
    brake = lambda t, a: (a.v @ slopes.T, 0.0 * a.w)  # noqa: E731
    scene.add(fmbd.own_force("brake", scene.bodies["rod"].surface("tip"), None, brake))
    made: list[int] = []
    in_parts = RadauStepper._constant
    monkeypatch.setattr(RadauStepper, "_constant", lambda *given: (made.append(1), in_parts(*given))[1])

    def run() -> fmbd.Run:
        output = fmbd.Output(every=10**9, progress=False)
        scheme = fmbd.Radau(3, rtol=None)
        return fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=scheme, output=output, newton=fmbd.Newton(1e-10))

    fast = run()
    assert not made
    monkeypatch.setattr(ImplicitStepper, "_march_of", lambda _: None)
    slow = run()
    for name in ("q", "v", "lam"):
        wanted = getattr(slow.state, name)
        assert getattr(fast.state, name) == pytest.approx(wanted, rel=0, abs=1e-7 * np.abs(wanted).max()), name


@pytest.mark.compiled
def test_complex_directions_and_right_hand_sides_are_two_real_ones(rod_mesh: Callable[..., Any]) -> None:
    """In compiled code in one call, and with few calls of Python."""
    system, start, _ = pendulum(rod_mesh(h=0.5)).build()
    use_driver(system)
    rng = np.random.default_rng(3)
    solver = StepSolver(system)
    equations = FieldEquations(system, fmbd.GGL(), solver)
    tangent = equations.refresh(start, np.zeros(equations.n_mult))
    solver.prepare(tangent.ev, Weights(1.0, 1e-3, 1e-6))
    assert solver.driver is not None and solver.driver.ready

    real, imaginary = rng.normal(size=(2, 3, system.n_v))
    parts = tangent.along(*real) + 1j * tangent.along(*imaginary)
    assert np.abs(parts.imag).max() > 0
    assert tangent.along(*(real + 1j * imaginary)) == pytest.approx(parts, rel=1e-12, abs=1e-12)
    assert calls_of(lambda: tangent.along(*(real + 1j * imaginary))) <= 35

    c = rng.normal(size=(2, system.n_lam))
    each = [solver.solve(b[0], c[i]) for i, b in enumerate((real, imaginary))]
    both = solver.solve(real[0] + 1j * imaginary[0], c[0] + 1j * c[1])
    for found, (x, y) in zip(both, zip(*each, strict=True), strict=True):
        assert np.array_equal(found, x + 1j * y)


SOFT = [
    (fmbd.Radau(2, rtol=None), 0.02),
    (fmbd.Radau(3, rtol=None), 0.05),
    (fmbd.BDF(2, rtol=None), 0.02),
]


@pytest.mark.parametrize(("scheme", "dt"), SOFT, ids=lambda x: getattr(x, "name", str(x)))
def test_soft_bodies_take_large_steps_whole(rod_mesh: Callable[..., Any], scheme: Any, dt: float) -> None:
    """A rubber rod falls and bends by more than its height: new tangents where a step before took many increments, and those of
    each stage where one for all is not enough.
    """
    run = fmbd.solve(pendulum(rod_mesh(h=0.2), "absolute", E=3e5), t_end=0.5, dt=dt, scheme=scheme)
    fine = fmbd.solve(pendulum(rod_mesh(h=0.2), "absolute", E=3e5), t_end=0.5, dt=2e-3, scheme=scheme)
    assert run.counters["halved_steps"] == fine.counters["halved_steps"] == 0
    np.testing.assert_allclose(run["tip"][-1], fine["tip"][-1], atol=3e-2)


def test_new_tangents_only_where_they_save_increments(rod_mesh: Callable[..., Any]) -> None:
    """Of a stiff rod that turns a new tangent is hardly better than the first."""
    scene = pendulum(rod_mesh(h=0.2), "absolute", E=1e9)
    run = fmbd.solve(scene, t_end=0.5, dt=5e-3, scheme=fmbd.Radau(2, rtol=None))
    assert run.counters["newton_iterations"] > 4 * run.counters["steps"]
    assert run.counters["factorisations"] <= 6

    # increments that factors of another frequency leave ask for none
    run = fmbd.solve(pendulum(rod_mesh(h=0.5), "absolute", E=1e9), t_end=0.5, scheme=fmbd.BDF(rtol=1e-5))
    assert run.counters["factorisations"] <= 12


def test_increments_of_stages_with_a_tangent_each(rod_mesh: Callable[..., Any]) -> None:
    """They leave a hundredth of the residual of stages that are far apart, where one tangent for all leaves a tenth."""
    system, start, _ = pendulum(rod_mesh(h=0.5), "absolute", E=3e5).build()
    stepper = fmbd.Radau(2, rtol=None).stepper(system, StepSolver(system), fmbd.Newton(), start)
    h, rng = 0.01, np.random.default_rng(3)
    stepper.eq.begin(start)
    xi, v, mult = stepper._start.predict(system, stepper.tab, h)
    bent = 1e-2 * np.sin(3.0 * np.arange(2)[:, None]) * rng.normal(size=system.n_v)
    points = stepper.iteration._stages(h, start, xi + bent, v + bent / h, mult)
    each, times = stepper.iteration._own_pencil(h, start, points), start.t + h * stepper.tab.c

    left = []
    for solver in (each, None):
        kin, low = each.residual = stepper.eq.residual(times, points)
        first = each._by_one(kin, low)
        dxi, dv, dmult = each._parted(first)
        if solver is not None:
            change, dmult = each.solve(kin, low)
            dxi, dv = np.split(change, 2, axis=1)
        after = each._by_one(
            *stepper.eq.residual(times, each._moved(1e-3 * np.concatenate([x.ravel() for x in (dxi, dv, dmult)])))
        )
        linear = (after - first) / 1e-3 + first
        left.append(np.abs(linear[: dxi.size]).max() / np.abs(first[: dxi.size]).max())
    assert left[0] < 0.02 < 0.1 < left[1], left
