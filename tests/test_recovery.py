"""Stress recovery, chord frames, Kelvin-Voigt damping."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.materials import lame, linear_elastic
from fmbd_fenicsx.mechanics.reduction.recovery import displacement_field, stress

MODULUS, NU, DENSITY = 5e6, 0.0, 1000.0


def sigma(u: Any) -> Any:
    import ufl

    mu, lmbda = lame(MODULUS, NU)
    e = ufl.sym(ufl.grad(u))
    return 2 * mu * e + lmbda * ufl.tr(e) * ufl.Identity(len(u))


def rod(mesh: Any, **changes: Any) -> fmbd.FloatingBody:
    return fmbd.FloatingBody("rod", mesh, density=DENSITY, elastic=linear_elastic(MODULUS, NU)).with_(**changes)


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["full", "reduced"])
def test_stress_of_a_hanging_rod(rod_mesh: Callable[..., Any], kind: str) -> None:
    """At rest under its weight along the axis: sigma_xx = rho g (L - x), at every point."""
    from mpi4py import MPI

    basis = fmbd.CraigBampton(("pin",), 30)
    body: Any = rod(rod_mesh(dim=2, h=0.1), frame=fmbd.Attached("pin"), stiffness_damping=0.02)
    body = body if kind == "full" else body.reduced(basis=basis)
    scene = fmbd.Scene("hanging", gravity=(9.81, 0.0), gravity_ramp=0.5)
    scene.add(body, fmbd.fixed("wall", fmbd.ground, body.surface("pin")))
    run = fmbd.solve(scene, t_end=2.0, dt=1e-2, scheme=fmbd.GeneralizedAlpha(0.5))
    found = stress(displacement_field(run, body), sigma)
    space = found.function_space
    x = space.tabulate_dof_coordinates()[: space.dofmap.index_map.size_local, 0]
    xx = found.x.array.reshape(-1, 4)[: len(x), 0]
    away = x > 0.3  # the held surface is free to warp near x = 0
    gap = np.abs(xx - DENSITY * 9.81 * (1.0 - x))[away].max(initial=0.0)
    gap = MPI.COMM_WORLD.allreduce(gap, op=MPI.MAX)
    assert gap < (0.01 if kind == "full" else 0.1) * DENSITY * 9.81


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_frames_give_the_same_motion(rod_mesh: Callable[..., Any], dim: int) -> None:
    """Mean axes, attached and chord frames: tips agree to the order of the strain, which falls with 1 / E."""
    gaps = []
    for modulus in (5e7, 5e8):
        tips = []
        for frame in (fmbd.MeanAxis(), fmbd.Attached("pin"), fmbd.Chord("pin", "tip")):
            body = rod(rod_mesh(dim=dim, h=0.25), frame=frame, elastic=linear_elastic(modulus, 0.3))
            scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81, 0.0)[:dim])
            scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin")))
            scene.sensor("tip", fmbd.position(body.surface("tip")))
            tips.append(fmbd.solve(scene, t_end=0.1, dt=2e-3, scheme=fmbd.GeneralizedAlpha(0.5))["tip"])
        gaps.append(max(np.abs(t - tips[0]).max() for t in tips[1:]))
    assert gaps[0] < 1e-4  # m: a tenth of the deflection
    assert gaps[1] < 0.2 * gaps[0]


def test_chord_of_one_surface_is_refused(rod_mesh: Callable[..., Any]) -> None:
    """A chord needs two places."""
    scene = fmbd.Scene("free")
    scene.add(rod(rod_mesh(dim=2, h=0.25), frame=fmbd.Chord("pin", "pin")))
    with pytest.raises(InputError, match="coincide"):
        scene.build()


@pytest.mark.parametrize("reduced", [False, True])
def test_kelvin_voigt_is_rayleigh_for_the_same_form(rod_mesh: Callable[..., Any], reduced: bool) -> None:
    """A viscous form beta a(u, v) damps like stiffness_damping = beta, with one factor."""
    mesh, beta = rod_mesh(dim=2, h=0.25), 5e-3
    elastic = linear_elastic(MODULUS, NU)
    energies = []
    for changes in ({"stiffness_damping": beta}, {"viscous": lambda u, v, dx: beta * elastic(u, v, dx)}):
        body: Any = rod(
            mesh, displacement_rate=None if reduced else lambda X: np.array([0 * X[0], (X[0] - 0.5) ** 2]), **changes
        )
        body = body.reduced(modes=4) if reduced else body
        scene = fmbd.Scene("free", gravity=(0.0, -9.81))
        scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin")))
        run = fmbd.solve(scene, t_end=0.1, dt=2e-3)
        energies.append(run.energy["elastic"])
        assert run.counters["factorisations"] <= 2
    np.testing.assert_allclose(energies[0], energies[1], rtol=1e-5, atol=1e-9)
