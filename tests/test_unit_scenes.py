"""The same scene in twelve systems of units: the same steps, the same digits, for every kind of body, element and scheme.

The default run takes two of the systems, as far from metres, kilograms and seconds as any, and a scheme for each scene.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pytest
import unit_laws as laws
import unit_scenes as scenes
from unit_scenes import Drawn, Units

import fmbd_fenicsx as fmbd

TWELVE = tuple(product((1.0, 1e3, 1e-3), (1.0, 1e6), (1.0, 1e-3)))  # of a metre, a kilogram, a second
TWO = ((1e3, 1e6, 1e-3), (1e-3, 1.0, 1e-3))
ATOMS = ((1e-10, 1e-26, 1e-13),)
STEPS = 8

DIGITS = 1e-10
# accelerations: the roundoff of positions over h^2; a neo-Hookean strip in 28 systems drawn at random: 0.4e-9 to 2.7e-9
OF_FORCES = 4e-9
OF_FORCES_IN_SMALL_STEPS = 1e-6  # the same, where steps are chosen some hundred times smaller
# Radau and BDF end Newton's iteration at 0.03 of rtol, and what it leaves depends on the roundoff of a tangent by differences
RTOL = 1e-4
LEFT, LEFT_OF_FORCES = 0.03 * RTOL, 0.3 * RTOL

Build = Callable[[Units], Drawn]
ALPHA = fmbd.GeneralizedAlpha
IMPLICIT: dict[str, Any] = {
    "alpha": ALPHA(0.8),
    "alpha in NumPy": ALPHA(0.8, compiled=False),
    "alpha, GGL": ALPHA(0.9, form=fmbd.GGL()),
    "alpha, its own steps": ALPHA(0.8, rtol=RTOL),
    "Radau": fmbd.Radau(3, rtol=RTOL),
    "BDF": fmbd.BDF(rtol=RTOL),
}
EXPLICIT: dict[str, Any] = {"RATTLE": fmbd.Rattle(), "half-explicit": fmbd.HalfExplicit(1e-5)}
MEAN: dict[str, Any] = {"energy-momentum": fmbd.EnergyMomentum()}
RIGID = IMPLICIT | EXPLICIT | MEAN
ON_VELOCITIES = {"Radau": fmbd.Radau(2, fmbd.Index2(), RTOL), "BDF": fmbd.BDF(5, fmbd.Index2(), RTOL)}
PUSHING: dict[str, Any] = {"midpoint": fmbd.ContactMidpoint(), "contact alpha": fmbd.ContactAlpha(0.8)}
IMPACTS: dict[str, Any] = {"Moreau": fmbd.Moreau()}
SLIDING: dict[str, Any] = {
    "unilateral": fmbd.Unilateral(ALPHA(0.6)),
    "unilateral, GGL": fmbd.Unilateral(ALPHA(0.6, form=fmbd.GGL())),
}
ITERATED = fmbd.solvers.FieldSplit()


def only(schemes: dict[str, Any], *names: str) -> dict[str, Any]:
    """Some of the schemes."""
    return {name: schemes[name] for name in names}


def reduced(body: Any) -> Any:
    """By three modes."""
    return body.reduced(modes=3)


# scene, schemes, those of the default run, step (s)
SCENES: dict[str, tuple[Build, dict[str, Any], tuple[str, ...], float]] = {
    "controlled": (scenes.controlled, RIGID, ("alpha", "alpha, its own steps", "RATTLE"), 5e-3),
    "sampled": (scenes.sampled, RIGID, ("alpha in NumPy", "BDF"), 5e-3),
    "carriage": (scenes.carriage, RIGID, ("alpha", "half-explicit"), 5e-3),
    "driven": (scenes.driven, RIGID, ("alpha", "Radau", "energy-momentum"), 5e-3),
    "own coordinates": (scenes.own_coordinates, RIGID, ("alpha, GGL",), 5e-3),
    "atoms": (laws.atoms, RIGID, ("alpha", "alpha, its own steps", "energy-momentum"), 5e-3),
    "own law": (laws.own_law, RIGID, ("alpha", "alpha in NumPy", "energy-momentum"), 5e-3),
    "rolling": (
        scenes.rolling,
        IMPLICIT | only(EXPLICIT, "half-explicit") | MEAN | ON_VELOCITIES,
        ("alpha", "half-explicit"),
        5e-3,
    ),
    "rod": (scenes.rod, IMPLICIT | MEAN, ("alpha", "alpha, its own steps"), 2e-3),
    "rod, viscoelastic": (partial(scenes.rod, arms=True), IMPLICIT | MEAN, ("alpha, GGL",), 2e-3),
    "rod, damped": (partial(scenes.rod, damping=1e-3), IMPLICIT | MEAN, ("energy-momentum", "BDF"), 2e-3),
    "rod, in explicit steps": (scenes.rod, EXPLICIT, ("RATTLE",), 1e-4),
    "beam": (scenes.beam, IMPLICIT, ("alpha", "alpha, its own steps", "Radau"), 5e-3),
    "beam in space": (partial(scenes.beam, dim=3), IMPLICIT, ("alpha in NumPy",), 5e-3),
    "beam, by modes": (partial(scenes.beam, modes=2), RIGID, ("RATTLE", "half-explicit"), 5e-3),
    "beam, stiffening": (partial(scenes.beam, stiffening=True), IMPLICIT, ("alpha",), 5e-3),
    "line": (scenes.line, IMPLICIT | MEAN, ("alpha",), 5e-3),
    "wires": (scenes.wires, SLIDING, ("unilateral",), 1e-3),
    **{
        f"strip, {kind}": (partial(scenes.strip, kind=kind), IMPLICIT, some, 5e-3)
        for kind, some in (
            ("floating", ("alpha",)),
            ("large, floating", ()),
            ("pressure", ("alpha",)),
            ("rubber", ("alpha",)),
        )
    },
    "strip, absolute": (partial(scenes.strip, kind="absolute"), IMPLICIT | MEAN, ("alpha, GGL", "energy-momentum"), 5e-3),
    "strip, large": (partial(scenes.strip, kind="large"), IMPLICIT | MEAN, ("alpha",), 5e-3),
    "strip, neo-Hookean": (partial(scenes.strip, kind="neo-Hookean"), IMPLICIT | MEAN, ("energy-momentum",), 5e-3),
    "strip, incompressible": (
        partial(scenes.strip, kind="incompressible"),
        only(IMPLICIT, "alpha", "alpha in NumPy", "alpha, its own steps"),
        ("alpha",),
        5e-3,
    ),
    "strip, by modes": (partial(scenes.strip, kind="floating", moved=reduced), RIGID, ("alpha", "BDF"), 2.5e-3),
    "strip, stiffening": (partial(scenes.strip, kind="floating", stiffening="left"), only(IMPLICIT, "alpha"), (), 5e-3),
    "strip, iterated": (partial(scenes.strip, kind="floating", linear=ITERATED), only(IMPLICIT, "alpha"), ("alpha",), 5e-3),
    "viscous": (scenes.viscous, IMPLICIT, ("alpha",), 5e-3),
    "loaded": (scenes.loaded, IMPLICIT, ("alpha",), 5e-3),
    "tied": (scenes.tied, IMPLICIT, ("alpha",), 5e-3),
    "bouncing": (scenes.bouncing, IMPACTS, ("Moreau",), 3e-2),
    "thrown": (scenes.thrown, IMPACTS, ("Moreau",), 1e-2),
    "limited": (scenes.limited, IMPACTS, ("Moreau",), 2e-2),
    "landing": (scenes.landing, PUSHING, ("midpoint", "contact alpha"), 1e-2),
    "landing, rough": (partial(scenes.landing, friction=0.3), PUSHING, ("midpoint", "contact alpha"), 1e-2),
    "landing, floating": (partial(scenes.landing, friction=0.2, kind=fmbd.FloatingBody), PUSHING, ("contact alpha",), 1e-2),
    "pressed": (scenes.pressed, PUSHING, ("midpoint", "contact alpha"), 1e-2),
}  # fmt: skip

CASES = [
    pytest.param(name, scheme, id=f"{name}: {scheme}", marks=() if scheme in few else (pytest.mark.slow,))
    for name, (_, schemes, few, _) in SCENES.items()
    for scheme in schemes
]


def values(made: Drawn, u: Units, scheme: Any, dt: float) -> tuple[int, dict[str, Any]]:
    """Steps, and the values of the sensors in metres, kilograms, seconds."""
    chosen = getattr(scheme, "rtol", None) is not None
    run = fmbd.solve(
        made.scene,
        t_end=u.of(STEPS * dt, 0, 0, 1),
        dt=None if chosen else u.of(dt, 0, 0, 1),
        scheme=scheme,
        linear=made.linear,
    )
    return run.counters["steps"], {name: run[name] / u.of(1.0, *powers) for name, powers in made.powers.items()}


def allowed(scheme: Any, powers: tuple[int, int, int]) -> float:
    """Share of a sensor's largest value by which it may differ."""
    force = powers[1] == 1
    if isinstance(scheme, fmbd.Radau | fmbd.BDF) and scheme.rtol is not None:
        return LEFT_OF_FORCES if force else LEFT
    if isinstance(scheme, ALPHA) and scheme.rtol is not None:
        return OF_FORCES_IN_SMALL_STEPS if force else DIGITS
    return OF_FORCES if force else DIGITS


def agree(name: str, scheme: str, systems: Any) -> None:
    """All systems against metres, kilograms and seconds."""
    build, schemes, _, dt = SCENES[name]
    first = Units(1, 1, 1)
    steps, expected = values(build(first), first, schemes[scheme], dt)
    for sizes in systems:
        u = Units(*sizes)
        made = build(u)
        taken, found = values(made, u, schemes[scheme], dt)
        assert taken == steps, sizes
        for sensor, x in expected.items():
            least = 1.0 if made.powers[sensor] == scenes.LENGTH else 0.0  # places are known to the roundoff of a metre
            off = np.abs(found[sensor] - x).max() / max(np.abs(x).max(), least)
            assert off <= allowed(schemes[scheme], made.powers[sensor]), (sizes, sensor, off)


@pytest.mark.parametrize("name, scheme", CASES)
def test_far_units(name: str, scheme: str) -> None:
    agree(name, scheme, TWO)


@pytest.mark.parametrize("name, scheme", [c for c in CASES if c.values[0] in ("atoms", "own law")])
def test_the_size_of_atoms(name: str, scheme: str) -> None:
    """Guards and steps of differences measure with the model, not with a metre."""
    agree(name, scheme, ATOMS)


@pytest.mark.slow
@pytest.mark.timeout(0)
@pytest.mark.parametrize("name, scheme", [pytest.param(*c.values, id=c.id) for c in CASES])
def test_twelve_systems(name: str, scheme: str) -> None:
    agree(name, scheme, TWELVE[1:])


@pytest.mark.parametrize("build", [scenes.controlled, scenes.carriage, partial(scenes.strip, kind="floating")])
def test_modes_about_an_equilibrium(build: Build) -> None:
    """Differences of velocities measure with a time of the scene, gaps of a given state with its length, readings of
    controllers with both.
    """
    found = []
    for sizes in ((1.0, 1.0, 1.0), (1e6, 1e15, 1e6)):
        u = Units(*sizes)
        scene = build(u).scene
        found.append(fmbd.modes(scene, 3, at=fmbd.equilibrium(scene)).eigenvalues * u.of(1.0, *scenes.TIME))
    assert np.abs(found[1] - found[0]).max() <= 1e-7 * np.abs(found[0]).max()


@pytest.mark.parametrize("build, sensor", [(scenes.carriage, "wheel"), (scenes.driven, "nut")])
def test_a_run_with_a_tolerance(build: Build, sensor: str) -> None:
    """``tol`` finds the same numbers of steps, whichever unit it is given in."""
    found = []
    for sizes in ((1.0, 1.0, 1.0), *TWO):
        u = Units(*sizes)
        run = fmbd.solve(build(u).scene, t_end=u.of(0.1, 0, 0, 1), tol={sensor: u.metres(1e-4)})
        found.append((run.counters["steps"], run[sensor][-1] / u.metres(1.0)))
    for steps, place in found[1:]:
        assert steps == found[0][0]
        assert np.abs(place - found[0][1]).max() <= DIGITS * np.abs(place).max()


STATICS: dict[str, Build] = {
    "rod": scenes.rod,
    "large": partial(scenes.strip, kind="large"),
    "floating": partial(scenes.strip, kind="floating"),
}


@pytest.mark.parametrize("name", STATICS)
def test_equilibria(name: str) -> None:
    """Places to the end of Newton's iteration of statics, in the same number of iterations."""
    found = []
    for sizes in ((1.0, 1.0, 1.0), *TWO):
        u = Units(*sizes)
        made = STATICS[name](u)
        rest = fmbd.equilibrium(made.scene)
        found.append((rest.counters, {s: rest[s] / u.of(1.0, *p) for s, p in made.powers.items()}))
    for counters, there in found[1:]:
        assert counters == found[0][0]
        for sensor, x in found[0][1].items():
            assert np.abs(there[sensor] - x).max() <= 1e-8 * np.abs(x).max(), sensor


@pytest.mark.parametrize("scheme", [fmbd.Radau(3, rtol=1e-4), fmbd.GeneralizedAlpha(rtol=1e-4)], ids=lambda s: s.name)
def test_an_orbit_about_the_origin_of_the_ground(scheme: Any) -> None:
    """No place but that of one body and the origin: its distance is the length of the model, where 1 m was taken, and 2 740
    steps of an orbit of megametres in place of 60.
    """

    def run(length: float, time: float) -> tuple[float, np.ndarray]:
        scene, pull = fmbd.Scene("orbit"), length**3 / time**2
        moon = fmbd.PointMass("moon", 1.0, (length, 0.0), velocity=(0.0, 0.78 * length / time))
        scene.add(moon, fmbd.Spring("weight", fmbd.ground, moon, law=lambda x, v, t: pull / x**2))
        scene.sensor("place", fmbd.position(moon))
        made = fmbd.solve(scene, t_end=5 * time, scheme=scheme, output=fmbd.Output(energy=False, progress=False))
        return made.counters["steps"], made["place"][-1] / length

    (steps, place), (far_steps, far_place) = run(1.0, 1.0), run(8e6, 1134.0)
    assert steps == far_steps
    np.testing.assert_allclose(far_place, place, atol=1e-9)
