"""Many variants of a scene at once are single runs to the last bit."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from chains import chain
from profiled import calls_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.run import variants


def pendulum(length: float) -> fmbd.Scene:
    """A rod on a pin, released from the horizontal."""
    rod = fmbd.RigidBody("rod", 1.0, length**2 / 12, (length / 2, 0.0))
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod, center=(0, 0)))
    scene.sensor("tip", fmbd.position(rod, point=(length, 0.0)))
    return scene


def test_variants_are_single_runs_to_the_last_bit() -> None:
    lengths, settings = [1.0, 0.5, 2.0, 0.7, 1.3], {"t_end": 0.05, "dt": 1e-3}
    found = fmbd.study.map(pendulum, lengths, **settings)

    assert [variant.parameter for variant in found] == lengths
    assert found["tip"].shape == (5, 51, 2)
    for variant, length in zip(found, lengths, strict=True):
        alone = fmbd.solve(pendulum(length), **settings)
        assert np.array_equal(variant["tip"], alone["tip"])
        assert np.array_equal(variant.end[0], alone.state.q)
        assert np.array_equal(variant.end[1], alone.state.v)
        assert np.array_equal(variant.energy["kinetic"], alone.energy["kinetic"])
        assert variant.counters["newton_iterations"] == alone.counters["newton_iterations"]


def test_faults_name_the_variant() -> None:
    def make(length: float) -> fmbd.Scene:
        return pendulum(length if length > 0 else float("nan"))

    with pytest.raises(fmbd.errors.InputError, match="Variant -1"):
        fmbd.study.map(make, [1.0, 0.5, -1.0, 0.7], t_end=0.01, dt=1e-3)
    with pytest.raises(fmbd.errors.InputError, match="no parameters"):
        fmbd.study.map(make, [], t_end=0.01, dt=1e-3)
    with pytest.raises(fmbd.errors.InputError, match="expected a Scene"):
        fmbd.study.map(lambda x: x, [1.0], t_end=0.01, dt=1e-3)
    with pytest.raises(fmbd.errors.InputError, match='No sensor "top"'):
        fmbd.study.map(make, [1.0], t_end=0.01, dt=1e-3)["top"]


def test_failures_are_kept_beside_the_others() -> None:
    def make(length: float) -> fmbd.Scene:
        if length > 5:
            raise ZeroDivisionError("of mine")
        return pendulum(length if length > 0 else float("nan"))

    lengths, settings = [-1.0, 1.0, 0.5, 7.0, -2.0, 0.7], {"t_end": 0.01, "dt": 1e-3}
    found = fmbd.study.map(make, lengths, keep_failures=True, **settings)
    assert [variant.parameter for variant in found.failed] == [-1.0, 7.0, -2.0]
    assert [type(variant.error).__name__ for variant in found.failed] == ["InputError", "LawError", "InputError"]
    assert found["tip"].shape == (6, 11, 2)
    assert np.array_equal(np.isnan(found["tip"][:, -1, 0]), [x < 0 or x > 5 for x in lengths])
    assert np.array_equal(found[5]["tip"], fmbd.solve(pendulum(0.7), **settings)["tip"])
    with pytest.raises(fmbd.errors.InputError, match="Variant -2"):
        found[4]["tip"]
    with pytest.raises(fmbd.errors.InputError, match="Variant -1"):
        fmbd.study.map(make, [-1.0, -2.0], keep_failures=True, **settings)["tip"]


def test_what_a_function_of_an_output_remembers_is_of_all_variants() -> None:
    lengths, seen, steps = [1.0, 0.5, 2.0, 0.7], [], []
    below = fmbd.Event("tip y", -0.1, direction=-1, then=lambda now: seen.append(now.t))
    found = fmbd.study.map(pendulum, lengths, t_end=0.3, dt=1e-2, output=fmbd.Output(events=[below]))
    assert len(seen) == 4 and len(set(seen)) == 4
    assert [variant.status for variant in found] == 4 * ["finished"]
    fmbd.study.map(
        pendulum, lengths, t_end=0.3, dt=1e-2, output=fmbd.Output(on_step=lambda now: steps.append(now.step))
    )
    assert steps == 4 * [*range(1, 31)]


def test_an_interrupt_of_this_process_alone_ends_the_copies(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[int] = []
    start = variants._start

    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    def noted(*given: Any) -> tuple[int, int]:
        started.append(start(*given)[0])
        return started[-1], 0

    monkeypatch.setattr(variants, "cores", lambda: 2)
    monkeypatch.setattr(variants, "_start", noted)
    monkeypatch.setattr(variants, "_answer", interrupted)

    def slow(length: float) -> fmbd.Scene:
        time.sleep(0.0 if length == 1.0 else 600.0)
        return pendulum(length)

    with pytest.raises(KeyboardInterrupt):
        fmbd.study.map(slow, [1.0, 2.0, 3.0], t_end=0.01, dt=1e-3)
    ended = [os.waitpid(child, 0)[1] for child in started]
    assert ended == [signal.SIGKILL, signal.SIGKILL]


def test_variants_say_what_they_state_of_their_errors_and_what_they_have_not() -> None:
    settings: dict[str, Any] = {"t_end": 0.3, "dt": 1e-2, "tol": {"tip": 1e-4}}
    found = fmbd.study.map(pendulum, [1.0, 0.5, 2.0], **settings)
    for variant in found:
        stated = fmbd.solve(pendulum(variant.parameter), **settings).certificate
        assert variant.certificate.statements == stated.statements and stated["tip"].total < 1e-4
        assert variant.warnings == ()
    assert fmbd.study.map(pendulum, [1.0], t_end=0.1, dt=1e-2)[0].certificate is None
    with pytest.raises(AttributeError, match="no 'snapshots': of its run only records are kept. fmbd.solve"):
        print(found[2].snapshots)
    with pytest.raises(fmbd.errors.InputError, match="checkpoints are of one run alone. Loop over solve"):
        fmbd.study.map(pendulum, [1.0, 0.5], checkpoint=fmbd.Checkpoint("kept"), **settings)


def test_other_exceptions_of_a_variant_name_its_parameter() -> None:
    def make(length: float) -> fmbd.Scene:
        if length < 0:
            raise ZeroDivisionError("of mine")
        return pendulum(length)

    for lengths in ([1.0, 0.5, -1.0], [-1.0]):  # in a copy of the process, and in this one
        with pytest.raises(
            fmbd.errors.LawError, match=r"^Variant -1.0: ZeroDivisionError: of mine \(.*, line .*, in make\)$"
        ):
            fmbd.study.map(make, lengths, t_end=0.01, dt=1e-3)


def test_scenes_of_one_structure_share_their_places() -> None:
    from fmbd_fenicsx.system.compiled.tables.matrix_structure import structures_kept
    from fmbd_fenicsx.system.compiled.tables.tables import Tables

    tables = [Tables(pendulum(length).build()[0], redundant=False) for length in (1.0, 0.5, 2.0)]
    assert tables[0].structure is tables[1].structure is tables[2].structure
    assert tables[0].c.front == tables[1].c.front
    assert [batch.at for batch in tables[0].batches] == [batch.at for batch in tables[1].batches]
    assert all(one.P != other.P for one, other in zip(tables[0].batches, tables[1].batches, strict=True))

    twins = fmbd.Scene("two pendulums", gravity=(0, -9.81))
    for k in range(2):
        rod = fmbd.RigidBody(f"rod {k}", 1.0, 0.1, (0.5, 0.0))
        twins.add(rod, fmbd.revolute(f"pin {k}", fmbd.ground, rod, center=(0, 0)))
    assert Tables(twins.build()[0], redundant=False).structure is not tables[0].structure

    # a run that finds its places itself is the same to the last bit
    shared = fmbd.solve(pendulum(1.3), t_end=0.05, dt=1e-3)
    structures_kept.clear()
    assert np.array_equal(fmbd.solve(pendulum(1.3), t_end=0.05, dt=1e-3)["tip"], shared["tip"])


def links(count: int) -> fmbd.Scene:
    """A chain of small links."""
    return chain(count, length=0.1, mass=0.1, inertia=1e-4)[0]


def calls_of_run(make: Callable[[Any], fmbd.Scene], given: Any) -> int:
    """Calls of Python functions from making a scene to the end of a run of few steps; kernels and places are there."""

    def run() -> None:
        fmbd.solve(make(given), t_end=0.01, dt=1e-3, output=fmbd.Output(every=5, progress=False))

    for _ in range(2):
        run()
    return calls_of(run)


def test_a_start_costs_few_calls() -> None:
    """Most of a short run is Python: it was 1 850 calls, and 137 for each further body."""
    assert calls_of_run(pendulum, 1.3) < 1540
    assert (calls_of_run(links, 30) - calls_of_run(links, 10)) / 20 < 122


def test_starts_make_no_matrix_of_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Products with the rows of constraints come without these, which a long chain would fill memory with."""
    from fmbd_fenicsx.system.compiled.states.evaluation import DriverStates
    from fmbd_fenicsx.system.tangents.jacobian import Jacobian

    def refuse(*given: Any) -> None:
        raise AssertionError("rows were made")

    known = fmbd.solve(links(60), t_end=0.01, dt=1e-3).state.q
    monkeypatch.setattr(DriverStates, "rows", refuse)
    monkeypatch.setattr(Jacobian, "__init__", refuse)
    assert np.array_equal(fmbd.solve(links(60), t_end=0.01, dt=1e-3).state.q, known)
