"""Support of demo scripts: flags, check lines, JSON, exit code; and no MPI for rigid demos."""

import json
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check

RUN = SimpleNamespace(counters={"steps": 3}, seconds={"total": 0.5}, report=lambda: "3 steps")


def parse(monkeypatch, *words, own=None):
    monkeypatch.setattr(sys, "argv", ["demo.py", *words])
    return demo.arguments("A demo.", own)


def test_check_passes_within_its_tolerance_only():
    assert Check("x", 1.09, 1.0, 0.1).ok
    assert not Check("x", 1.11, 1.0, 0.1).ok
    assert not Check("x", float("nan"), 1.0, 0.1).ok
    assert not Check("x", float("inf"), float("inf"), 1.0).ok
    assert Check.relative("x", 101.0, 100.0, 0.011).ok and not Check.relative("x", -101.0, -100.0, 0.009).ok


def test_check_of_a_bound_from_below():
    assert Check.at_least("order", 2.0, 2.0).ok and Check.at_least("order", 5.0, 2.0).ok
    assert not Check.at_least("order", 1.999, 2.0).ok
    assert not Check.at_least("order", float("inf"), 2.0).ok and not Check.at_least("order", float("nan"), 2.0).ok
    assert str(Check.at_least("order", 1.5, 2.0)) == "check order: 1.5, at least 2: FAILED"


def test_flags_have_types_choices_and_defaults(monkeypatch):
    own = {"--study": False, "--dim": (2, 3), "--dt": 0.1}
    args = parse(monkeypatch, "--dim", "3", "--json", "a.json", own=own)
    assert (args.dim, args.study, args.dt, args.fast, args.picture) == (3, False, 0.1, False, None)
    assert parse(monkeypatch, "--fast", "--study", own=own).study
    with pytest.raises(SystemExit) as stop:
        parse(monkeypatch, "--dim", "4", own=own)
    assert stop.value.code == 2


def test_finish_prints_writes_and_passes(monkeypatch, tmp_path, capsys):
    args = parse(monkeypatch, "--json", str(tmp_path / "r.json"))
    demo.finish([Check("length", np.float64(2.0), 2.0, np.float64(1e-9))], RUN, args)
    assert capsys.readouterr().out.splitlines() == ["3 steps", "check length: 2, reference 2 +- 1e-09: ok"]
    found = json.loads((tmp_path / "r.json").read_text())
    entry = {"name": "length", "value": 2.0, "reference": 2.0, "tolerance": 1e-9, "ok": True}
    assert found == {"check": [entry], "counters": {"steps": 3.0}, "seconds": {"total": 0.5}}


def test_finish_exits_with_1_when_a_check_fails_and_still_writes(monkeypatch, tmp_path, capsys):
    args = parse(monkeypatch, "--json", str(tmp_path / "r.json"))
    with pytest.raises(SystemExit) as stop:
        demo.finish([Check("a", 1.0, 1.0, 0.1), Check("b", 2.0, 1.0, 0.1)], None, args)
    assert stop.value.code == 1
    assert "check b: 2, reference 1 +- 0.1: FAILED" in capsys.readouterr().out
    assert [c["ok"] for c in json.loads((tmp_path / "r.json").read_text())["check"]] == [True, False]


def test_finish_films_a_run_that_moves_and_says_when_there_is_none(monkeypatch, tmp_path, capsys):
    filmed = []
    moving = SimpleNamespace(**vars(RUN), snapshots=[1, 2], animate=lambda file, **look: filmed.append(file.name))
    wanted = ("--animate", str(tmp_path / "a.gif"))
    demo.finish([], moving, parse(monkeypatch, *wanted))
    assert filmed == ["a.gif"]

    # not twice where the demo has made it, and not in silence where nothing moves
    args = parse(monkeypatch, *wanted)
    demo.film(moving, args)
    demo.finish([], None, args)
    assert filmed == ["a.gif"] * 2
    still = SimpleNamespace(**vars(RUN), snapshots=[])
    for run in (still, None):
        with pytest.raises(SystemExit) as stop:
            demo.finish([], run, parse(monkeypatch, *wanted))
        assert stop.value.code == 1 and "keeps no motion to show" in capsys.readouterr().out


def test_demo_support_loads_neither_mpi_nor_dolfinx():
    code = "import sys, fmbd_fenicsx.post.demo; print(sys.modules.keys() & {'mpi4py', 'dolfinx', 'petsc4py'})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_figure_on_its_bound_passes_and_beyond_it_fails() -> None:
    assert Check("release", 1.99, 2.0, 0.01).ok and not Check("release", 1.99 - 1e-13, 2.0, 0.01).ok
    assert not Check("exact", 1e-300, 0.0).ok
