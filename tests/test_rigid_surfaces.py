"""Surfaces that move as rigid ones, with a large rotation of their own."""

from __future__ import annotations

import numpy as np
import pytest
from test_traces import ROOT

import fmbd_fenicsx as fmbd

KEPT = fmbd.Continuous(ends=fmbd.Ends.KEPT)


def face_points(run, body, trace) -> np.ndarray:
    """Places of the nodes of a surface at the end of a run, world axes, (n, d)."""
    part = next(p for p in run.system.parts if p.name == body.name)
    k = list(run.system.parts).index(part)
    d = trace.dim
    ev = run.system.at(run.state.t, run.state.q, run.state.v)
    U = trace.values(run.system.local_q(run.state.q, k).reshape(-1, d))
    return ev.pose[part.frame, :d] + (trace.points - part.origin + U) @ ev.rotation[part.frame].T


@pytest.mark.mpi
@pytest.mark.parametrize("dim, frame", [(2, fmbd.MeanAxis()), (2, fmbd.Attached("left")), (3, fmbd.MeanAxis())])
def test_face_tied_to_a_rigid_body_turns_with_it(dim: int, frame) -> None:
    """A soft block and a small plate on its face, spinning freely by more than half a turn: the face stays as it was, the
    plate's rotation is its own, momentum and energy stay."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0,) * dim, cells=3 if dim == 2 else 2)
    law, spin = fmbd.materials.linear_elastic(200.0, 0.3), 1.0
    push = lambda x: np.stack([0.3 * x[0] * x[1], 0.0 * x[0], 0.0 * x[0]][:dim])  # noqa: E731
    block = fmbd.FloatingBody(
        "block", mesh, degree=1, density=1.0, elastic=law, frame=frame, displacement_rate=push,
        angular_velocity=spin if dim == 2 else (0, 0, spin), velocity=(0.0,) * dim,
    )  # fmt: skip
    center = np.array((1.0, 0.5, 0.5)[:dim])
    arm = center - 0.5
    plate = fmbd.RigidBody(
        "plate", 0.1, 0.01 if dim == 2 else (0.01, 0.006, 0.006), position=center,
        velocity=(-spin * arm[1], spin * arm[0], 0.0)[:dim], angular_velocity=spin if dim == 2 else (0, 0, spin),
    )  # fmt: skip
    scene = fmbd.Scene("spinning")
    scene.add(block, plate, fmbd.tie_surface("glue", block.surface("right"), plate, space=KEPT))
    scene.sensor("turn", fmbd.rotation(plate))
    start, run = fmbd.solve(scene, t_end=1e-6, dt=1e-6), fmbd.solve(scene, t_end=3.5, dt=0.02)
    part = next(p for p in run.system.parts if p.name == "block")
    from fmbd_fenicsx.fem.traces.traces import trace_of

    trace = trace_of(part.field.space, mesh, "right")
    x = face_points(run, block, trace)
    away = lambda y: np.linalg.norm(y[:, None] - y[None], axis=2)  # noqa: E731
    assert np.abs(away(x) - away(trace.points)).max() < 1e-9
    turned = run["turn"][-1]
    R = (
        turned.reshape(3, 3)
        if dim == 3
        else np.array([[np.cos(turned[0]), -np.sin(turned[0])], [np.sin(turned[0]), np.cos(turned[0])]])
    )
    assert R[0, 0] < -0.5  # more than 120 degrees
    assert np.abs((trace.points - trace.points[0]) @ R.T - (x - x[0])).max() < 1e-9
    p0, L0 = start.system.at(start.state.t, start.state.q, start.state.v).momenta()
    p1, L1 = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
    # an attached frame rides on vibrations that the step does not resolve: 5e-3 falls like dt^2 from dt = 0.005 on
    assert (
        np.abs(p1 - p0).max() < (1e-6 if frame == fmbd.MeanAxis() else 5e-3) * np.abs(p0).max()
        and np.abs(L1 - L0).max() < 1e-3 * np.abs(L0).max()
    )
