"""Large strain at nu = 1/2 with the pressure as an unknown: exact stretch, inflated ring, volume kept in motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.materials import neo_hookean_incompressible, neo_hookean_mixed

ROOT = Path(__file__).resolve().parents[1]
E, DENSITY = 3e6, 1000.0
MU = E / 3
QUIET = fmbd.Output(estimate_error=False)


def the_field(run: fmbd.Run) -> tuple[Any, Any]:
    """Field of the only elastic body, and its displacements at the end."""
    k, part = run.system.fields[0]
    return part.field, run.system.local_q(run.state.q, k)


def volume_gap(run: fmbd.Run) -> float:
    """Largest mean of J - 1 over a function of the pressure's space; collective."""
    import ufl
    from dolfinx import fem, la

    field, U = the_field(run)
    field._place(U)
    q, dx = ufl.TestFunction(field.pressure), ufl.Measure("dx", field.mesh.dolfinx)
    J = ufl.det(ufl.Identity(field.dim) + ufl.grad(field._w))
    moments = []
    for form in ((J - 1) * q * dx, q * dx):
        b = fem.assemble_vector(fem.form(form))
        b.scatter_reverse(la.InsertMode.add)
        moments.append(b.array[: field.n_pressure])
    return float(max(field.comm.allgather(np.abs(moments[0] / moments[1]).max(initial=0.0))))


def stretched(dim: int, stretch: float, nu: float = 0.5) -> fmbd.Run:
    """A block at rest under the dead traction of an incompressible stretch along x."""
    traction = MU * (stretch - stretch ** (-3 if dim == 2 else -2))
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.5, 0.5)[:dim], counts=(3, 2, 2)[:dim])
    load = fmbd.traction("right", (traction, 0.0, 0.0)[:dim])
    energy = neo_hookean_incompressible(2 * MU * (1 + nu), nu)
    body = fmbd.AbsoluteBody("block", mesh, density=DENSITY, energy=energy, loads=[load])
    scene = fmbd.Scene("stretch", settle=True)
    scene.add(body, fmbd.fixed("wall", body.surface("left"), fmbd.ground))
    scene.sensor("end", fmbd.position(body.surface("right")))
    return fmbd.solve(scene, t_end=2e-3, dt=1e-3, output=QUIET)


@pytest.mark.mpi
@pytest.mark.parametrize("dim, stretch", [(2, 1.5), (3, 1.2)])
def test_homogeneous_stretch(dim: int, stretch: float) -> None:
    """Displacement, pressure and volume of the patch are exact: p = mu (1 - s^2) for the stretch s across."""
    run = stretched(dim, stretch)
    field, U = the_field(run)
    across = stretch ** (-1 if dim == 2 else -0.5)
    np.testing.assert_allclose(run["end"][:, 0], stretch, atol=1e-10)
    np.testing.assert_allclose(field.pressure_values, MU * (1 - across**2), rtol=1e-9)
    x = field.X_world + U.reshape(-1, dim)
    height = field.X_world[:, 1] - 0.25
    np.testing.assert_allclose(x[:, 1], 0.25 + across * height, atol=1e-10)
    assert volume_gap(run) < 1e-11


def test_below_one_half() -> None:
    """At nu = 0.49 the pressure is lambda (J - 1) and the stretch that of the energy."""
    run = stretched(2, 1.3, 0.49)
    field, _ = the_field(run)
    p, lam = float(field.pressure_values.mean()), 2 * MU * 0.49 / 0.02
    np.testing.assert_allclose(field.pressure_values, p, rtol=1e-7)
    J = 1 + p / lam
    s = run["end"][-1, 0]
    for stretch, traction in ((s, MU * (1.3 - 1.3**-3)), (J / s, 0.0)):
        found = MU * (stretch - 1 / stretch) + p * J / stretch
        assert abs(found - traction) < 1e-8 * MU


def inflation(ratio: float, outer: float, inner: float) -> float:
    """Pressure (Pa) that widens an incompressible ring in plane strain to ``ratio`` of its inner radius."""
    c = inner**2 * (ratio**2 - 1)

    def slope(R: float) -> float:
        square = (R * R + c) / R**2
        return MU * (square - 1 / square) * R / (R * R + c)

    return float(quad(slope, inner, outer)[0])


@pytest.mark.serial
def test_inflated_ring() -> None:
    """The inner radius under a follower pressure converges with order 2 (the polygon) to that of the closed form."""
    inner, outer, ratio = 0.01, 0.03, 1.2
    pressure, errors = inflation(ratio, outer, inner), []
    for h in (0.008, 0.004):
        mesh = fmbd.read_gmsh(ROOT / "meshes/ring.py", radius=(inner + outer) / 2, width=outer - inner, h=h)
        body = fmbd.AbsoluteBody(
            "ring",
            mesh,
            density=DENSITY,
            energy=neo_hookean_incompressible(E),
            loads=[fmbd.pressure("inner", pressure)],
        )
        scene = fmbd.Scene("ring", settle=True)
        scene.add(body, fmbd.fixed("hold", body.surface("outer"), fmbd.ground))
        run = fmbd.solve(scene, t_end=1e-5, dt=1e-5, output=QUIET)
        field, U = the_field(run)
        at = np.hypot(*field.X_world.T) < inner * 1.0001
        r = np.hypot(*(field.X_world + U.reshape(-1, 2))[at].T)
        R = np.hypot(*field.X_world[at].T)
        corner = R > inner * 0.9999
        errors.append(abs(float(r[corner].mean()) / (inner * ratio) - 1))
        assert volume_gap(run) < 1e-10
    assert errors[1] < 0.35 * errors[0]
    assert errors[1] < 5e-3


def pendulum(mesh: Any, energy: Any, scheme: Any = None) -> fmbd.Run:
    """A soft rod that falls about a pin at its end, dt = 2.5 ms."""
    body = fmbd.AbsoluteBody("rod", mesh, density=DENSITY, energy=energy)
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81, 0.0)[: body.dim])
    scene.add(body, fmbd.revolute("pin", body.surface("pin"), fmbd.ground))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return fmbd.solve(scene, t_end=0.1, dt=2.5e-3, scheme=scheme, output=QUIET)


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_volume_in_motion(rod_mesh: Callable[..., Any], dim: int) -> None:
    """A falling soft rod keeps its volume to 1e-8, and moves as with a large lambda."""
    mesh = rod_mesh(dim=dim, h=0.1)
    run = pendulum(mesh, neo_hookean_incompressible(1e5))
    assert volume_gap(run) < 1e-8
    if dim == 2:
        near = pendulum(mesh, neo_hookean_mixed(1e5, 0.5))
        assert volume_gap(near) > 1e-7
        assert np.abs(near["tip"] - run["tip"]).max() < 1e-4
        again = fmbd.solve(run.scene, t_end=0.1, dt=2.5e-3, output=QUIET)
        np.testing.assert_allclose(again["tip"], run["tip"], rtol=0, atol=1e-12)


def test_refused(rod_mesh: Callable[..., Any]) -> None:
    """What does not move the pressure is refused: other schemes, the stabilised form, floating frames, Rayleigh damping."""
    mesh, energy = rod_mesh(dim=2, h=0.25), neo_hookean_incompressible(1e5)
    for scheme in (fmbd.BDF(), fmbd.GeneralizedAlpha(form=fmbd.GGL())):
        with pytest.raises(InputError, match="pressure that is an unknown"):
            pendulum(mesh, energy, scheme)
    for nu in (0.0, 0.51):
        with pytest.raises(InputError, match="must lie in"):
            neo_hookean_incompressible(1e5, nu)
    scene = fmbd.Scene("floating")
    scene.add(fmbd.FloatingBody("rod", mesh, density=DENSITY, energy=energy))
    with pytest.raises(InputError, match="needs an AbsoluteBody"):
        scene.build()
    damped = fmbd.Scene("damped")
    damped.add(fmbd.AbsoluteBody("rod", mesh, density=DENSITY, energy=energy, stiffness_damping=1e-3))
    with pytest.raises(InputError, match="stiffness_damping"):
        damped.build()
