"""Checkpoints: a run that is taken up goes on bit by bit, on other ranks to roundoff; files are complete or not there."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import checkpoint_scenes
import numpy as np
import pytest
from checkpoint_scenes import SCENES, links, soft, wheel
from programs import launch
from rank_scenes import largest_difference
from test_field_stages import pendulum
from test_own_tangents import blocks as rubbing_blocks

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.ranks import world_size
from fmbd_fenicsx.run.checkpoints.progress import remember_solver
from fmbd_fenicsx.system.serialisation import Memory

SCHEMES: dict[str, Any] = {
    "compiled": fmbd.GeneralizedAlpha(0.8),
    "NumPy": fmbd.GeneralizedAlpha(0.8, compiled=False),
    "GGL": fmbd.GeneralizedAlpha(0.8, form=fmbd.GGL()),
    "Radau": fmbd.Radau(rtol=1e-6),
    "Radau, constant": fmbd.Radau(rtol=None),
    "BDF": fmbd.BDF(rtol=1e-6),
    "BDF, constant": fmbd.BDF(order=3, rtol=None),
    "RATTLE": fmbd.Rattle(),
    "explicit": fmbd.ExplicitRungeKutta(rtol=1e-6),
    "half-explicit": fmbd.HalfExplicit(rtol=1e-6),
    "half-explicit, constant": fmbd.HalfExplicit(rtol=None),
    "energy-momentum": fmbd.EnergyMomentum(),
}


def assert_same(whole: fmbd.Run, taken_up: fmbd.Run) -> None:
    """Equal to the last bit: state, series, energies, counts."""
    for name in ("t", "q", "v", "a", "lam"):
        assert np.array_equal(getattr(whole.state, name), getattr(taken_up.state, name)), name
    assert np.array_equal(whole.times, taken_up.times)
    for name in whole.series:
        assert np.array_equal(whole[name], taken_up[name]), name
    for name in whole.energy:
        assert np.array_equal(whole.energy[name], taken_up.energy[name]), name
    assert whole.drift == taken_up.drift and whole.local_error == taken_up.local_error
    assert len(whole.snapshots) == len(taken_up.snapshots)
    for s, r in zip(whole.snapshots, taken_up.snapshots, strict=True):
        assert np.array_equal(s.q, r.q)
    free = {"core_factorisations", "worst_linear_residual", "back_solves", "back_solves_per_step"}
    assert {k: n for k, n in whole.counters.items() if k not in free} == {
        k: n for k, n in taken_up.counters.items() if k not in free
    }


def at_every_step(make: Callable[[], fmbd.Scene], folder: Path, steps: tuple[int, ...], **arguments: Any) -> fmbd.Run:
    """A run, and the same run taken up after each of some steps."""
    whole = fmbd.solve(make(), **arguments)
    kept = fmbd.solve(make(), **arguments, checkpoint=fmbd.Checkpoint(folder, every=1, keep=1000))
    assert_same(whole, kept)
    for step in steps:
        found = next(folder.glob(f"*_step{step}"))
        assert_same(whole, fmbd.solve(make(), **arguments, restart=found))
    return whole


@pytest.mark.parametrize("name", SCHEMES)
def test_schemes_go_on_to_the_last_bit(name: str, tmp_path: Path) -> None:
    scene = links if name == "compiled" else wheel
    whole = at_every_step(
        lambda: scene()[0],
        tmp_path,
        (1, 2, 5),
        t_end=0.08,
        dt=0.01,
        scheme=SCHEMES[name],
        output=fmbd.Output(snapshots=3),
    )
    if name == "compiled":
        assert whole.counters["compiled_steps"] > 5
    else:
        assert whole["turn"][-1, 0] > 2 * np.pi


def test_step_control_goes_on(tmp_path: Path) -> None:
    """Through steps that are refused: the next step depends on the last two."""
    whole = at_every_step(lambda: links()[0], tmp_path, (5, 11), t_end=1.5, scheme=fmbd.Radau(rtol=1e-3))
    assert whole.counters["rejections"] > 1


def test_slopes_that_a_tangent_has_of_friction_go_on(tmp_path: Path) -> None:
    """What has come loose is told from what sticks by them: without, an end was off by 5e-12 m, of BDF by 0.2 mm."""
    steps: dict[str, Any] = {"t_end": 0.4, "dt": 0.01, "scheme": fmbd.Radau(rtol=None)}
    at_every_step(lambda: rubbing_blocks(2, 1e-7), tmp_path, (25, 33), **steps)


def test_slopes_that_a_tangent_has_of_laws_in_python_go_on(tmp_path: Path) -> None:
    """What steps are tried where a rope goes slack hangs on them: without, a run took 200 steps in place of 190."""

    def make() -> fmbd.Scene:
        ball = fmbd.RigidBody("ball", 1.0, 0.1, (0.0, -1.0), velocity=(1.0, 0.0))
        scene = fmbd.Scene("rope", gravity=(0.0, -9.81))

        def pull(s: Any, rate: Any, t: Any) -> Any:
            return 2e3 * np.maximum(s - 0.9, 0.0) + 5.0 * rate * (s > 0.9)

        scene.add(ball, fmbd.Spring("rope", fmbd.ground, ball, (0, 0), (0, -0.8), law=pull))
        scene.sensor("ball", fmbd.position(ball))
        return scene

    at_every_step(make, tmp_path, (13, 52, 91), t_end=1.0, scheme=fmbd.Radau(rtol=1e-6))


@pytest.mark.parametrize(
    "name, scheme",
    [
        ("floating", fmbd.Radau(rtol=None)),
        ("floating", fmbd.Radau(rtol=1e-4)),
        ("floating", fmbd.BDF(rtol=1e-4)),
        ("rubber", fmbd.Radau(rtol=1e-4)),
    ],
)
def test_implicit_steps_of_elastic_fields_go_on(name: str, scheme: Any, tmp_path: Path) -> None:
    """With frequencies whose factors pay, real and complex, past values, and starts by the matrix of the step before."""
    scene, _ = SCENES[name]()
    steps: dict[str, Any] = {"t_end": 0.04, "dt": 0.004}
    whole = fmbd.solve(scene, **steps, scheme=scheme, checkpoint=fmbd.Checkpoint(tmp_path, every=1, keep=1000))
    for step in (3, 8):
        taken_up = fmbd.solve(scene, **steps, scheme=scheme, restart=next(tmp_path.glob(f"*_step{step}")))
        # factors that were kept for other sizes are made again
        assert np.array_equal(whole.times, taken_up.times)
        assert np.array_equal(whole["tip"], taken_up["tip"])
        assert np.array_equal(whole.state.lam, taken_up.state.lam)


def test_new_tangents_of_fields_come_in_any_call(rod_mesh: Callable[..., Any], tmp_path: Path) -> None:
    """Between steps of one call of compiled code as between calls: the step that followed was made by Python, 2e-13 m off."""
    steps: dict[str, Any] = {"t_end": 0.25, "scheme": fmbd.Radau(2, rtol=1e-4)}
    at_every_step(lambda: pendulum(rod_mesh(h=0.5), "absolute", E=1e6), tmp_path, (), **steps)


def test_the_rate_of_newtons_iteration_goes_on(tmp_path: Path) -> None:
    """At a loose tolerance a step takes one or two increments, as the rate of the step before tells."""
    scheme = fmbd.GeneralizedAlpha(0.8, compiled=False)
    at_every_step(lambda: links()[0], tmp_path, (2, 4, 6), t_end=0.08, dt=0.01, scheme=scheme, newton=fmbd.Newton(1e-3))


@pytest.mark.parametrize("name", [n for n in SCENES if n not in ("links", "wheel")])
def test_bodies_and_contacts_go_on_to_the_last_bit(name: str, tmp_path: Path) -> None:
    scene, arguments = SCENES[name]()
    steps = round(arguments["t_end"] / arguments["dt"])
    at_every_step(lambda: scene, tmp_path, (1, steps // 2 - 1, steps - 1), **arguments)


def test_a_tangent_found_indefinite_is_remembered() -> None:
    """A compressed body is factored by LDL^T from then on, after a restart too."""

    def worker() -> tuple[Any, Any, StepSolver]:
        system, state, _ = soft()[0].build()
        solver = StepSolver(system)
        solver.prepare(system.at(state.t, state.q, state.v), Weights(1.0, 0.1, 0.01))
        return system, state, solver

    system, state, solver = worker()
    system.fields[0][1].field.indefinite = True
    written = Memory(system)
    remember_solver(solver, written, state)
    system, state, solver = worker()
    assert not system.fields[0][1].field.indefinite
    remember_solver(solver, Memory(system, written.values), state)
    assert system.fields[0][1].field.indefinite


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["floating", "past", "modes", "rubber", "glued", "impact, midpoint"])
def test_on_another_number_of_ranks(name: str, shared_tmp: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From one rank to all, and from all to one."""
    if world_size() == 1:
        pytest.skip("needs several ranks")
    from mpi4py import MPI

    wholes, halves = [], []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        monkeypatch.setattr(checkpoint_scenes, "COMM", comm)
        scene, arguments = SCENES[name]()
        folder = shared_tmp / f"from {comm.size}"
        wholes.append(fmbd.solve(scene, **arguments, checkpoint=fmbd.Checkpoint(folder, every=4)))
        MPI.COMM_WORLD.barrier()
        halves.append(next(folder.glob("*_step4")))
    for comm, whole, half in zip((MPI.COMM_WORLD, MPI.COMM_SELF), wholes, halves, strict=True):
        monkeypatch.setattr(checkpoint_scenes, "COMM", comm)
        scene, arguments = SCENES[name]()
        taken_up = fmbd.solve(scene, **arguments, restart=half)
        for sensor in scene.sensors:
            before, after = whole[sensor], taken_up[sensor]
            if sensor == "pressure":  # in the order of the candidates
                before, after = (
                    x[:, np.argsort(r.state.contact.x[:, 0])] for x, r in ((before, whole), (after, taken_up))
                )
            assert np.abs(before - after).max() < 1e-9 * np.abs(before).max(), sensor
        kinetic = whole.energy["kinetic"], taken_up.energy["kinetic"]
        assert np.abs(kinetic[0] - kinetic[1]).max() < 1e-9 * kinetic[0].max()


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.timeout(2400)
@pytest.mark.parametrize("writers, readers", [(1, 2), (2, 1), (2, 3)])
def test_every_scene_on_other_ranks(writers: int, readers: int, tmp_path: Path) -> None:
    code = Path(checkpoint_scenes.__file__).read_text().replace("__file__", repr(checkpoint_scenes.__file__))
    whole, taken_up = (
        json.loads(launch(code, n, str(tmp_path), *more, timeout=1200).stdout.splitlines()[-1])
        for n, more in ((writers, ()), (readers, ("from",)))
    )
    for name in whole:
        assert largest_difference(whole[name], taken_up[name]) < 1e-9, name
