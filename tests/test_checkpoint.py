"""Checkpoints: a run that is taken up goes on bit by bit, on other ranks to roundoff; files are complete or not there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checkpoint_scenes import SCENES, links, wheel

import fmbd_fenicsx as fmbd

SCHEMES: dict[str, Any] = {
    "compiled": fmbd.GeneralizedAlpha(0.8),
    "NumPy": fmbd.GeneralizedAlpha(0.8, compiled=False),
    "GGL": fmbd.GeneralizedAlpha(0.8, form=fmbd.GGL()),
    "Radau": fmbd.Radau(rtol=1e-6),
    "Radau, constant": fmbd.Radau(rtol=None),
    "BDF": fmbd.BDF(rtol=1e-6),
    "BDF, constant": fmbd.BDF(order=3, rtol=None),
    "RATTLE": fmbd.Rattle(),
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


@pytest.mark.parametrize("name", [n for n in SCENES if n not in ("links", "wheel")])
def test_bodies_and_contacts_go_on_to_the_last_bit(name: str, tmp_path: Path) -> None:
    scene, arguments = SCENES[name]()
    at_every_step(lambda: scene, tmp_path, (1, 3), **arguments)
