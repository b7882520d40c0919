"""Modes of linear bodies under forces along them: what their forms leave out is told, by its size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.system import axial_forces
from fmbd_fenicsx.system.axial_forces import left_out

HEIGHT, MODULUS, ANGLE = 0.02, 1e9, 0.4
BENDING = MODULUS * HEIGHT**3 / 12
ALONG = np.array([np.cos(ANGLE), np.sin(ANGLE)])
START = np.array([0.3, 0.2])
SUPPORTS = {
    "clamped": np.pi**2 / 4 * BENDING,
    "pinned": np.pi**2 * BENDING,
    "both clamped": 4 * np.pi**2 * BENDING,
}  # Euler, N


def strip(kind: str, *, attached: bool, stiffening: bool = False, loads: Any = ()) -> tuple[Any, str, str]:
    """A strip of one metre, aslant, with the names of its ends."""
    if kind == "beam":
        section = fmbd.Section(EA=MODULUS * HEIGHT, EI=BENDING, rhoA=1e3 * HEIGHT)
        ends = START, START + ALONG
        return fmbd.Beam("strip", *ends, section, attached=attached, stiffening=stiffening), "start", "end"
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, HEIGHT), counts=(16, 1), origin=(0.0, -HEIGHT / 2))
    body = fmbd.FloatingBody(
        "strip",
        mesh.placed(START, ANGLE),
        density=1e3,
        elastic=fmbd.materials.plane_stress(MODULUS, 0.0),
        frame=fmbd.Attached("left") if attached else fmbd.MeanAxis(),
        stiffening="left" if stiffening else False,
        loads=loads,
    )
    if kind == "reduced":
        return body.reduced(basis=fmbd.CraigBampton(("left", "right"), 4)), "left", "right"
    return body, "left", "right"


def column(body: Any, start: str, end: str, support: str, push: float) -> fmbd.Scene:
    """The strip between supports, its far end free to slide along it and pushed by a force (N)."""
    scene = fmbd.Scene("column")
    scene.add(body)
    near, far = body.surface(start), body.surface(end)
    if support == "pinned":
        slide = fmbd.point_on_line("slide", fmbd.ground, far, center=START + ALONG, axis=ALONG)
        scene.add(fmbd.revolute("root", fmbd.ground, near, center=START), slide)
    else:
        scene.add(fmbd.fixed("root", fmbd.ground, near))
    if support == "both clamped":
        scene.add(fmbd.prismatic("slide", fmbd.ground, far, axis=ALONG))
    if push:
        scene.add(fmbd.force("push", far, tuple(-push * ALONG)))
    return scene


def first(scene: fmbd.Scene) -> fmbd.Modes:
    return fmbd.modes(scene, 1, at=fmbd.equilibrium(scene))


@pytest.mark.parametrize(
    ("kind", "support"), [("beam", support) for support in SUPPORTS] + [("reduced", "pinned"), ("field", "clamped")]
)
@pytest.mark.parametrize("attached", [False, True])
def test_what_is_left_out_is_told_by_its_size(kind: str, attached: bool, support: str, caplog: Any) -> None:
    """A fifth of Euler's load takes a fifth of the stiffness: the force to roundoff, what is missing within a factor of 2.5."""
    push = 0.2 * SUPPORTS[support]
    body = strip(kind, attached=attached)
    alone = first(column(*body, support, 0.0))
    assert not caplog.text

    found = first(column(*body, support, push))
    missing = (found.frequencies[0] / alone.frequencies[0]) ** 2 - 0.8
    here = found.system.at(found.about.t, found.about.q, found.about.v)
    [(name, force, share, _)] = left_out(here, found.about.lam, [(found.frequencies[0], found.shapes[0])])
    assert name == "strip" and force == pytest.approx(-push, rel=1e-9)
    assert missing / 2.5 < share < 2.5 * missing
    assert ("along itself" in caplog.text) == (share > 0.1) == (missing > 0.1)


def test_a_load_on_a_surface_counts_as_a_force_does() -> None:
    """A pressure from all sides turns with them and bends no column: it counts as none."""
    push = 0.2 * SUPPORTS["clamped"]
    dead = fmbd.traction("right", tuple(-push / HEIGHT * ALONG))
    end, left, below, above = (fmbd.pressure(s, push / HEIGHT) for s in ("right", "left", "bottom", "top"))
    for kind in ("reduced", "field"):
        for loads, force in (((dead,), -push), ((end,), -push), ((end, left, below, above), 0.0)):
            found = first(column(*strip(kind, attached=False, loads=loads), "clamped", 0.0))
            here = found.system.at(found.about.t, found.about.q, found.about.v)
            told = left_out(here, found.about.lam, [(1.0, found.shapes[0])])[0][1]
            assert told == pytest.approx(force, rel=1e-9, abs=1e-9 * push)


@pytest.mark.parametrize("kind", ["beam", "reduced", "field"])
def test_a_stiffened_column_is_not_warned_of(kind: str, caplog: Any) -> None:
    """Half of Euler's load takes half of its stiffness."""
    body = strip(kind, attached=True, stiffening=True)
    alone, found = (first(column(*body, "clamped", p * SUPPORTS["clamped"])) for p in (0.0, 0.5))
    assert (found.frequencies[0] / alone.frequencies[0]) ** 2 == pytest.approx(0.52, abs=0.01)
    assert "along itself" not in caplog.text


@pytest.mark.parametrize(("kind", "share"), [("beam", 0.5), ("reduced", 0.4), ("absolute", 0.4)])
def test_runs_and_equilibria_tell_of_a_force_that_stays(kind: str, share: float, caplog: Any) -> None:
    """Pinned columns: two fifths of Euler's load; a hundredth, and a force that passes while nothing bends, are not told of."""

    def scene(push: Any) -> fmbd.Scene:
        if kind == "absolute":
            mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, HEIGHT), counts=(16, 1), origin=(0.0, -HEIGHT / 2))
            material = fmbd.materials.plane_stress(MODULUS, 0.0)
            body = fmbd.AbsoluteBody("strip", mesh.placed(START, ANGLE), density=1e3, elastic=material)
            made = column(body, "left", "right", "pinned", 0.0)
        else:
            made = column(*strip(kind, attached=False), "pinned", 0.0)
        far = next(iter(made.bodies.values())).surface("end" if kind == "beam" else "right")
        made.add(fmbd.force("push", far, lambda t: tuple(-push(t) * ALONG)))
        return made

    euler = SUPPORTS["pinned"]
    ramp = lambda t: 0.5 - 0.5 * np.cos(np.pi * min(5.0 * t, 1.0))
    steps = {"t_end": 0.4, "dt": 2e-3}
    fmbd.equilibrium(scene(lambda t: 0.01 * euler))
    fmbd.solve(scene(lambda t: 0.01 * euler * ramp(t)), **steps)
    fmbd.solve(scene(lambda t: 0.4 * euler * np.exp(-(((t - 0.2) / 2e-3) ** 2))), **steps)
    assert "along itself" not in caplog.text

    for told in (
        lambda: fmbd.equilibrium(scene(lambda t: 0.4 * euler)),
        lambda: fmbd.solve(scene(lambda t: 0.4 * euler * ramp(t)), **steps),
    ):
        caplog.clear()
        told()
        assert "is pressed along itself" in caplog.text
        found = float(caplog.text.split("which takes some ")[1].split(" %")[0]) / 100
        assert found == pytest.approx(share, rel=0.6)


def test_a_block_is_no_column(caplog: Any) -> None:
    block = fmbd.read_gmsh("meshes/block.py", size=(1.0, 1.0), counts=(4, 4))
    pressed = fmbd.traction("right", (-0.1 * MODULUS, 0.0))
    body = fmbd.AbsoluteBody(
        "block", block, density=1e3, elastic=fmbd.materials.plane_stress(MODULUS, 0.0), loads=[pressed]
    )
    scene = fmbd.Scene("block")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
    fmbd.equilibrium(scene)
    assert "along itself" not in caplog.text


def test_looks_become_fewer_and_do_not_cease(monkeypatch: Any) -> None:
    """Steps of a scheme's own choice, and those of several ranks, ask for a look each."""
    system, state, _ = column(*strip("beam", attached=True), "clamped", 0.0).build()
    at: list[float] = []
    monkeypatch.setattr(axial_forces, "axial_force", lambda ev, *of: at.append(ev.t) or (0.0, 1.0))
    watch = axial_forces.AxialForces(system)
    for t in range(1000):
        watch.look(replace(state, t=float(t)))
    assert at[:4] == [0.0, 1.0, 2.0, 3.0] and len(at) < 80
    assert max(b - a for a, b in zip(at, [*at[1:], 1000.0], strict=True)) < 150.0
