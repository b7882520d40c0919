"""The driver's library: all its units compile, and a system gets those that it needs."""

from __future__ import annotations

from typing import Any

import pytest
from test_driver import bushings, links, tyre
from test_kernel import flexible

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import kernel_cache
from fmbd_fenicsx.system.compiled.library import CONTACT, IMPLICIT, RODS, driver_library, units_of
from fmbd_fenicsx.system.compiled.states import evaluation

pytestmark = pytest.mark.skipif(kernel_cache.compiler() is None, reason="no C compiler")


@pytest.mark.parametrize("dim", [2, 3])
def test_all_units_compile(dim: int) -> None:
    """A unit with an error would let everything run in NumPy."""
    rods = (RODS,) if dim == 3 else ()
    units = (
        "bodies/reduced",
        "bodies/told",
        "fields/fields",
        *rods,
        "forces/mounts",
        "forces/whole",
        CONTACT,
        IMPLICIT,
    )
    assert driver_library(dim) is not None
    assert driver_library(dim, units) is not None


def test_a_scene_gets_the_units_that_it_needs() -> None:
    def units(scene: fmbd.Scene) -> tuple[str, ...]:
        return units_of(scene.build()[0])

    assert units(links(2, 3)) == ()
    assert units(bushings(3)) == ("forces/mounts",)
    assert units(flexible(3)) == ("bodies/reduced",)
    assert units(tyre(3)) == ("forces/whole",)


def test_stages_of_implicit_schemes_are_compiled_for_these_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """They take a third of the first compile."""
    asked = set()
    monkeypatch.setattr(evaluation, "driver_library", lambda dim, units: asked.add(units) or driver_library(dim, units))
    for scheme in (fmbd.GeneralizedAlpha(), fmbd.Rattle(), fmbd.EnergyMomentum()):
        fmbd.solve(links(2, 2), t_end=0.01, dt=0.005, scheme=scheme)
    assert not asked
    assert not hasattr(driver_library(2), "driver_stage_tangent")
    for implicit in (fmbd.Radau(), fmbd.BDF()):
        fmbd.solve(links(2, 2), t_end=0.01, dt=0.005, scheme=implicit)
    assert asked == {(IMPLICIT,)}


SCHEMES = (fmbd.GeneralizedAlpha(), fmbd.Moreau(), fmbd.Radau(), fmbd.ExplicitRungeKutta(), fmbd.HalfExplicit())


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda x: type(x).__name__)
def test_every_argument_has_a_type(scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without one ctypes hands over half of an address; it says nothing where there are more arguments than types."""
    body = fmbd.RigidBody("body", 1.0, 0.1, position=(0, 1), velocity=(1, 0))
    scene = fmbd.Scene("falling", gravity=(0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body, center=(0, 0)))
    units: tuple[str, ...] = ()
    if isinstance(scheme, fmbd.Moreau):
        floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1)))
        scene.add(fmbd.contact("floor", fmbd.corners(body, [(0, 0)]), floor))
        units = (CONTACT,)
    scene.sensor("place", fmbd.position(body))

    if isinstance(scheme, fmbd.Radau):
        units = (IMPLICIT,)

    called = set()
    for library in {driver_library(2), driver_library(2, units)}:
        for name, function in list(vars(library).items()):
            if not hasattr(function, "argtypes"):
                continue

            def checked(*arguments: Any, function: Any = function, name: str = name) -> Any:
                called.add(name)
                assert len(arguments) == len(function.argtypes), name
                return function(*arguments)

            monkeypatch.setattr(library, name, checked)

    fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=scheme)
    assert called
