"""Energy-momentum scheme of mixed scenes: absolute bodies beside rigid ones, with joints, springs, dampers and loads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from dae_problems import march

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import kelvin_voigt, neo_hookean, saint_venant_kirchhoff

STIFF_AND_LARGE = [pytest.param(1e4, 0.05, marks=pytest.mark.mpi), (1e4, 0.5), (1e6, 0.5)]
QUIET = fmbd.Output(progress=False)


def spin(dim: int, rate: float) -> Any:
    return rate if dim == 2 else (0.2 * rate, 0.1 * rate, rate)


def free(mesh: Any, modulus: float, *, damping: float = 0.0, axis: Any = None) -> fmbd.Scene:
    """A rigid disk joined to an elastic rod, a second disk on a spring at the rod's tip; nothing held, all turning."""
    dim = mesh.dim
    zero, w = (0.0,) * (dim - 2), spin(dim, 1.0)
    J = 0.05 if dim == 2 else (0.05, 0.06, 0.08)
    rod = fmbd.AbsoluteBody("rod", mesh, degree=1, density=1.0, energy=saint_venant_kirchhoff(modulus, 0.3), quadrature=4,
                            angular_velocity=w, velocity=(0.1, 0.2, *zero))  # fmt: skip
    near = fmbd.RigidBody("near", 0.5, J, position=(-0.3, 0.1, *zero), angular_velocity=w, velocity=(0.1, -0.3, *zero))
    far = fmbd.RigidBody("far", 0.5, J, position=(1.6, 0.1, *zero), angular_velocity=w, velocity=(0.0, 1.0, *zero))
    center = (0.0, 0.0, *zero)
    joint = (
        fmbd.revolute("hinge", near, rod.surface("pin"), center=center, **({} if axis is None else {"axis": axis}))
        if dim == 2 or axis is not None
        else fmbd.spherical("hinge", near, rod.surface("pin"), center=center)
    )
    spring = fmbd.Spring("spring", rod.surface("tip"), far, point_a=(1.0, 0.05, *zero), point_b=(1.5, 0.1, *zero),
                         stiffness=modulus, damping=damping, length=0.5025 - 0.5 / modulus**0.5)  # fmt: skip
    scene = fmbd.Scene("free")
    scene.add(near, far, rod, joint, spring)
    return scene


def totals(run: fmbd.Run) -> tuple[Any, Any, Any]:
    p, spin = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
    return sum(run.energy.values()), p, spin


def steps(scene: fmbd.Scene, count: int, h: float) -> tuple[fmbd.Run, fmbd.Run]:
    """Runs of one step and of many."""
    first, run = (fmbd.solve(scene, t_end=n * h, dt=h, scheme=fmbd.EnergyMomentum(), output=QUIET) for n in (1, count))
    return first, run


@pytest.mark.parametrize(("modulus", "h"), STIFF_AND_LARGE)
def test_plane(rod_mesh: Callable[..., Any], modulus: float, h: float) -> None:
    """Hinge with a lever, spring with levers on both sides: energy, momentum and angular momentum to 1e-9 at any step."""
    first, run = steps(free(rod_mesh(dim=2, h=0.5, height=0.2), modulus), 8, h)
    (_, p0, L0), (energy, p, L) = totals(first), totals(run)
    assert np.abs(energy / energy[0] - 1).max() < 1e-9
    assert run.energy["elastic"].max() > 1e-5 * energy[0] and np.ptp(run.energy["springs"]) > 1e-3 * energy[0]
    np.testing.assert_allclose(p, p0, rtol=1e-9)
    np.testing.assert_allclose(L, L0, rtol=1e-9)
    assert run.drift[0] < 1e-12


@pytest.mark.parametrize(
    ("modulus", "h", "axis"),
    [(1e4, 0.05, (0, 0.6, 0.8)), (1e4, 0.2, None), pytest.param(1e6, 0.1, None, marks=pytest.mark.slow)],
)
def test_space(rod_mesh: Callable[..., Any], modulus: float, h: float, axis: Any) -> None:
    """The same in space, with a ball and with a skew hinge, which fixes rotations of an elastic surface."""
    first, run = steps(free(rod_mesh(dim=3, h=0.5, height=0.2), modulus, axis=axis), 4, h)
    (_, p0, L0), (energy, p, L) = totals(first), totals(run)
    assert np.abs(energy / energy[0] - 1).max() < 1e-9
    np.testing.assert_allclose(p, p0, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(L, L0, rtol=1e-9, atol=1e-9 * np.abs(L0).max())


def test_dampers_take_their_work(rod_mesh: Callable[..., Any]) -> None:
    """Viscous rod and damped spring, spinning: in each step energy falls by the dissipated work, momenta stay."""
    scene = free(rod_mesh(dim=2, h=0.5, height=0.2), 1e4, damping=30.0)
    rod = scene.bodies["rod"].with_(
        viscous=kelvin_voigt(2.0), displacement_rate=lambda X: 0.3 * np.array([X[0], -X[1]])
    )
    again = fmbd.Scene("damped")
    tip = scene.forces["spring"]
    spring = fmbd.Spring("spring", rod.surface("tip"), tip.b, point_a=tip.point_a, point_b=tip.point_b, stiffness=1e4,
                         damping=30.0, length=0.49)  # fmt: skip
    again.add(scene.bodies["near"], tip.b, rod, spring)
    again.add(fmbd.revolute("hinge", scene.bodies["near"], rod.surface("pin"), center=(0.0, 0.0)))
    h, states = 0.1, march(again, fmbd.EnergyMomentum(), 1.0, 10)
    system = again.build()[0]
    at = [system.at(s.t, s.q, s.v) for s in states]
    energy = np.array([sum(ev.energies().values()) for ev in at])
    length = np.array([system.forces[0].relative.values(ev.kin)[0] for ev in at])
    work = 30.0 * np.diff(length) ** 2 / h
    inside = [viscous_work(system, a, b, h) for a, b in zip(states, states[1:], strict=False)]
    np.testing.assert_allclose(-np.diff(energy), work + inside, rtol=1e-8, atol=1e-9 * energy[0])
    assert sum(inside) > 1e-3 * energy[0] and work.sum() > 1e-3 * energy[0]
    np.testing.assert_allclose([ev.momenta()[1] for ev in at], np.broadcast_to(at[0].momenta()[1], (11, 1)), rtol=1e-9)


def viscous_work(system: Any, a: Any, b: Any, h: float) -> float:
    """h int eta E' : E' of the strains at two instants, E' = (E_1 - E_0) / h, eta = 2 Pa s; by its own assembly."""
    import ufl
    from dolfinx import fem

    (k, part), ends = system.fields[0], []
    field = part.field
    for s in (a, b):
        u = fem.Function(field.space)
        u.x.array[: part.n] = system.local_q(s.q, k)
        u.x.scatter_forward()
        F = ufl.Identity(field.dim) + ufl.grad(u)
        ends.append(0.5 * F.T * F)
    change = ends[1] - ends[0]
    power = (
        2.0 / h * ufl.inner(change, change) * ufl.Measure("dx", field.mesh.dolfinx)(metadata={"quadrature_degree": 4})
    )
    return float(field.total(np.array(fem.assemble_scalar(fem.form(power)))))


def pendulum(mesh: Any) -> fmbd.Scene:
    """An elastic pendulum: the rod hangs by a spring from a rigid link that swings about the ground."""
    scene = fmbd.Scene("pendulum", gravity=(0.0, -1.0))
    link = fmbd.RigidBody("link", 0.1, 0.1, position=(-1.0, 0.0))
    rod = fmbd.AbsoluteBody("rod", mesh, density=1.0, degree=1, energy=neo_hookean(50.0, 0.3), quadrature=4)
    scene.add(link, rod, fmbd.revolute("pin", fmbd.ground, link, center=(-1.5, 0.0)))
    scene.add(
        fmbd.Spring("spring", link, rod.surface("pin"), point_a=(-0.5, 0.0), point_b=(0, 0), stiffness=3.0, length=0.5)
    )
    return scene


@pytest.mark.parametrize("h", [0.05, 0.2, 0.5])
def test_hanging_pendulum_keeps_its_energy(rod_mesh: Callable[..., Any], h: float) -> None:
    run = fmbd.solve(pendulum(rod_mesh(dim=2, h=0.5, height=0.2)), t_end=20 * h, dt=h, scheme=fmbd.EnergyMomentum())
    energy = sum(run.energy.values())
    assert np.abs(energy - energy[0]).max() < 1e-9 * run.energy["kinetic"].max()
    assert min(run.energy[k].max() for k in ("elastic", "springs")) > 1e-4 * run.energy["kinetic"].max()


def test_order_two(rod_mesh: Callable[..., Any]) -> None:
    """Position, velocity and multiplier of the pendulum against a fine run, from the first step on."""
    scene = pendulum(rod_mesh(dim=2, h=0.5, height=0.2))
    fine = march(scene, fmbd.EnergyMomentum(), 0.08, 256)
    errors = []
    for n in (8, 16, 32):
        coarse, every = march(scene, fmbd.EnergyMomentum(), 0.08, n), 256 // n
        errors.append(
            [max(np.abs(getattr(a, x) - getattr(b, x)).max() for a, b in zip(coarse, fine[::every], strict=True))
             for x in ("q", "v", "lam")]
        )  # fmt: skip
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-1].min() > 1.9, orders


def test_work_of_loads(rod_mesh: Callable[..., Any]) -> None:
    """A dead traction and a force on the surface: energy changes by their work; a pressure around the body by p dA."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)
    around = [fmbd.pressure(s, 40.0) for s in mesh.surface_names]
    loads = [fmbd.traction("tip", (3.0, 5.0)), *around]
    rod = fmbd.AbsoluteBody("rod", mesh, density=1.0, energy=neo_hookean(1e3, 0.3), quadrature=4, loads=loads)
    rod = rod.with_(angular_velocity=1.0, degree=1)
    scene = fmbd.Scene("loaded")
    scene.add(rod, fmbd.force("push", rod.surface("tip"), lambda t: np.array([0.5, -0.2])))
    states = march(scene, fmbd.EnergyMomentum(), 2.0, 10)
    system = scene.build()[0]
    energy = np.array([sum(system.at(s.t, s.q, s.v).energies().values()) for s in states])
    k, part = system.fields[0]
    tip = np.array([part.ports_of(system.local_q(s.q, k), s.t)[:2] for s in states])
    size = np.array([area(part.field, system.local_q(s.q, k)) for s in states])
    work = tip @ (0.2 * np.array([3.0, 5.0]) + [0.5, -0.2]) - 40.0 * size
    assert np.ptp(40.0 * size) > 1e-2 * np.ptp(energy)
    np.testing.assert_allclose(energy - energy[0], work - work[0], atol=1e-9 * np.ptp(energy))


def area(field: Any, U: Any) -> float:
    """int det F, m^2."""
    import ufl
    from dolfinx import fem

    field.place(U)
    F = ufl.Identity(2) + ufl.grad(field._w)
    return float(
        field.total(np.array(fem.assemble_scalar(fem.form(ufl.det(F) * ufl.Measure("dx", field.mesh.dolfinx)))))
    )
