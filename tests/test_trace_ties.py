"""Ties of surfaces in scenes: Jacobians and accelerations against differences, statics, rigid partners,
moving data."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from motion import Motion, beside, elastic_rod, first, second
from mpi4py import MPI
from test_traces import ROOT

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError, LawError
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.linear.core_matrix import core_matrix
from fmbd_fenicsx.matrices import WIDE, thin
from fmbd_fenicsx.mechanics.elastic.field_part import FieldPart
from fmbd_fenicsx.system.tangents import jacobian

LAW = fmbd.materials.linear_elastic(1e4, 0.3)


def block(dim: int, cells: int = 2, low: float = 0.0):
    return fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0,) * dim, cells=cells, origin=(0.0, low, 0.0)[:dim])


def body(kind: str, name: str, dim: int, cells: int = 2, low: float = 0.0):
    make = fmbd.AbsoluteBody if kind == "absolute" else fmbd.FloatingBody
    return make(name, block(dim, cells, low), degree=1, density=1.0, elastic=LAW)


def scene_of(dim: int, a: str, b: str, sliding: bool) -> fmbd.Scene:
    upper = body(a, "upper", dim, 3, 1.0)
    scene = fmbd.Scene("tied", gravity=None)
    scene.add(upper)
    space = fmbd.Continuous(1, fmbd.Ends.KEPT) if dim == 2 else fmbd.Continuous()
    if b == "rigid":
        other = fmbd.RigidBody(
            "plate",
            2.0,
            0.3 if dim == 2 else (0.3, 0.4, 0.5),
            position=(0.4, 0.7, 0.6)[:dim],
            rotation=0.2 if dim == 2 else None,
        )
        scene.add(other)
    elif b == "ground":
        other = fmbd.ground
    else:
        lower = body(b, "lower", dim, 2)
        scene.add(lower)
        other = lower.surface("top")
    shape = lambda x: np.stack([0.1 + x[0], x[1], x[0]][:dim])  # noqa: E731
    scene.add(
        fmbd.tie_surface(
            "glue",
            upper.surface("bottom"),
            other,
            space=space,
            sliding=sliding,
            shape=shape,
            motion=lambda t: 0.1 * np.sin(t),
        )
    )
    return scene


@pytest.mark.parametrize("kind", ["rigid", "absolute", "modes"])
def test_large_matrices_are_sparse_and_the_same(kind: str, rod_mesh: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def matrices() -> list[Any]:
        rod = elastic_rod(rod_mesh(dim=2, h=0.5, height=0.4), degree=1, frame=fmbd.Attached("pin"), stiffening=True)
        if kind == "modes":
            scene, rod, two = beside(rod.reduced(modes=3), True, 2)
            scene.add(fmbd.revolute("hinge", rod.surface("tip"), two, center=(1.0, 0.0)))
        else:
            scene = scene_of(2, "absolute", kind, sliding=False)
        ev = Motion(scene).at(0.0)
        G = ev.jacobian
        return [core_matrix(ev, Weights(1.0, 0.1, 0.01)), G.core, G.port]

    few = matrices()
    monkeypatch.setattr(jacobian, "DENSE_LIMIT", 0)
    monkeypatch.setattr(jacobian, "PORT_LIMIT", 0)
    for one, many in zip(few, matrices(), strict=True):
        assert isinstance(one, np.ndarray) and sp.issparse(many)
        np.testing.assert_allclose(many.toarray(), one, rtol=1e-12, atol=1e-12 * np.abs(one).max(initial=0.0))


@pytest.mark.mpi
@pytest.mark.parametrize("sliding", [False, True])
@pytest.mark.parametrize(
    "a, b",
    [
        ("absolute", "ground"),
        ("absolute", "rigid"),
        ("absolute", "absolute"),
        ("floating", "rigid"),
        ("floating", "floating"),
    ],
)
@pytest.mark.parametrize("dim", [2, 3])
def test_jacobian_and_gamma_against_differences(dim: int, a: str, b: str, sliding: bool) -> None:
    motion = Motion(scene_of(dim, a, b, sliding))
    ev = motion.at(0.0)
    rows = motion.system.block("glue").rows
    scale = np.abs(motion.at(0.1).constraint()[rows]).max()
    rate = ev.jacobian.times(motion.v) + ev.constraint_rate()
    assert np.abs(rate - first(lambda s: motion.at(s).constraint()))[rows].max() < 1e-8 * scale
    acceleration = ev.jacobian.times(motion.a) + ev.gamma()
    assert np.abs(acceleration - second(lambda s: motion.at(s).constraint()))[rows].max() < 1e-5 * scale
    delta, lam = motion.direction(), np.linspace(1, 2, motion.system.n_lam)
    assert motion.system.dot(ev.jacobian.transposed(lam), delta) == pytest.approx(
        lam @ ev.jacobian.times(delta), rel=1e-11
    )


@pytest.mark.mpi
def test_columns_and_complement_of_many_ports() -> None:
    """What the core sees of a body is R^T W S, by few operations: a row of a tie has few ports. Columns of
    ports are their nodal forces.
    """
    lower, upper = body("absolute", "lower", 3, 4), body("floating", "upper", 3, 5, 1.0)
    scene = fmbd.Scene("tied")
    scene.add(lower, upper, fmbd.tie_surface("glue", upper.surface("bottom"), lower.surface("top")))
    scene.add(fmbd.tie_surface("foot", lower.surface("bottom"), fmbd.ground))
    system, state, _ = scene.build()

    solver = StepSolver(system)
    solver.prepare(system.at(0.0, state.q, state.v), Weights(1.0, 0.0, 1e-3))
    for (_, part), block, coupling in zip(system.fields, solver.blocks, solver.prepared.couplings, strict=True):
        S = coupling.entries
        assert sp.issparse(thin(S.T)) == (S.size > WIDE)
        R = S * np.linspace(1.0, 2.0, S.shape[1])  # as forces of other rows
        exact = R.T @ block.W @ S
        assert np.abs(block.seen_by(R, S) - exact).max() < 1e-13 * np.abs(exact).max()

        H = FieldPart.port_columns(part, block.used, 0.0)
        for i in (0, len(block.used) // 2, len(block.used) - 1):
            unit = np.zeros(part.n_port)
            unit[block.used[i]] = 1.0
            assert np.abs(H[:, i] - part.port_force(unit, 0.0)).max(initial=0.0) < 1e-14
        H = np.concatenate((part.inertia_columns, H), axis=1)
        W = part.field.total(H.T @ block.Y)
        assert np.abs(block.W - 0.5 * (W + W.T)).max() < 1e-13 * np.abs(W).max()
    solver.destroy()


@pytest.mark.smoke
@pytest.mark.mpi
def test_tie_holds_at_the_start_as_built() -> None:
    system, state, _ = scene_of(2, "floating", "absolute", False).build()
    assert np.abs(system.at(0.0, state.q).constraint()).max() < 1e-14


@pytest.mark.mpi
def test_a_shape_that_fails_on_one_rank_is_an_error_on_all() -> None:
    upper, comm = body("floating", "upper", 2), MPI.COMM_WORLD
    scene = fmbd.Scene("fails")

    def shape(x):
        return [][0] if comm.rank == comm.size - 1 else x

    scene.add(upper, fmbd.tie_surface("floor", upper.surface("bottom"), fmbd.ground, shape=shape))
    with pytest.raises(LawError, match='shape of tie "floor" failed: IndexError'):
        scene.build()
    assert len(comm.allgather(None)) == comm.size  # none is left behind


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["absolute", "floating"])
def test_weak_dirichlet_motion_carries_the_body(kind: str) -> None:
    """A clamped block whose floor moves slowly follows it; the traction is the inertia of the block."""
    upper = body(kind, "upper", 2, 3)
    scene = fmbd.Scene("shaken")
    scene.add(upper)
    lift = lambda x: np.stack([0 * x[0], 1 + 0 * x[0]])  # noqa: E731
    law = lambda t: 0.1 * t**4  # noqa: E731
    scene.add(fmbd.tie_surface("floor", upper.surface("bottom"), fmbd.ground, shape=lift, motion=law))
    system, _, _ = scene.build()
    rows = system.block("floor").rows
    scene.sensor("top", fmbd.position(upper.surface("top")))
    run = fmbd.solve(scene, t_end=0.5, dt=0.01)
    assert run["top"][-1][1] - 1.0 == pytest.approx(law(0.5), abs=1e-4)
    tie, _ = system.traces[0]
    mu = tie.multipliers
    force = mu.coupling().sum(axis=1).T @ run.state.lam[rows].reshape(-1, 2)
    assert force[0, 1] == pytest.approx(0.3, rel=0.01)


def test_too_many_multipliers_and_wrong_partners_are_refused() -> None:
    upper = body("absolute", "upper", 2)
    with pytest.raises(InputError, match="with itself"):
        fmbd.tie_surface("loop", upper.surface("top"), upper.surface("top"))
    with pytest.raises(InputError, match="cannot be tied"):
        fmbd.tie_surface("wrong", upper.surface("top"), upper)
    with pytest.raises(InputError, match="needs a shape"):
        fmbd.tie_surface("wrong", upper.surface("top"), fmbd.ground, motion=lambda t: t)
    with pytest.raises(LawError, match='The motion of tie "late" failed at t = 0 s: ZeroDivisionError'):
        fmbd.tie_surface("late", upper.surface("top"), fmbd.ground, shape=lambda x: x, motion=lambda t: 1 / t)


def test_sliding_tie_of_a_curved_surface_is_refused() -> None:
    """The normal of a sliding tie is one vector; a curved surface has none, flat ones at any angle have."""
    disk = fmbd.read_gmsh(ROOT / "meshes/half_ball.py", dim=2, radius=1.0, h=0.3, near=0.5, coarse=0.3)
    curved = fmbd.AbsoluteBody("disk", disk, degree=1, density=1.0, elastic=LAW)
    scene = fmbd.Scene("curved")
    scene.add(curved, fmbd.tie_surface("guide", curved.surface("contact"), fmbd.ground, sliding=True))
    with pytest.raises(InputError, match=r'"guide".*is curved; a sliding tie needs a flat surface'):
        fmbd.solve(scene, t_end=0.1, dt=0.1)


def _tip(partner: str, E: float = 1.0) -> np.ndarray:
    """Path of the near face of a block that hangs on a soft one: rigid, or elastic with modulus E."""
    soft = fmbd.AbsoluteBody(
        "soft", block(2, 4), degree=2, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3)
    )
    scene = fmbd.Scene("hanging", gravity=(0, -1e-3))
    scene.add(soft, fmbd.tie_surface("clamp", soft.surface("left"), fmbd.ground))
    if partner == "rigid":
        other = fmbd.RigidBody("load", 1.0, 1 / 6, position=(1.5, 0.5))
        scene.add(other, fmbd.tie_surface("glue", soft.surface("right"), other))
    else:
        mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", cells=3, origin=(1.0, 0.0))
        other = fmbd.AbsoluteBody("load", mesh, degree=2, density=1.0, elastic=fmbd.materials.linear_elastic(E, 0.3))
        scene.add(other, fmbd.tie_surface("glue", soft.surface("right"), other.surface("left")))
    scene.sensor("tip", fmbd.position(soft.surface("right")))
    return fmbd.solve(scene, t_end=2.0, dt=0.05)["tip"]


def test_rigid_partner_is_the_limit_of_a_stiff_one() -> None:
    rigid = _tip("rigid")
    moved = np.abs(rigid - rigid[0]).max()
    gap = [np.abs(_tip("elastic", E) - rigid).max() / moved for E in (1e2, 1e4)]
    assert gap[0] < 0.1 and gap[1] < gap[0] / 30  # like 1 / E
