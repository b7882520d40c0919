"""Checkpoints under attack: damaged files, other scenes, full disks, signals, kill -9."""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from programs import ROOT, launch

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CheckpointError, InputError, Stopped
from fmbd_fenicsx.run import compiled_calls
from fmbd_fenicsx.run.checkpoints import archive
from fmbd_fenicsx.schemes import TimeStepper
from fmbd_fenicsx.system.compiled.march import March

pytestmark = pytest.mark.serial


def pendulum(mass: float = 1.0, law: Callable[[float], Any] | None = None, pin: str = "pin") -> fmbd.Scene:
    """A rod on a pin under a load."""
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
    arm = fmbd.RigidBody("arm", mass, 0.1, position=(0.5, 0.0))
    scene.add(arm, fmbd.revolute(pin, fmbd.ground, arm, center=(0, 0)))
    scene.add(fmbd.force("load", arm, law or (lambda t: (0.0, 1.0))))
    scene.sensor("tip", fmbd.position(arm))
    return scene


def run(folder: Path, scene: fmbd.Scene | None = None, **arguments: Any) -> fmbd.Run:
    """A short run with checkpoints at steps 0, 3 and 5, of which two are kept."""
    arguments = {"t_end": 0.05, "dt": 0.01, "checkpoint": fmbd.Checkpoint(folder, every=3)} | arguments
    return fmbd.solve(pendulum() if scene is None else scene, **arguments)


def steps(folder: Path) -> list[int]:
    """Steps of the checkpoints in a folder, oldest first."""
    return [int(p.name.rpartition("_step")[2]) for p in sorted(folder.iterdir()) if not p.name.startswith(".")]


@pytest.fixture
def short_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Calls of compiled code end with the step that they are in, as longer ones do after a tenth of a second."""
    monkeypatch.setattr(compiled_calls, "FIRST", 1)
    monkeypatch.setattr(compiled_calls, "CHUNK", 1e-9)


# -- files -------------------------------------------------------------------------------------------------------
def test_two_are_kept_and_the_newest_is_taken(tmp_path: Path) -> None:
    plan = fmbd.Checkpoint(tmp_path / "deep" / "run", every=3)
    assert plan.newest is None
    first = run(Path(plan.folder))
    assert steps(Path(plan.folder)) == [3, 5]
    assert plan.newest is not None and plan.newest.name.endswith("_step5")
    again = run(Path(plan.folder), restart=plan.newest)  # the run was over: nothing is left to do
    assert np.array_equal(again["tip"], first["tip"]) and again.counters["steps"] == 5


def test_a_run_that_an_event_ended_is_not_taken_past_it(tmp_path: Path) -> None:
    """Started again, it meets the same event; without it, it goes on."""
    low = fmbd.Output(events=[fmbd.Event("tip y", -0.15)])
    first = run(tmp_path, t_end=1.0, output=low)
    again = run(tmp_path, t_end=1.0, output=low, restart=tmp_path)
    assert first.status == again.status == "ended by an event"
    assert np.array_equal(again.times, first.times) and np.array_equal(again["tip"], first["tip"])
    assert again.state.t == first.state.t and again.counters["steps"] == first.counters["steps"]
    longer = run(tmp_path, t_end=1.0, restart=tmp_path)
    assert np.array_equal(longer["tip"], run(tmp_path / "whole", t_end=1.0)["tip"])


def test_a_run_can_be_made_longer(tmp_path: Path) -> None:
    run(tmp_path)
    longer = run(tmp_path, restart=tmp_path, t_end=0.1)
    assert np.array_equal(longer["tip"], run(tmp_path / "whole", t_end=0.1)["tip"])


def test_a_longer_run_has_steps_of_the_same_size(tmp_path: Path) -> None:
    """0.29 / 29 is not 0.01 to the last bit: BDF began anew with another size, and was 1e-6 m off."""
    dt, first, last = 0.01, 0.29, 0.7
    assert first / 29 != dt == last / 70
    steps: dict[str, Any] = {"dt": dt, "scheme": fmbd.BDF(3, rtol=None)}
    run(tmp_path, t_end=first, **steps)
    longer = run(tmp_path, restart=tmp_path, t_end=last, **steps)
    assert np.array_equal(longer["tip"], run(tmp_path / "whole", t_end=last, **steps)["tip"])


@pytest.mark.parametrize("snapshots", [fmbd.PerSecond(50), (0.0, 0.03, 0.07, 0.1)])
def test_a_longer_run_has_all_records_and_snapshots_that_it_asks_for(snapshots: Any, tmp_path: Path) -> None:
    def output(t_end: float) -> fmbd.Output:
        times = np.array([0.0, 0.007, 0.03, 0.05, 0.055, 0.08, 0.1])
        taken = tuple(t for t in snapshots if t <= t_end) if isinstance(snapshots, tuple) else snapshots
        return fmbd.Output(times=times[times <= t_end], snapshots=taken)

    run(tmp_path, output=output(0.05))
    longer = run(tmp_path, restart=tmp_path, t_end=0.1, output=output(0.1))
    whole = run(tmp_path / "whole", t_end=0.1, output=output(0.1))
    assert np.array_equal(longer.times, whole.times)
    assert np.array_equal(longer["tip"], whole["tip"])
    assert [s.t for s in longer.snapshots] == [s.t for s in whole.snapshots]


@pytest.mark.parametrize("began", [True, False])
def test_records_of_another_kind_are_told_of(began: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    at_times, at_steps = {"output": fmbd.Output(times=[0.0, 0.03])}, {}
    run(tmp_path, **(at_times if began else at_steps))
    with caplog.at_level("WARNING", logger="fmbd_fenicsx"):
        run(tmp_path, restart=tmp_path, t_end=0.1, **(at_steps if began else at_times))
    assert f"began with records at {'given times' if began else 'ends of steps'}" in caplog.text


def test_checkpoints_of_an_earlier_run_are_not_touched(tmp_path: Path) -> None:
    run(tmp_path)
    with pytest.raises(InputError, match="holds checkpoints of an earlier run, the newest is 000003_step5"):
        run(tmp_path)
    assert steps(tmp_path) == [3, 5]


def test_no_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=f"no checkpoint in {tmp_path}"):
        run(tmp_path / "new", restart=tmp_path)


@pytest.mark.parametrize("name", [archive.ARRAYS, archive.CONTENT, archive.SUMS])
@pytest.mark.parametrize("harm", ["flip", "cut", "lose"])
def test_damage_is_found_before_anything_is_read(name: str, harm: str, tmp_path: Path) -> None:
    run(tmp_path)
    file = tmp_path / "000003_step5" / name
    data = bytearray(file.read_bytes())
    if harm == "lose":
        file.unlink()
    else:
        data[len(data) // 2] ^= 1
        file.write_bytes(data if harm == "flip" else data[: len(data) // 2])
    with pytest.raises(CheckpointError) as found:
        run(tmp_path, restart=tmp_path / "000003_step5")
    text = str(found.value)
    assert str(file) in text if name != archive.SUMS else str(file.parent) in text
    if name != archive.SUMS and harm != "lose":
        assert archive.sha256(file) in text and "expected SHA-256" in text
    assert found.value.exit_code == 74
    assert run(tmp_path / "other", restart=tmp_path / "000002_step3").status == "finished"


def test_other_version_of_the_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(tmp_path)
    monkeypatch.setattr(archive, "FORMAT", 2)
    with pytest.raises(CheckpointError, match="content.json: expected format 2, found 1"):
        run(tmp_path, restart=tmp_path)


def test_everything_comes_back_as_it_was() -> None:
    tree = {
        "none": None, "flag": True, "text": "µ", "whole": 2**60, "third": 1 / 3, "far": (float("inf"), -0.0),
        "list": [1, (2.0, "x"), []], "array": np.arange(6.0).reshape(2, 3)[:, ::2], "number": np.float64(0.1),
        "bool": np.array([True, False]), "complex": np.array([1j]), "empty": {}, 3: np.zeros((0, 2)),
    }  # fmt: skip
    arrays: dict[str, Any] = {}
    text = json.dumps(archive.pack(tree, arrays))
    back = archive.unpack(json.loads(text), arrays)
    assert list(back) == list(tree)
    for k, x in tree.items():
        assert type(back[k]) is type(x), k
        assert np.array_equal(back[k], x) if isinstance(x, np.ndarray) else back[k] == x, k
    with pytest.raises(TypeError, match="cannot be kept"):
        archive.pack({"x": object()}, {})
    with pytest.raises(TypeError, match="array of objects"):
        archive.pack(np.array([None]), {})


def test_the_page_runs_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    block = (ROOT / "docs/running.md").read_text().split("```python")[1].split("```")[0]
    monkeypatch.chdir(tmp_path)
    runs = []
    for _ in range(2):
        found: dict[str, Any] = {}
        exec(compile(block, "running.md", "exec"), found)
        runs.append(found["run"])
    assert np.array_equal(runs[0]["tip"], runs[1]["tip"]) and steps(tmp_path / "pendulum") == [900, 1000]


def test_a_run_without_checkpoints_loads_nothing_of_them(tmp_path: Path) -> None:
    code = PROGRAM.partition("plan =")[0] + "fmbd.solve(scene, t_end=0.02, dt=0.01)\n"
    names = ("checkpoints.checkpoint", "archive", "fingerprint", "numbering")
    code += f"print([m for m in sys.modules if m.endswith({names})])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=120, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"


# -- the same run? -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "change, text",
    [
        ({"scene": lambda: pendulum(mass=1.1)}, r'bodies "arm".mass: 1.0 in the checkpoint, 1.1 here'),
        (
            {"scene": lambda: pendulum(pin="hinge")},
            r'joints "pin": Joint in the checkpoint, absent here; .*rows: pin \(2\)',
        ),
        ({"scene": lambda: pendulum(law=lambda t: (0.0, 1.001))}, 'forces on "arm" in its state'),
        ({"scheme": fmbd.GeneralizedAlpha(0.7)}, "scheme.rho_inf: 0.8 in the checkpoint, 0.7 here"),
        ({"dt": 0.005}, "step: 0.01 in the checkpoint, 0.005 here.*solve run.next_scene"),
        ({"newton": fmbd.Newton(1e-8)}, "tolerance"),
        ({"output": fmbd.Output(every=2)}, "every"),
    ],
    ids=lambda x: None if isinstance(x, str) else next(iter(x)),
)
def test_another_run_is_refused(change: dict[str, Any], text: str, tmp_path: Path) -> None:
    run(tmp_path)
    if "scene" in change:
        change = {"scene": change["scene"]()}
    with pytest.raises(CheckpointError, match=text):
        run(tmp_path / "other", restart=tmp_path, **change)


def test_another_mesh_and_another_form_are_refused(rod_mesh: Callable[..., Any], tmp_path: Path) -> None:
    def scene(h: float = 0.2, modulus: float = 1e6) -> fmbd.Scene:
        law = lambda u, v, dx: modulus * fmbd.materials.linear_elastic(1.0, 0.3)(u, v, dx)  # noqa: E731
        rod = fmbd.FloatingBody("rod", rod_mesh(h=h), density=1000.0, elastic=law)
        made = fmbd.Scene("rod", gravity=(0, -9.81))
        made.add(rod, fmbd.revolute("pin", rod.surface("pin"), fmbd.ground))
        return made

    run(tmp_path, scene())
    with pytest.raises(CheckpointError, match=r'unknowns of "rod": \d+ in the checkpoint'):
        run(tmp_path / "mesh", scene(h=0.1), restart=tmp_path)
    with pytest.raises(CheckpointError, match='in "rod" in its state are|energies in its state are'):
        run(tmp_path / "form", scene(modulus=1.001e6), restart=tmp_path)


def test_roundoff_in_the_modes_of_a_falling_body_is_no_other_scene(tmp_path: Path) -> None:
    """Forces on its modes are roundoff of its weight, and others where the mesh is another by roundoff."""

    def scene(more: float = 0.0) -> fmbd.Scene:
        mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(0.5, 0.1, 0.08 * (1 + more)), counts=(5, 2, 2))
        block = fmbd.FloatingBody("block", mesh, density=1000.0, elastic=fmbd.materials.linear_elastic(1e7, 0.3))
        made = fmbd.Scene("fall", gravity=(0, 0, -9.81))
        made.add(block.reduced(basis=fmbd.CraigBampton(("left",), 6)))
        return made

    run(tmp_path, scene(), t_end=1e-2)
    first = min(tmp_path.iterdir())
    assert run(tmp_path / "again", scene(1e-14), t_end=1e-2, restart=first).status == "finished"


def test_a_scheme_without_memory(tmp_path: Path) -> None:
    class Own:
        name, order = "own", 1

        def stepper(self, system: Any, solver: Any, newton: Any, state: Any) -> Any:
            return type("OwnStepper", (TimeStepper,), {"state": state})()

    with pytest.raises(InputError, match="OwnStepper does not say what it remembers"):
        run(tmp_path, scheme=Own(), output=fmbd.Output(energy=False))


def test_a_stepper_of_another_kind() -> None:
    class Own:
        name, order = "own", 1

        def stepper(self, *given: Any) -> Any:
            return object()

    with pytest.raises(InputError, match=r"Own.stepper\(...\) must give a time stepper: let builtins.object derive"):
        fmbd.solve(pendulum(), t_end=0.1, dt=0.01, scheme=Own())


# -- disks -------------------------------------------------------------------------------------------------------
def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CheckpointError, match="cannot be written"):
        run(tmp_path / "file")


def test_a_full_disk_leaves_the_last_checkpoint(tmp_path: Path) -> None:
    """The limit on the size of files stands for the disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fills(t: float) -> tuple[float, float]:
        if t > 0.035:
            resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
        return (0.0, 1.0)

    try:
        with pytest.raises(CheckpointError, match="000003_step5 could not be written: File too large") as found:
            run(tmp_path, pendulum(law=fills))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert found.value.exit_code == 74
    assert steps(tmp_path) == [0, 3] and not list(tmp_path.glob(".*"))
    run(tmp_path, restart=tmp_path)


# -- requests to stop --------------------------------------------------------------------------------------------
def asking(folder: Path, how: str) -> Callable[[float], tuple[float, float]]:
    """A load that asks the run to stop at t = 0.035 s."""
    asked: list[float] = []

    def law(t: float) -> tuple[float, float]:
        if t > 0.035 and not asked:
            asked.append(t)
            if how == "file":
                (folder / "STOP").touch()
            else:
                os.kill(os.getpid(), getattr(signal, how))
        return (0.0, 1.0)

    return law


@pytest.mark.parametrize("how, code", [("file", 75), ("SIGUSR1", 75), ("SIGTERM", 75), ("SIGINT", 130)])
@pytest.mark.usefixtures("short_calls")
def test_a_run_that_is_asked_to_stop_can_go_on(
    how: str, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fmbd_fenicsx.run.checkpoints.checkpoint.LOOK", 0.0)
    plan = fmbd.Checkpoint(tmp_path / "run")
    whole = run(tmp_path / "whole")
    with pytest.raises(Stopped) as found:
        run(tmp_path / "run", pendulum(law=asking(tmp_path / "run", how)), checkpoint=plan)
    assert found.value.exit_code == code and found.value.run.status == "stopped"
    assert found.value.run.counters["steps"] == 4 and steps(tmp_path / "run") == [0, 4]
    assert np.array_equal(run(tmp_path / "run", restart=plan.newest)["tip"], whole["tip"])
    assert signal.getsignal(signal.SIGUSR1) == signal.SIG_DFL and not (tmp_path / "run" / "STOP").exists()


@pytest.mark.usefixtures("short_calls")
def test_by_the_clock(tmp_path: Path) -> None:
    run(tmp_path, checkpoint=fmbd.Checkpoint(tmp_path, seconds=1e-9, keep=10))
    assert steps(tmp_path) == [0, 1, 2, 3, 4, 5]


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("scheme", "dt"), [(fmbd.GeneralizedAlpha(), 1e-3), (fmbd.Rattle(), 1e-3), (fmbd.Radau(rtol=1e-9), None)]
)
def test_steps_between_checkpoints_are_made_in_one_call(
    scheme: Any, dt: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many as without checkpoints, but for those in which a call ends at one; with the same record to the last bit."""
    calls: list[int] = []
    march = March.steps
    monkeypatch.setattr(March, "steps", lambda *x, **y: (found := march(*x, **y), calls.append(found[0]))[0])
    monkeypatch.setattr(compiled_calls, "CHUNK", 1e3)  # whatever else the machine does

    def found(plan: fmbd.Checkpoint | None) -> tuple[Any, int]:
        calls.clear()
        return fmbd.solve(pendulum(), t_end=1.0, dt=dt, scheme=scheme, checkpoint=plan)["tip"], len(calls)

    alone, kept = found(None), found(fmbd.Checkpoint(tmp_path, every=40))
    assert np.array_equal(alone[0], kept[0])
    assert kept[1] <= alone[1] + len(alone[0]) // 40 * 3


@pytest.mark.parametrize("wrong", [{"every": 0}, {"keep": 0}, {"seconds": 0.0}])
def test_refused(wrong: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"Checkpoint: {next(iter(wrong))} = 0"):
        replace(fmbd.Checkpoint(tmp_path), **wrong)


# -- whole programs ----------------------------------------------------------------------------------------------
PROGRAM = """
import sys, numpy as np, fmbd_fenicsx as fmbd
scene = fmbd.Scene("links", gravity=(0, -9.81))
last, side = fmbd.ground, 0.0
for k in range(3):
    arm = fmbd.RigidBody(f"arm {k}", 1.0, 0.1, position=(side + 0.5, 0.0))
    scene.add(arm, fmbd.revolute(f"pin {k}", last, arm, center=(side, 0)))
    last, side = arm, side + 1.0
scene.sensor("tip", fmbd.position(last))
plan = fmbd.Checkpoint(sys.argv[1], every=int(sys.argv[2]))
print("ready", flush=True)
run = fmbd.solve(scene, t_end=float(sys.argv[3]), dt=1e-3, scheme=fmbd.GeneralizedAlpha(compiled=False), checkpoint=plan,
                 restart=plan.newest)
np.save(sys.argv[4], run["tip"])
"""


def start(*words: Any) -> subprocess.Popen[str]:
    child = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip
    assert child.stdout is not None and child.stdout.readline() == "ready\n"
    return child


def killed(folder: Path, times: int, t_end: float) -> None:
    """Kill a program at random moments; each time it goes on from the newest checkpoint; the figures are those of one run."""
    whole = start(folder / "whole", 1000, t_end, folder / "whole.npy")
    luck = random.Random(1)
    deaths, began = 0, time.monotonic()
    while True:
        child = start(folder / "run", 7, t_end, folder / "run.npy")
        if deaths < times:
            time.sleep(luck.uniform(0.02, 0.3))
            child.kill()
            deaths += child.wait() == -signal.SIGKILL
        out, err = child.communicate()
        assert child.returncode in (0, -signal.SIGKILL), err
        if child.returncode == 0:
            break
        assert time.monotonic() - began < 200 + 5 * times
    assert deaths == times
    assert whole.wait() == 0
    assert np.array_equal(np.load(folder / "run.npy"), np.load(folder / "whole.npy"))


def test_killed_at_random_moments(tmp_path: Path) -> None:
    killed(tmp_path, 3, 1.2)


@pytest.mark.slow
def test_killed_fifty_times(tmp_path: Path) -> None:
    killed(tmp_path, 50, 8.0)


def test_a_stopped_program_prints_its_report_and_exits_with_75(tmp_path: Path) -> None:
    child = start(tmp_path / "run", 100, 1000.0, tmp_path / "run.npy")
    plan, until = fmbd.Checkpoint(tmp_path / "run"), time.monotonic() + 60
    while (plan.newest is None or "step0" in plan.newest.name) and time.monotonic() < until:
        time.sleep(0.05)  # until it marches: before, the signal is the system's
    child.send_signal(signal.SIGUSR1)
    out, err = child.communicate(timeout=60)
    assert child.returncode == 75, err
    assert "stopped at t =" in out and "Traceback" not in err
    assert fmbd.Checkpoint(tmp_path / "run").newest is not None


RANKS = """
import os, signal, sys
from mpi4py import MPI
sys.path.insert(0, "tests")
import fmbd_fenicsx as fmbd
from checkpoint_scenes import floating
scene, arguments = floating()
def law(t):
    if t > 0.015 and MPI.COMM_WORLD.rank == 1:
        os.kill(os.getpid(), signal.SIGUSR1)
    return (0.0, 0.0)
scene.add(fmbd.force("load", scene.bodies["bob"], law))
fmbd.solve(scene, **arguments, checkpoint=fmbd.Checkpoint(sys.argv[1]))
"""


@pytest.mark.slow
def test_one_rank_asks_and_all_stop_after_the_same_step(tmp_path: Path) -> None:
    done = launch(RANKS, 2, str(tmp_path))
    assert done.returncode == 75, done.stderr
    assert steps(tmp_path) == [0, 4] and "stopped at t =" in done.stdout
