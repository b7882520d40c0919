"""A tied face is clamped whatever its facets; what a tie leaves free is said."""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
import pytest
from test_multipliers import make

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.traces.multipliers import Linear, default_space

HOOKE = {2: fmbd.materials.plane_stress(2e11, 0.3), 3: fmbd.materials.linear_elastic(2e11, 0.3)}


def cantilever(dim: int, facets: int, degree: int, **tie: Any) -> fmbd.Scene:
    """A steel cantilever 1 m long, 0.1 m high, with few facets on its clamp, under its weight."""
    size, origin = (1.0, 0.1, 0.1)[:dim], (0.0, -0.05, -0.05)[:dim]
    counts = (10 * facets, facets, facets)[:dim]
    mesh = fmbd.read_gmsh("meshes/block.py", size=size, origin=origin, counts=counts)
    body = fmbd.FloatingBody("rod", mesh, degree=degree, density=7800.0, elastic=HOOKE[dim])
    scene = fmbd.Scene("cantilever", gravity=(0.0, -9.81, 0.0)[:dim], settle=True)
    scene.add(body, fmbd.tie_surface("clamp", body.surface("left"), fmbd.ground, **tie))
    scene.sensor("tip", fmbd.position(body.surface("right")))
    return scene


@pytest.mark.parametrize("dim, facets, degree", [(2, 1, 1), (2, 2, 1), (2, 3, 1), (2, 1, 2), (3, 1, 1)])
def test_a_tie_on_few_facets_is_a_clamp(dim: int, facets: int, degree: int) -> None:
    scene = cantilever(dim, facets, degree)
    assert not scene.check().notes

    tip = fmbd.solve(scene, t_end=1e-6, dt=1e-6)["tip"][0]
    sag = 1.5 * 7800.0 * 9.81 / (2e11 * 0.1**2)  # q l^4 / (8 E I) of a beam
    assert -1.1 * sag < tip[1] < -0.05 * sag  # coarse linear elements are too stiff, a pin would fall


def test_a_space_that_holds_no_rotation_is_named(caplog: Any) -> None:
    constant = fmbd.multipliers.Continuous(1)
    scene = cantilever(2, 1, 1, space=constant)
    assert any('tie "clamp" leaves free: rotation' in note for note in scene.check().notes)
    assert 'tie "clamp" is no clamp' in caplog.text


def test_a_sliding_tie_lists_what_it_leaves_free() -> None:
    notes = cantilever(3, 2, 1, sliding=True).check().notes
    free = next(note for note in notes if note.startswith('tie "clamp" leaves free'))
    assert free.count("displacement") == 2 and free.count("rotation") == 1
    assert "rotation about (1, 0, 0)" in free


def test_linear_functions_of_an_inclined_surface_are_independent() -> None:
    _, _, trace = make(3, 1)
    s, c = np.sin(0.6), np.cos(0.6)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    turned = copy(trace)
    vars(turned)["corners"] = trace.corners @ R.T
    assert Linear().on(turned).n == 3
    assert default_space(1).on(turned).n >= 3
