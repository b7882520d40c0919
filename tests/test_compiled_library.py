"""The driver's library: all its units compile, and a system gets those that it needs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from test_declarations import said_of
from test_driver import bushings, links, tyre
from test_kernel import flexible

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.kernel_cache import load_library
from fmbd_fenicsx.mechanics.kinds.library import package_kernels
from fmbd_fenicsx.system.compiled.declarations import DRIVER
from fmbd_fenicsx.system.compiled.library import CONTACT, CORE, IMPLICIT, _source, driver_library, units_of
from fmbd_fenicsx.system.compiled.states import evaluation

pytestmark = pytest.mark.compiled

SOURCES = {path.relative_to(DRIVER): path.read_text() for path in sorted(DRIVER.rglob("*.c"))}
INCLUDED = {Path(name) for text in SOURCES.values() for name in re.findall(r'#include "(.*)"', text)}
UNITS = [path.with_suffix("").as_posix() for path in SOURCES if path not in INCLUDED]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("unit", UNITS)
def test_units_compile_without_a_warning(unit: str, dim: int) -> None:
    assert not said_of(_source(dim, unit), f"-DDIM={dim}", "-Wall", "-Wextra")


@pytest.mark.parametrize("dim", [2, 3])
def test_all_units_are_linked(dim: int) -> None:
    """A unit with an error, or two that share a name, would let everything run in NumPy."""
    assert set(CORE) < set(UNITS)
    assert driver_library(dim, tuple(name for name in UNITS if name not in CORE)) is not None
    assert load_library(package_kernels(dim)) is not None


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
