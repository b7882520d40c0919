"""Explicit schemes know the largest step that they can take."""

from __future__ import annotations

from functools import partial
from typing import Any

import checkpoint_scenes
import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import StabilityError
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.materials import linear_elastic
from fmbd_fenicsx.schemes.consistent import consistent
from fmbd_fenicsx.schemes.onestep import explicit_runge_kutta, half_explicit, rattle
from fmbd_fenicsx.schemes.onestep.explicit_limit import FastestVibration, fastest_vibration, largest_step
from fmbd_fenicsx.schemes.onestep.explicit_stepper import amplified

QUIET = fmbd.Output(progress=False)
SCHEMES = [fmbd.Rattle(), fmbd.HalfExplicit(rtol=None), fmbd.ExplicitRungeKutta(rtol=None)]
MATRICES = [
    rattle.amplification,
    *(partial(amplified, method.coefficients()[1]) for method in (half_explicit, explicit_runge_kutta)),
]


def sprung(**spring: Any) -> fmbd.Scene:
    """2 kg on a spring along x, beside a free body: 14.14 rad/s."""
    mass = fmbd.RigidBody("mass", 2.0, 1.0, velocity=(0.1, 0.0))
    other = fmbd.RigidBody("other", 1.0, 1.0, position=(3.0, 1.0))
    scene = fmbd.Scene("sprung")
    spring = spring if "law" in spring else {"stiffness": 400.0, **spring}
    slide = fmbd.prismatic("slide", fmbd.ground, mass, axis=(1, 0))
    scene.add(mass, other, slide, fmbd.joint_spring("spring", fmbd.displacement(slide), **spring))
    return scene


def clamped(joint: str) -> fmbd.Scene:
    section = fmbd.Section(EA=2.1e7, EI=175.0, rhoA=0.78)
    beam = fmbd.Beam("beam", (0.0, 0.0), (1.0, 0.0), section, elements=4)
    scene = fmbd.Scene("beam", gravity=(0, -9.81))
    start = beam.surface("start")
    held = (
        fmbd.fixed("held", fmbd.ground, start)
        if joint == "clamp"
        else fmbd.revolute("held", fmbd.ground, start, center=(0.0, 0.0))
    )
    scene.add(beam, held)
    return scene


def vibration(scene: fmbd.Scene) -> FastestVibration:
    system, given, _ = scene.build()
    solver = StepSolver(system)
    found = fastest_vibration(system, consistent(system, given, solver)[0], solver)
    solver.destroy()
    assert found is not None
    return found


def on_a_stiff_mount(body: Any, surface: Any) -> fmbd.Scene:
    scene = fmbd.Scene("mount", gravity=(0, -9.81))
    scene.add(body, fmbd.bushing("mount", fmbd.ground, surface, stiffness=(1e10, 1e10, 1e8)))
    return scene


@pytest.mark.parametrize(
    "scheme", [fmbd.HalfExplicit(rtol=1e-3), fmbd.ExplicitRungeKutta(rtol=1e-3)], ids=lambda x: x.name
)
def test_own_steps_let_no_vibration_grow(scheme: Any) -> None:
    """An elastic rod that begins to sag on a mount of 1e10 N/m: to a tolerance of a millimetre its energy was 200 J off."""
    rod = fmbd.FloatingBody("rod", checkpoint_scenes.rod(), density=1000.0, elastic=linear_elastic(1e6, 0.3))
    run = fmbd.solve(on_a_stiff_mount(rod, rod.surface("pin")), t_end=1e-3, scheme=scheme)
    assert np.abs(run.total_energy - run.total_energy[0]).max() < 1e-6
    assert not run.warnings


def test_many_own_steps_held_by_a_vibration_are_told() -> None:
    """With its body, its frequency and the size of the steps; of few steps nothing is said."""
    body = fmbd.RigidBody("block", 2.0, 0.1)
    settings: Any = {"scheme": fmbd.HalfExplicit(rtol=1e-3), "output": fmbd.Output(every=1000)}
    long, short = (fmbd.solve(on_a_stiff_mount(body, body), t_end=t, **settings) for t in (0.3, 0.01))
    (line,) = long.warnings
    assert 'fastest vibration, of body "block" (7.07e+04 rad/s)' in line and "take 7e+03 of them" in line
    assert not short.warnings
    # the limit is looked at anew on the way, and the end stays where it is
    assert (long.times[-1], short.times[-1]) == (0.3, 0.01)


def test_a_mass_on_a_spring_and_a_damper() -> None:
    found = vibration(sprung())
    assert found.omega == pytest.approx(np.sqrt(200.0), rel=1e-6) and found.damping == pytest.approx(0.0, abs=1e-9)
    assert found.body == "mass"
    assert vibration(sprung(damping=3.0)).damping == pytest.approx(1.5, rel=1e-6)


def test_limits_of_the_schemes() -> None:
    """2 / omega for RATTLE; the matrices of steps are those of the schemes, by a step of a mass on a spring."""
    free = FastestVibration(10.0, 0.0, "")
    assert largest_step(free, MATRICES[0]) == pytest.approx(0.2, rel=1e-3)
    assert 0.28 < largest_step(free, MATRICES[1]) < 0.34
    for scheme, matrix in zip(SCHEMES, MATRICES, strict=True):
        h, scene = 0.05, sprung(damping=3.0)
        scene.sensor("x", fmbd.displacement(scene.joints["slide"]))
        run = fmbd.solve(scene, t_end=h, dt=h, scheme=scheme, output=QUIET)
        x = matrix(h * np.sqrt(200.0), h * 1.5) @ (0.0, h * 0.1)
        assert run["x"][-1, 0] == pytest.approx(x[0], rel=1e-7)
        assert run.state.v[0] * h == pytest.approx(x[1], rel=1e-7)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_the_limit_is_where_motion_grows(scheme: Any) -> None:
    limit = largest_step(vibration(sprung()), MATRICES[SCHEMES.index(scheme)])
    unguarded = fmbd.Output(progress=False, energy=False)
    run = fmbd.solve(sprung(), t_end=100 * 0.97 * limit, dt=0.97 * limit, scheme=scheme, output=unguarded)
    assert abs(run.state.v[0]) < 0.11
    with pytest.raises(StabilityError, match='body "mass"') as failed:
        fmbd.solve(sprung(), t_end=1.05 * limit, dt=1.05 * limit, scheme=scheme, output=QUIET)
    assert f"above {limit:.3g} s" in str(failed.value)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
@pytest.mark.parametrize("joint", ["clamp", "pin"])
def test_a_beam_with_steps_that_resolve_bending_only(joint: str, scheme: Any) -> None:
    with pytest.raises(StabilityError, match='fastest vibration, of body "beam"'):
        fmbd.solve(clamped(joint), t_end=0.1, dt=1e-3, scheme=scheme, output=QUIET)


def test_a_rod() -> None:
    section = fmbd.RodSection((1e6, 1e6, 1e6, 100.0, 100.0, 100.0), 1.0, (0.2, 0.1, 0.1))
    rod = fmbd.Rod("rod", [(0, 0, 0), (2, 0, 0)], section, elements=2, degree=2)
    scene = fmbd.Scene("rod", gravity=(0, -20, 5))
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")))
    with pytest.raises(StabilityError, match="rod"):
        fmbd.solve(scene, t_end=0.1, dt=5e-3, scheme=fmbd.Rattle(), output=QUIET)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_a_spring_that_stiffens_on_the_way(scheme: Any) -> None:
    """No stiffness at the start, far too much of it a step later: the run ends with the step as the cause, not with a load."""
    scene = sprung(law=lambda s, rate, t: 1e13 * s**3)
    with pytest.raises(fmbd.errors.ConvergenceError, match="is explicit and cannot|diverged in the step"):
        fmbd.solve(scene, t_end=10.0, dt=0.02, scheme=scheme, output=QUIET)


def test_a_law_that_jumps_is_no_stiffness() -> None:
    scene = sprung(law=lambda s, rate, t: 0.1 if s > 0 else -0.1)
    run = fmbd.solve(scene, t_end=0.3, dt=0.02, scheme=fmbd.Rattle(), output=QUIET)
    assert run.status == "finished"
