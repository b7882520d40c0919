"""A force element of a user's own by one formula: against the package's springs, energies, sensors, compiled steps, bad input."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import combinations as co
import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError

STIFFNESS, LENGTH = 400.0, 0.9


def stretched(a: Any, b: Any, t: Any) -> Any:
    """Potential of a spring."""
    d = b.x - a.x
    return 0.5 * STIFFNESS * (np.sqrt(d @ d) - LENGTH) ** 2


def apart(a: Any, b: Any, t: Any) -> Any:
    """Distance of two points."""
    d = b.x - a.x
    return np.sqrt(d @ d)


def spring(damping: float = 0.0) -> Callable[..., Any]:
    """The package's own."""
    values = {"stiffness": STIFFNESS, "damping": damping, "length": LENGTH}
    return lambda *between, points: fmbd.Spring("spring", *between, points[0], points[1], **values)


def swinging(dim: int, make: Callable[..., Any], scheme: Any) -> Any:
    """A turned body on a spring at a corner."""
    inertia, turned = (0.2, 0.4) if dim == 2 else ((0.1, 0.2, 0.25), (0.8, 0.0, 0.6, 0.0))
    bob = fmbd.RigidBody("bob", 1.3, inertia, (0.75, 0.9, 0.0)[:dim], rotation=turned, velocity=(0.4, -0.3, 0.2)[:dim])
    scene = fmbd.Scene("swinging", gravity=(0, -9.81, 0)[:dim])
    element = make(fmbd.ground, bob, points=((0.1, 0.2, 0.3)[:dim], (0.75, 1.0, 0.1)[:dim]))
    scene.add(bob, element)
    scene.sensor("place", fmbd.position(bob))
    scene.sensor("force", fmbd.element_force(element))
    scene.sensor("power", fmbd.element_power(element))
    output = fmbd.Output(times=tuple(np.linspace(0.0, 0.1, 21)))  # laws of the user's own may ask for other steps
    return fmbd.solve(scene, t_end=0.1, dt=5e-3, scheme=scheme, output=output)


def assert_alike(own: Any, known: Any) -> None:
    """Places, forces, powers and energies of two runs, and whether their steps are compiled."""
    own_share, known_share = (run.counters.get("compiled_steps", 0.0) / run.counters["steps"] for run in (own, known))
    assert own_share == known_share
    close = 1e-6 if own.counters["steps"] == known.counters["steps"] else 1e-5  # the tolerance of chosen steps
    for name in ("place", "force", "power"):
        assert np.abs(own[name] - known[name]).max() < close * np.abs(known[name]).max(), name
    assert np.abs(own.energy["springs"] - known.energy["springs"]).max() < close * known.energy["springs"].max()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("scheme", [name for name in co.SCHEMES if not name.startswith(co.CONTACT)])
def test_a_potential_is_a_spring(scheme: str, dim: int) -> None:
    made = co.SCHEMES[scheme]()
    own = swinging(dim, lambda a, b, points: fmbd.force_element("own", a, b, stretched, points=points), made)
    known = swinging(dim, spring(), made)
    if scheme == "energy-momentum":  # another discrete gradient: both keep the energy
        total = own.energy["kinetic"] + own.energy["springs"] + own.energy["weight"]
        assert np.ptp(total) < 1e-8 * np.ptp(own.energy["kinetic"])
        assert np.abs(own["place"] - known["place"]).max() < 1e-3
        return
    assert_alike(own, known)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("scheme", ["generalized-alpha", "Radau, index 2"])
def test_a_coordinate_with_a_law_is_a_damped_spring(scheme: str, dim: int) -> None:
    def make(a: Any, b: Any, points: Any) -> Any:
        law = lambda s, rate, t: STIFFNESS * (s - LENGTH) + 7.0 * rate  # noqa: E731
        return fmbd.force_element("own", a, b, apart, law=law, points=points)

    own, known = (swinging(dim, which, co.SCHEMES[scheme]()) for which in (make, spring(7.0)))
    assert own.counters.get("compiled_steps", 0.0) == known.counters.get("compiled_steps", 0.0)
    assert np.abs(own["place"] - known["place"]).max() < 1e-8
    assert np.abs(own["force"] - known["force"]).max() < 1e-5 * np.abs(known["force"]).max()


def test_laws_that_are_formulas_have_their_exact_slopes() -> None:
    body = fmbd.RigidBody("b", 1.0, 0.1, position=(1.0, 0.0))
    smooth = fmbd.force_element("f", fmbd.ground, body, apart, law=lambda s, rate, t: np.tanh(3 * s) * t + rate**2 * s)
    cases = fmbd.force_element("f", fmbd.ground, body, apart, law=lambda s, rate, t: max(s, 0.0) + rate)
    s, rate, t = 0.3, -0.7, 2.0
    exact = 3 * t / np.cosh(3 * s) ** 2 + rate**2, 2 * rate * s
    assert smooth.law(s, rate, t) == pytest.approx(np.tanh(3 * s) * t + rate**2 * s)
    assert smooth.law.slopes(s, rate, t) == pytest.approx(exact)  # type: ignore[union-attr]
    assert cases.law(-1.0, 2.0, 0.0) == 2.0


@pytest.mark.mpi
@pytest.mark.parametrize("body", ["reduced", "floating"])
def test_elastic_bodies_feel_a_potential(body: str) -> None:
    def tip(own: bool) -> np.ndarray:
        rod = co.BODIES[body]()
        scene = fmbd.Scene("rod", gravity=(0, -9.81))
        scene.add(rod.body)
        co.hinge(scene, rod)
        ends = (1, 0.5), (1, 0)
        formula = lambda a, b, t: 0.5e4 * (np.sqrt((b.x - a.x) @ (b.x - a.x)) - 0.3) ** 2  # noqa: E731
        known = fmbd.Spring("spring", fmbd.ground, rod.tip, *ends, stiffness=1e4, length=0.3)
        scene.add(fmbd.force_element("own", fmbd.ground, rod.tip, formula, points=ends) if own else known)
        scene.sensor("tip", fmbd.position(rod.tip))
        return np.asarray(fmbd.solve(scene, t_end=0.02, dt=1e-3)["tip"])

    assert np.abs(tip(True) - tip(False)).max() < 1e-8 * np.abs(np.ptp(tip(False), axis=0)).max() + 1e-12


BAD: dict[str, tuple[Any, str]] = {
    "two formulas": (lambda a, b, t: b.x, "2 formulas, expected one"),
    "time": (lambda a, b, t: b.x[0] * t, "holds the time"),
    "velocities": (lambda a, b, t: b.v[0], "holds velocities"),
    "a number": (lambda a, b, t: 3.0, "does not depend on the markers"),
    "a kink": (lambda a, b, t: abs(b.x[0]), "no derivative at 0"),
    "no derivative": (lambda a, b, t: np.sqrt(b.x @ b.x), "no finite derivative at the start"),
}


@pytest.mark.parametrize("name", list(BAD))
def test_bad_formulas_are_refused_where_they_are_given(name: str) -> None:
    function, message = BAD[name]
    body = fmbd.RigidBody("b", 1.0, 0.1, position=(0.0, 0.0))
    with pytest.raises(InputError, match=message) as caught:
        fmbd.force_element("mine", fmbd.ground, body, function)
    assert 'Force element "mine"' in str(caught.value)
    with pytest.raises(InputError, match="law"):
        fmbd.force_element("mine", fmbd.ground, body, lambda a, b, t: b.x[0], law=3.0)  # type: ignore[arg-type]
