"""Ties of surfaces in compiled code: states, solutions and steps are those of NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_compiled import pair
from test_field_states import assert_equal_to_numpy
from test_trace_ties import body, scene_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import saint_venant_kirchhoff
from fmbd_fenicsx.system.compiled.choice import driver_states
from fmbd_fenicsx.system.compiled.tables.items.tied import MOST

pytestmark = pytest.mark.compiled
SIDES = [(a, b) for a in ("absolute", "floating") for b in ("ground", "rigid", "absolute", "floating")]


@pytest.mark.parametrize("a, b", SIDES)
@pytest.mark.parametrize("dim", [2, 3])
def test_states_are_those_of_numpy(dim: int, a: str, b: str) -> None:
    """Unlike meshes, and data that are imposed in time."""
    assert_equal_to_numpy(scene_of(dim, a, b, False))


@pytest.mark.parametrize("a, b", [("absolute", "ground"), ("floating", "ground"), ("floating", "absolute")])
@pytest.mark.parametrize("dim", [2, 3])
def test_sliding_with_imposed_data(dim: int, a: str, b: str) -> None:
    assert_equal_to_numpy(scene_of(dim, a, b, True))


@pytest.mark.parametrize("b", ["rigid", "floating"])
@pytest.mark.parametrize("dim", [2, 3])
def test_sliding_along_what_moves(dim: int, b: str) -> None:
    """The normal turns with the other body; data imposed along it are left to NumPy."""
    scene = scene_of(dim, "floating", b, True)
    assert driver_states(scene.build()[0]) is None
    slides = fmbd.Scene("slides", gravity=None)
    slides.add(*scene.bodies.values())
    glue = scene.ties["glue"]
    slides.add(fmbd.tie_surface("glue", glue.a, glue.b, space=glue.space, sliding=True))
    assert_equal_to_numpy(slides)


def hung(dim: int, kind: str, lower: str, **law: Any) -> fmbd.Scene:
    """Two blocks of unlike meshes on top of each other, the lower one on a hinge, or one alone on a floor that moves."""
    upper = body(kind, "upper", dim, 3, 1.0).with_(**law)
    scene = fmbd.Scene("hung", gravity=(3.0, -1.0, 2.0)[:dim])
    scene.add(upper)
    if lower == "floor":
        shape = lambda x: np.stack([0.01 * x[0], 0.1 + x[1], 0.02 * x[0]][:dim])
        motion = {"shape": shape, "motion": lambda t: np.sin(3 * t) ** 3}
        scene.add(fmbd.tie_surface("glue", upper.surface("bottom"), fmbd.ground, **motion))
    else:
        foot = body(lower, "foot", dim, 2)
        axis = {} if dim == 2 else {"axis": (0, 0, 1)}
        scene.add(foot, fmbd.tie_surface("glue", upper.surface("bottom"), foot.surface("top")))
        scene.add(fmbd.revolute("hinge", fmbd.ground, foot.surface("bottom"), center=(0.5, 0, 0.5)[:dim], **axis))
    scene.sensor("top", fmbd.position(upper.surface("top")))
    return scene


@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()], ids=str)
@pytest.mark.parametrize("dim, kind, lower", [
    (2, "floating", "floor"), (2, "absolute", "floor"), (2, "floating", "floating"), (2, "absolute", "floating"),
    (3, "floating", "absolute"),
])  # fmt: skip
def test_steps_are_those_of_numpy(dim: int, kind: str, lower: str, form: Any) -> None:
    """All but the first are compiled, the tractions agree."""
    fast, slow = pair(lambda: hung(dim, kind, lower), form, t_end=0.04, dt=2e-3)
    assert fast.counters["compiled_steps"] >= 19
    for name, bar in (("q", 1e-11), ("v", 1e-8), ("a", 1e-6), ("lam", 1e-6)):
        x, y = getattr(fast.state, name), getattr(slow.state, name)
        assert np.abs(x - y).max() < bar * np.abs(y).max(), name


@pytest.mark.parametrize(
    "law", [{}, {"energy": saint_venant_kirchhoff(1e4, 0.3), "elastic": None}], ids=["small", "large"]
)
def test_energy_is_kept(law: dict[str, Any]) -> None:
    """By the energy-momentum scheme, through a tie of two bodies that turn: rows of ties are difference quotients as they are."""
    run = fmbd.solve(hung(2, "absolute", "absolute", **law), t_end=0.2, dt=2e-3, scheme=fmbd.EnergyMomentum())
    energy = sum(run.energy.values())
    assert np.abs(energy - energy[0]).max() < 1e-10 * run.energy["kinetic"].max()
    assert run.energy["kinetic"].max() > 1e-3


def test_many_rows_are_left_to_numpy() -> None:
    upper = body("floating", "upper", 3, 11, 1.0)
    scene = fmbd.Scene("many")
    scene.add(upper, fmbd.tie_surface("glue", upper.surface("bottom"), fmbd.ground))
    system = scene.build()[0]
    assert system.n_lam > MOST
    assert driver_states(system) is None
