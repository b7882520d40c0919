"""Messages between the ranks: what all bodies have for one purpose goes in one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import ranks
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver

BODIES = 3


@pytest.mark.mpi
def test_ports_of_all_bodies_go_in_one_message(rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a state, of the constraints' matrix, and of the solution of a step, whose residuals are each body's own."""
    scene, last = fmbd.Scene("chain", gravity=(0.0, -9.81)), fmbd.ground
    for k in range(BODIES):
        mesh = rod_mesh(dim=2, h=0.25).placed((float(k), 0.0))
        rod = fmbd.FloatingBody(f"{k}", mesh, density=1e3, elastic=fmbd.materials.plane_stress(5e6, 0.3))
        scene.add(rod, fmbd.revolute(f"pin {k}", last, rod.surface("pin"), center=(float(k), 0.0)))
        last = rod.surface("tip")

    system, state, _ = scene.build()
    solver = StepSolver(system)
    ev = system.at(state.t, state.q, state.v)
    solver.prepare(ev, Weights(1.0, 0.0, 1e-4))
    b, c = np.ones(system.n_v), np.ones(system.n_lam)

    sent: list[int] = []
    send = ranks._of_each
    monkeypatch.setattr(ranks, "_of_each", lambda comm, x: sent.append(np.size(x)) or send(comm, x))
    shared = ranks.world_size() > 1
    for at_most, action in (
        (1, lambda: system.ports(state.q, 0.0)),
        (1, lambda: ev.jacobian.times(b)),
        (BODIES + 2, lambda: solver.solve(b, c)),
    ):
        sent.clear()
        action()
        assert (1 if shared else 0) <= len(sent) <= (at_most if shared else 0)


@pytest.mark.mpi
def test_wires_that_each_rank_holds_whole_count_once(rod_mesh: Callable[..., Any]) -> None:
    """Beside a body that the ranks share."""
    wires = fmbd.Wires("wires", 20.0, 10, (fmbd.Wire(1.0, 1e4),))
    pan = fmbd.CoordinateBody("pan", np.eye(2), lambda q, v, t: np.array([50.0, 0.0]), np.zeros(2))
    rod = fmbd.FloatingBody("rod", rod_mesh(dim=2, h=0.25), density=1e3, elastic=fmbd.materials.plane_stress(5e6, 0.3))
    scene = fmbd.Scene("wires and rod")
    scene.add(rod, wires, pan, fmbd.SlidingContact("slide", wires, pan, start=9.3, idle=1))
    system, state, _ = scene.build()

    k, part = next((k, p) for k, p in system.fields if p.name == "wires")
    q = np.random.default_rng(1).standard_normal(system.n_q)
    own = part.ports_of(system.local_q(q, k), 0.0)
    assert np.abs(own).max() > 0
    np.testing.assert_array_equal(system.ports(q, 0.0)[system.port_slice(k)], own + part.reference)
