"""Own steps of Radau and BDF on elastic fields: calls of compiled code, which asks Python for the factors of each size."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from profiled import calls_of
from test_field_stages import absolute, floating
from tolerance_scenes import fe_crank

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear import frequency_solvers
from fmbd_fenicsx.linear.frequency_solvers import DECADE, SETTLED
from fmbd_fenicsx.schemes.implicit.implicit_stepper import ImplicitStepper
from fmbd_fenicsx.schemes.implicit.step_newton import StepNewton
from fmbd_fenicsx.schemes.multistep.bdf import BDFStepper
from fmbd_fenicsx.schemes.onestep.radau import RadauStepper
from fmbd_fenicsx.system.tangents.jacobian import Jacobian


def pendulum_of(mesh: Any, kind: Any, ramp: float = 0.1, hinges: int = 1) -> fmbd.Scene:
    """A rod on a pin, released under gravity that comes within so many seconds; ``hinges``: of them in one place."""
    rod = kind(mesh)
    dim = rod.dim
    scene = fmbd.Scene("released", gravity=(0.0, -9.81, 0.0)[:dim], gravity_ramp=ramp)
    axis = {} if dim == 2 else {"axis": (0, 0, 1)}
    scene.add(rod)
    for number in range(hinges):
        scene.add(fmbd.revolute(f"pin {number}", fmbd.ground, rod.surface("pin"), center=(0, 0, 0)[:dim], **axis))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    return scene


SAME = {"q": 0.1, "v": 0.5, "a": 20.0, "lam": 20.0}  # of the tolerance, what states may differ by
OWN = (
    fmbd.Radau(3, rtol=1e-6),
    fmbd.Radau(3, fmbd.Index3(), 1e-5),
    fmbd.Radau(3, fmbd.Index2(), 1e-5),
    fmbd.Radau(2, rtol=1e-6),
    fmbd.Radau(2, fmbd.Index3(), 1e-4),
    fmbd.Radau(5, rtol=1e-8),
)


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", OWN, ids=lambda scheme: scheme.name)
@pytest.mark.parametrize(("kind", "dim"), [(floating, 2), (floating, 3), (absolute, 2)])
def test_steps_of_a_size_of_their_own_are_calls_of_compiled_code(
    rod_mesh: Callable[..., Any], kind: Any, dim: int, scheme: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All but those of sizes that come a few times; as many as Python makes, of the same sizes, with the same states."""
    scene = pendulum_of(rod_mesh(dim=dim, h=0.5, height=0.2), kind)
    output = fmbd.Output(every=10**9, progress=False)
    seen: list[tuple[float, float]] = []  # time, and the error of the step that led there
    in_parts = RadauStepper._controlled

    def counted(self: Any, limit: float) -> Any:
        seen.append((self.state.t, self.control.error_old))
        return in_parts(self, limit)

    monkeypatch.setattr(RadauStepper, "_controlled", counted)

    runs, in_python = [], []
    for parts in (False, True):
        seen.clear()
        if parts:
            monkeypatch.setattr(ImplicitStepper, "_march_of", lambda _: None)
        runs.append(fmbd.solve(scene, t_end=0.3, scheme=scheme, output=output))
        in_python.append(np.array(seen))

    fast, slow = runs
    steps = slow.counters["steps"]
    assert len(in_python[1]) == steps
    # those of a size up to the fourth, and two that land on the end
    sizes = len(np.unique(np.round(DECADE * np.log10(np.diff(in_python[1][:, 0])))))
    assert len(in_python[0]) <= min(SETTLED * sizes + 2, 0.4 * steps)
    assert abs(fast.counters["steps"] - steps) <= 1
    for name, share in SAME.items():
        wanted, allowed = getattr(slow.state, name), share * scheme.rtol
        assert getattr(fast.state, name) == pytest.approx(wanted, rel=0, abs=allowed * np.abs(wanted).max()), name
    if fast.counters["steps"] == steps:
        (t, error), told = in_python[0][-2], in_python[1][-2]
        assert (t, error) == pytest.approx(told, rel=1e-3)


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("kind", "dim", "scheme"),
    [
        (floating, 2, fmbd.BDF(rtol=1e-5)),
        (floating, 3, fmbd.BDF(rtol=1e-5)),
        (absolute, 2, fmbd.BDF(1, fmbd.Index3(), 1e-4)),
    ],
    ids=lambda x: getattr(x, "name", getattr(x, "__name__", str(x))),
)
def test_own_steps_of_bdf_are_calls_of_compiled_code(
    rod_mesh: Callable[..., Any], kind: Any, dim: int, scheme: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All but the first, by factors of frequencies that are near: as many as Python makes, with the same states where Newton's
    iteration leaves little.
    """
    scene = pendulum_of(rod_mesh(dim=dim, h=0.5, height=0.2), kind, hinges=2)
    output = fmbd.Output(every=10**9, progress=False)
    made: list[int] = []
    in_parts = BDFStepper._controlled
    monkeypatch.setattr(BDFStepper, "_controlled", lambda *given: (made.append(1), in_parts(*given))[1])
    monkeypatch.setattr(StepNewton, "tolerance", 1e-5)

    fast = fmbd.solve(scene, t_end=0.1, scheme=scheme, output=output)
    assert len(made) <= 2
    monkeypatch.setattr(ImplicitStepper, "_march_of", lambda _: None)
    slow = fmbd.solve(scene, t_end=0.1, scheme=scheme, output=output)
    assert fast.counters["steps"] == slow.counters["steps"] > 50
    assert slow.counters["newton_iterations"] == pytest.approx(fast.counters["newton_iterations"], rel=0.02)
    assert slow.counters["stage_iterations"] <= 0.2 * slow.counters["steps"]  # factors that are near serve without any
    for name, share in SAME.items():
        wanted, allowed = getattr(slow.state, name), 0.01 * share * scheme.rtol
        assert getattr(fast.state, name) == pytest.approx(wanted, rel=0, abs=allowed * np.abs(wanted).max()), name


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("scheme", "hinges", "most"),
    [(fmbd.Radau(3, rtol=1e-7), 1, 40), (fmbd.Radau(3, rtol=1e-7), 2, 40), (fmbd.BDF(rtol=1e-6), 1, 5)],
    ids=str,
)
def test_steps_of_a_size_of_their_own_enter_python_for_factors(
    rod_mesh: Callable[..., Any], scheme: Any, hinges: int, most: int
) -> None:
    """Calls of Python a step, by runs of two lengths: up to 5 000 where Python makes the steps."""
    scene = pendulum_of(rod_mesh(h=0.5, height=0.2), floating, ramp=0.0, hinges=hinges)
    output = fmbd.Output(every=10**9, progress=False)
    found = []
    for t_end in (0.1, 0.3):
        solved = lambda t_end=t_end: fmbd.solve(scene, t_end=t_end, scheme=scheme, output=output)  # noqa: E731
        found.append((calls_of(solved), solved().counters["steps"]))
    (few, short), (many, long) = found
    assert long - short > 50
    assert many - few < most * (long - short)


@pytest.mark.compiled
def test_constraints_are_linearised_in_python_for_new_factors_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a driven crank, whose loads are looked at in 51 instants before the first step: compiled code evaluates these."""
    scene, made = fe_crank(), []
    init = Jacobian.__init__

    def counted(self: Any, ev: Any) -> None:
        made.append(ev.t)
        init(self, ev)

    monkeypatch.setattr(Jacobian, "__init__", counted)
    run = fmbd.solve(
        scene, t_end=0.05, scheme=fmbd.Radau(3, rtol=1e-3), output=fmbd.Output(every=10**9, progress=False)
    )
    assert len(made) <= run.counters["factorisations"] + 4


@pytest.mark.compiled
def test_instants_within_steps_of_several_sizes_bend_no_body(monkeypatch: pytest.MonkeyPatch) -> None:
    """One call makes steps of many sizes: within each, joints are closed by its own matrix. By that of the last, a small one,
    a rod has dents of 6e-5 m.
    """
    monkeypatch.setattr(frequency_solvers, "SETTLED", 0)  # sizes are compiled code's from the first step on
    output = fmbd.Output(times=tuple(np.linspace(0.0, 0.12, 61)), energy=False, progress=False)
    found = fmbd.solve(fe_crank(), t_end=0.12, scheme=fmbd.Radau(3, rtol=3e-3), output=output)
    exact = fmbd.solve(fe_crank(), t_end=0.12, dt=0.12 / 1200, output=output)
    assert np.abs(found["side"] - exact["side"]).max() < 6e-6
