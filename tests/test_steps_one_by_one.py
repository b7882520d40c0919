"""Steps that Python makes: what the run adds to each, and that its judges find by one call of C what they find by evaluations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from profiled import calls_of
from test_compiled_evaluation import MAKERS, pair_of
from test_driver import joint_springs, suspended

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.run import time_loop
from fmbd_fenicsx.run.judges.acceptance import Closed
from fmbd_fenicsx.run.judges.energy_check import Watch
from fmbd_fenicsx.run.judges.force_balance import Balanced
from fmbd_fenicsx.run.step_bisection import Judges
from fmbd_fenicsx.schemes.marching import MarchingStepper
from fmbd_fenicsx.schemes.onestep.explicit_limit import spectral_radius
from fmbd_fenicsx.schemes.onestep.rattle import amplification
from fmbd_fenicsx.system.compiled.states.explicit import ExplicitStates
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.lengths import farthest

SCHEMES = [
    fmbd.Rattle(),
    fmbd.HalfExplicit(rtol=None),
    fmbd.ExplicitRungeKutta(rtol=None),
    fmbd.EnergyMomentum(),
    fmbd.BDF(2, rtol=None),
    fmbd.Radau(rtol=None),
]


def driven_rod(dim: int) -> fmbd.Scene:
    """A crank that a motion turns, and a rod on it."""
    scene = fmbd.Scene("driven", gravity=(0.0, -9.81))
    crank, bob = fmbd.RigidBody("crank", 1.0, 0.1, (0.5, 0.0)), fmbd.RigidBody("bob", 1.0, 0.1, (1.5, 0.0))
    hinge = fmbd.revolute("hinge", fmbd.ground, crank, center=(0, 0))
    drive = fmbd.drive("drive", fmbd.angle(hinge), lambda t: 0.3 * np.sin(5 * t) ** 2)
    scene.add(crank, bob, hinge, fmbd.revolute("knee", crank, bob, center=(1, 0)), drive)
    return scene


def named(scheme: Any) -> str:
    return type(scheme).__name__


@pytest.mark.compiled
@pytest.mark.parametrize("name", MAKERS)
def test_a_glance_tells_what_evaluations_do(name: str) -> None:
    plain, driven, (t, q, v, a, lam) = pair_of(MAKERS[name])
    glance = driven.evaluator.glance(driven.row_units, energies=True, balance=True)
    if glance is None:  # whose rows are not all the driver's
        assert not driven.evaluator.same_rows
        return
    for i in range(len(t)):
        seen = glance.of(State(float(t[i]), q[i], v[i], a[i], lam[i]))
        ev = plain.at(float(t[i]), q[i], v[i])
        rows = (ev.constraint(), ev.opening(), ev.constraint_rate())
        wanted = [float((plain.row_units * np.abs(x)).max(initial=0.0)) for x in rows]
        wanted += [farthest(plain, q[i]), plain.max_abs(v[i]), plain.max_abs(a[i])]
        assert seen is not None and list(seen[:6]) == pytest.approx(wanted, rel=1e-11, abs=1e-12)
        sums = ev.balance(a[i], lam[i])
        assert glance.sums == pytest.approx(sums, rel=1e-11, abs=1e-12 * max(1.0, np.abs(sums).max()))
        if glance.energies is not None:
            assert glance.energies == pytest.approx(list(ev.energies().values()), rel=1e-11, abs=1e-12)


@pytest.mark.compiled
@pytest.mark.parametrize("wrong", ["places", "velocities", "accelerations", "multipliers", "energy"])
def test_judges_refuse_by_a_glance_what_they_refuse_by_evaluations(wrong: str) -> None:
    """With the same words; the state of the start passes without one."""
    said = []
    for by_glance in (True, False):
        system, start, _ = joint_springs(2).build()
        solver = StepSolver(system)
        start = fmbd.schemes.consistent.consistent(system, start, solver)[0]
        fmbd.system.compiled.choice.use_driver(system)
        judges = Judges(Closed(system, (0, 1)), Balanced(solver), None)  # type: ignore[arg-type]
        watch = Watch(system, start)
        glance = system.evaluator.glance(judges.closed.units, energies=True, balance=True) if by_glance else None
        for _ in range(2):  # the second time masses are known
            found = judges.look(system, start, 1e-3, glance)
        assert (found is None) == by_glance and watch.gain(start) is None

        parts = {"places": "q", "velocities": "v", "accelerations": "a", "multipliers": "lam"}
        if wrong in parts:
            values = getattr(start, parts[wrong]).copy()
            values[-1] += 0.3 if wrong in ("places", "velocities") else 30.0
            spoilt = State(*(values if x == parts[wrong] else getattr(start, x) for x in ("t", "q", "v", "a", "lam")))
            with pytest.raises(ConvergenceError) as error:
                judges.look(system, spoilt, 1e-3, glance)
            said.append(str(error.value))
            continue
        fast = State(1e-3, start.q, start.v + 1.0, start.a, start.lam)
        if glance is not None:
            glance.of(fast)
        said.append(str(watch.gain(fast, energies=None if glance is None else glance.energies)))
        assert said[-1] != "None"
    assert said[0] == said[1]


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", SCHEMES, ids=named)
def test_the_run_enters_few_functions_a_step(scheme: Any) -> None:
    """Its loop, judges and records, between two records; differences of two lengths, so that the start cancels."""
    output = fmbd.Output(every=1000, progress=False)
    run = lambda steps: fmbd.solve(joint_springs(2), t_end=1e-3 * steps, dt=1e-3, scheme=scheme, output=output)  # noqa: E731
    run(5)
    calls = [calls_of(lambda steps=steps: run(steps), "/fmbd_fenicsx/run/") for steps in (10, 40)]
    marches = isinstance(scheme, fmbd.Rattle | fmbd.HalfExplicit | fmbd.ExplicitRungeKutta | fmbd.EnergyMomentum)
    assert calls[1] - calls[0] <= 30 * (1 if marches else 14)


@pytest.mark.compiled
@pytest.mark.parametrize("make", [joint_springs, suspended, driven_rod], ids=lambda make: make.__name__)
@pytest.mark.parametrize("scheme", SCHEMES[:3], ids=named)
def test_a_step_in_one_call_is_that_in_parts(scheme: Any, make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """RATTLE's whole step, and those of explicit schemes: the same states to roundoff, and as many steps and increments."""
    asked: list[str] = []

    def run(refused: bool) -> fmbd.Run:
        for holder, name in ((MarchingStepper, "_step_in_one_call"), (ExplicitStates, "arrived")):
            one = getattr(holder, name)
            made = lambda self, *given, one=one, name=name, **named: (
                None if refused else (asked.append(name), one(self, *given, **named))[1]
            )  # noqa: E731
            monkeypatch.setattr(holder, name, made)
        monkeypatch.setattr(MarchingStepper, "stride", lambda self, h: 0.0)
        return fmbd.solve(make(2), t_end=0.02, dt=1e-3, scheme=scheme, output=fmbd.Output(progress=False))

    whole, parts = run(False), run(True)
    assert len(asked) >= 20 or not whole.system.n_lam  # nothing to close
    for x in ("q", "v", "a", "lam"):
        found, expected = getattr(whole.state, x), getattr(parts.state, x)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max(initial=0.0)), x
    own = "core_factorisations", "solves"  # each way its own
    assert {k: x for k, x in whole.counters.items() if k not in own} == {
        k: x for k, x in parts.counters.items() if k not in own
    }


@pytest.mark.parametrize("damping", [0.0, 0.3, 5.0])
def test_the_spectral_radius_is_that_of_the_eigenvalues(damping: float) -> None:
    for z in np.geomspace(0.01, 30.0, 40):
        A = amplification(float(z), damping * float(z))
        assert spectral_radius(A) == pytest.approx(np.abs(np.linalg.eigvals(A)).max(), rel=1e-6)


@pytest.mark.parametrize("scheme", SCHEMES, ids=named)
def test_many_steps_between_two_looks_are_those_made_one_by_one(scheme: Any) -> None:
    """To the last bit, with the number of each step; whoever looks at every step sees every step."""
    seen: list[int] = []
    runs = [
        fmbd.solve(joint_springs(2), t_end=0.04, dt=1e-3, scheme=scheme, output=fmbd.Output(progress=False, **given))
        for given in ({"every": 40}, {"every": 7}, {"every": 40, "on_step": lambda now: seen.append(now.step)})
    ]
    assert seen == list(range(1, 41)) and (runs[1].times[1:6] == pytest.approx(7e-3 * np.arange(1, 6)))
    for other in runs[1:]:
        for x in ("q", "v", "a", "lam"):
            assert np.array_equal(getattr(other.state, x), getattr(runs[0].state, x)), x


def test_the_number_of_a_failed_step_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also among many that were to be made in turn."""
    stepper = fmbd.Rattle().stepper
    monkeypatch.setattr(time_loop, "CHUNK", 1e3)

    def failing(*given: Any) -> Any:
        made = stepper(*given)
        advance = made.advance

        def once(h: float) -> State:
            if made.state.t > 0.0175:
                raise ConvergenceError("broken on purpose.")
            return advance(h)

        made.advance, made.stride = once, lambda h: 0.0  # type: ignore[method-assign]
        return made

    monkeypatch.setattr(fmbd.Rattle, "stepper", lambda self, *given: failing(*given))
    with pytest.raises(ConvergenceError, match="step 19 of 40: broken on purpose"):
        fmbd.solve(joint_springs(2), t_end=0.04, dt=1e-3, scheme=fmbd.Rattle(), output=fmbd.Output(every=40))
