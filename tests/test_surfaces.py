"""Moments of named surfaces against integrals by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from motion import elastic_rod, elastic_scene

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError, MeshError
from fmbd_fenicsx.traces.fields import Field

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_area_centroid_and_weights(dim: int, degree: int, rod_mesh: Callable[..., Any]) -> None:
    H = 0.4
    mesh = rod_mesh(dim=dim, h=0.5, height=H)
    f = Field("rod", mesh, elastic_rod(mesh, degree=degree).forms())
    tip = f.moments("tip")
    assert abs(tip.area / H ** (dim - 1) - 1) < 1e-13
    assert np.abs(tip.center - [1.0, 0, 0][:dim]).max() < 1e-13
    sums = f.total(tip.weights.sum(0))
    assert abs(sums[0] - 1) < 1e-13  # a mean
    assert np.abs(sums[1:]).max() < 1e-13  # first moments of a constant about the centroid


@pytest.mark.smoke
@pytest.mark.parametrize("dim", [2, 3])
def test_moments_of_linear_and_quadratic_displacements(dim: int, rod_mesh: Callable[..., Any]) -> None:
    """mean(u) and mean(u_i (x_k - c_k)) l^-1 of u = (x + 3 y, y^2) over the tip x = 1, |y| < H/2."""
    H = 0.4
    mesh = rod_mesh(dim=dim, h=0.5, height=H)
    f = Field("rod", mesh, elastic_rod(mesh).forms())
    tip = f.moments("tip")
    x = f.X_world
    U = np.zeros((f.n, dim))
    U[:, 0], U[:, 1] = x[:, 0] + 3 * x[:, 1], x[:, 1] ** 2
    b = f.total(tip.weights.T @ U[tip.nodes])
    assert np.abs(b[0] - [1.0, H * H / 12, 0][:dim]).max() < 1e-13
    assert abs(b[2, 0] - 3 * H * H / 12 / tip.length) < 1e-13
    assert np.abs(b[1]).max() < 1e-13  # no extension along x


def test_surfaces_are_cached_and_used_once(rod_mesh: Callable[..., Any]) -> None:
    mesh = rod_mesh(dim=2, h=0.5, height=0.4)
    f = Field("rod", mesh, elastic_rod(mesh).forms())
    assert f.moments("tip") is f.moments("tip")


def test_unknown_surface_lists_near_names(rod_mesh: Callable[..., Any]) -> None:
    rod = elastic_rod(rod_mesh(dim=2, h=0.5, height=0.4))
    with pytest.raises(InputError, match=r'"rod".*"tipp".*Did you mean "tip".*"pin", "side", "tip"'):
        rod.surface("tipp")


def test_attached_frame_needs_a_known_surface(rod_mesh: Callable[..., Any]) -> None:
    with pytest.raises(InputError, match=r'"pinn".*Did you mean "pin"'):
        elastic_rod(rod_mesh(dim=2, h=0.5, height=0.4), frame=fmbd.Attached("pinn"))


def test_joint_on_a_surface_without_facets_is_refused(rod_mesh: Callable[..., Any]) -> None:
    """A name whose tag no facet carries: the integral would be silently zero."""
    from dataclasses import replace

    mesh = rod_mesh(dim=2, h=0.5, height=0.4)
    hollow = replace(mesh, surfaces={**mesh.surfaces, "ghost": 99})
    scene, rod, block = elastic_scene(hollow)
    scene.add(fmbd.revolute("pin", rod.surface("ghost"), block, center=(0, 0)))
    with pytest.raises(MeshError, match='"ghost".*no facets'):
        scene.build()
