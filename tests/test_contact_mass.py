"""Mass redistribution: no inertia on contact nodes, all moments of the body kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.mechanics.contact.mass import redistribute_mass
from fmbd_fenicsx.mechanics.contact.trace import surface_nodes
from fmbd_fenicsx.schemes.impacts.contact_midpoint import elastic_start

BLOCK = Path(__file__).resolve().parents[1] / "meshes/block.py"


@pytest.mark.mpi
@pytest.mark.parametrize(("size", "degree"), [((1.0, 0.5), 1), ((1.0, 0.5), 2), ((1.0, 0.8, 0.6), 1)])
def test_moments_are_kept_and_contact_nodes_are_massless(size: tuple[float, ...], degree: int) -> None:
    mesh = fmbd.read_gmsh(BLOCK, size=size, cells=24 if len(size) == 2 else 12)
    body = fmbd.AbsoluteBody("block", mesh, degree=degree, density=3.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3))
    field = Field("block", mesh, body.forms())
    mass, center, inertia = field.mass_total, field.center.copy(), field.inertia.copy()
    nodes = surface_nodes(field, ["bottom"])
    redistribute_mass(field, nodes)
    assert field.mass_total == pytest.approx(mass, rel=1e-12)
    assert field.center == pytest.approx(center, abs=1e-12)
    assert field.inertia == pytest.approx(inertia, rel=1e-10, abs=1e-12)
    probe = np.zeros((field.n, field.dim))
    probe[nodes] = 1.0
    assert field.total(np.array(np.abs(field.mass(probe)).sum())) == 0.0
    rng = np.random.default_rng(3 + field.comm.rank)
    free = rng.standard_normal((field.n, field.dim))
    assert field.total(np.array((free * field.mass(free)).sum())) > 0
    field.destroy()


def test_start_of_an_elastic_contact_changes_the_motion_least() -> None:
    """A block on a hinge, given a velocity that opens it: no motion that the hinge allows does work on M dv + tau^2 K dv."""
    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.5), cells=3, origin=(0.0, 0.1))
    elastic = fmbd.materials.linear_elastic(100.0, 0.3)
    body = fmbd.AbsoluteBody("block", mesh, degree=1, density=1.0, elastic=elastic, velocity=(1.0, -0.5))
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0)))
    scene = fmbd.Scene("hinged")
    scene.add(body, fmbd.revolute("hinge", fmbd.ground, body.surface("left"), center=(0.0, 0.35)))
    scene.add(fmbd.contact("floor", body.surface("bottom"), floor))
    system, given, _ = scene.build()
    tau = 0.1
    start, _ = elastic_start(system, given, StepSolver(system), tau)

    ev, rest = system.at(0.0, given.q, given.v), np.zeros(system.n_v)
    ((_, part),) = system.fields
    G = np.stack([ev.jacobian.times(e) for e in np.eye(system.n_v)], axis=1)
    change = start.v - given.v
    pushed = ev.balance(change) - ev.balance(rest) + tau**2 * part.field.stiffness(change)
    allowed = np.eye(system.n_v) - np.linalg.pinv(G) @ G
    assert np.abs(G @ start.v).max() < 1e-9 and np.abs(change).max() > 0.1
    assert np.abs(allowed @ pushed).max() < 1e-8 * np.abs(pushed).max()
