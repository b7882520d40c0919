"""Reduced bodies whose joints their modes hardly give way to are told; those that bend as they should are not."""

from collections.abc import Callable
from typing import Any

import pytest

import fmbd_fenicsx as fmbd

WORDS = 'body "rod" is stiffer between its joints by its'


def held(rod_mesh: Callable[..., Any], basis: dict[str, Any], *, clamp: bool, attached: bool = False) -> fmbd.Scene:
    """A strip in a clamp or on a hinge."""
    frame = fmbd.Attached("pin") if attached else fmbd.MeanAxis()
    law = fmbd.materials.linear_elastic(5e6, 0.3)
    rod = fmbd.FloatingBody("rod", rod_mesh(), density=1e3, elastic=law, frame=frame).reduced(**basis)
    joint = fmbd.fixed if clamp else fmbd.revolute
    scene = fmbd.Scene("strip")
    scene.add(rod, joint("joint", fmbd.ground, rod.surface("pin")))
    return scene


@pytest.mark.parametrize("modes", [3, 6, 20])
def test_free_modes_in_a_clamp(rod_mesh: Callable[..., Any], modes: int, caplog: pytest.LogCaptureFixture) -> None:
    """28, 22 and 7 % of the first frequency are told, by a run, a check and modes."""
    scene = held(rod_mesh, {"modes": modes}, clamp=True)
    assert any(WORDS in note for note in scene.check().notes)
    assert any(WORDS in line for line in fmbd.solve(scene, t_end=1e-3, dt=1e-3).warnings)

    caplog.clear()
    found = fmbd.modes(scene, 1).frequencies[0]
    assert found > 1.05 * 1.18839432
    assert WORDS in caplog.text


@pytest.mark.parametrize("ask", [fmbd.equilibrium, fmbd.linearise], ids=["equilibrium", "linear model"])
def test_all_who_ask_for_their_stiffness_are_told(
    rod_mesh: Callable[..., Any], ask: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    ask(held(rod_mesh, {"modes": 3}, clamp=True))
    assert WORDS in caplog.text


@pytest.mark.parametrize(
    ("basis", "clamp", "attached"),
    [
        ({"basis": fmbd.CraigBampton(("pin",), 4)}, True, False),
        ({"modes": 6}, True, True),
        ({"modes": 6}, False, False),
        ({"modes": 0}, True, False),
    ],
    ids=["static modes", "clamped modes", "hinge", "rigid"],
)
def test_modes_that_fit_their_joints(
    rod_mesh: Callable[..., Any], basis: dict[str, Any], clamp: bool, attached: bool
) -> None:
    scene = held(rod_mesh, basis, clamp=clamp, attached=attached)
    assert not scene.check().notes
    assert not any(WORDS in line for line in fmbd.solve(scene, t_end=1e-3, dt=1e-3).warnings)


def beam(modes: int | None, at: str) -> fmbd.Scene:
    """A beam whose modes are those of a clamp at its start, in a clamp."""
    section = fmbd.Section(EA=2e7, EI=1e9 * 0.02**3 / 12, rhoA=20.0)
    rod = fmbd.Beam("rod", (0, 0), (1, 0), section, modes=modes)
    scene = fmbd.Scene("beam")
    scene.add(rod, fmbd.fixed("joint", fmbd.ground, rod.surface(at)))
    return scene


def test_beams_too(caplog: pytest.LogCaptureFixture) -> None:
    """Four modes of a cantilever held at its other end: 25 % of the first frequency."""
    found = fmbd.modes(beam(4, "end"), 1).frequencies[0]
    assert found > 1.2 * 3.2307 and WORDS in caplog.text and "modes=None" in caplog.text
    for modes, at in ((None, "end"), (4, "start")):
        scene = beam(modes, at)
        assert not scene.check().notes
        assert fmbd.modes(scene, 1).frequencies[0] == pytest.approx(3.2307, rel=1e-3)
