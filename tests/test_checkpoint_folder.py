"""A folder of checkpoints: one run at a time, nothing of the user's removed, runs that end where they should."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from programs import launch

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CheckpointError
from fmbd_fenicsx.run.checkpoints import archive
from fmbd_fenicsx.run.checkpoints.folder_lock import FolderLock

pytestmark = pytest.mark.serial


def swing() -> fmbd.Scene:
    bar = fmbd.RigidBody("bar", 2.0, 0.3, position=(0.4, 0.0))
    scene = fmbd.Scene("swing", gravity=(0.0, -9.81))
    scene.add(bar, fmbd.revolute("hinge", fmbd.ground, bar, center=(0.0, 0.0)))
    scene.sensor("end", fmbd.position(bar))
    return scene


def kept(folder: Path, **options: Any) -> fmbd.Run:
    return fmbd.solve(swing(), t_end=0.3, dt=0.02, checkpoint=fmbd.Checkpoint(folder, every=4), **options)


@pytest.mark.parametrize("end", [0.02, 0.1, 0.28])
def test_restart_with_a_smaller_end_is_the_finished_run(tmp_path: Path, end: float) -> None:
    whole = kept(tmp_path)
    again = fmbd.solve(swing(), t_end=end, dt=0.02, restart=tmp_path)
    assert again.status == "finished"
    assert np.array_equal(again["end"], whole["end"])


@pytest.mark.parametrize("name", [".notes_step", ".x_step7", ".000003_step9", "..._step1", ".000003_step9.mine"])
def test_folders_of_the_user_stay(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / name / "thesis").write_text("mine")
    kept(tmp_path)
    assert (tmp_path / name / "thesis").read_text() == "mine"


def test_what_a_killed_run_left_is_removed(tmp_path: Path) -> None:
    for name in (".000007_step12.writing", ".000003_step9.removed"):
        (tmp_path / name).mkdir()
    kept(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["000004_step12", "000005_step15"]


def test_folder_in_use_is_refused_and_says_by_whom(tmp_path: Path) -> None:
    lock = FolderLock(tmp_path)
    with pytest.raises(CheckpointError, match=rf"in use by another run: process {os.getpid()} on"):
        kept(tmp_path)
    lock.release()
    assert kept(tmp_path).status == "finished"
    assert kept(tmp_path, restart=tmp_path).status == "finished"  # free again after each run


def hostile(folder: Path, how: str) -> None:
    """Change a checkpoint, with hashes that fit again."""
    content, arrays = folder / archive.CONTENT, folder / archive.ARRAYS
    given = json.loads(content.read_text())
    if how == "deep":
        content.write_text('{"format": 1, "given": {}, "tree": ' + '{"list": [' * 5000 + "]}" * 5000 + "}")
    elif how == "no zip":
        arrays.write_bytes(b"PK\x03\x04 and no more")
    elif how == "compressed":
        np.savez_compressed(arrays, a0=np.zeros(1000))
    elif how == "fifo":
        content.unlink()
        os.mkfifo(content)
        return
    else:
        changed = {"no tree": {"format": 1}, "list": [], "other tree": {**given, "tree": {"dict": []}}, "word": "x"}
        kinds = {
            "odd kind": {**given, "tree": {"who": 1}},
            "no array": {**given, "tree": {"dict": [["q", {"array": "a99"}]]}},
        }
        content.write_text(json.dumps((changed | kinds)[how]))
    sums = "".join(f"{archive.sha256(folder / n)}  {n}\n" for n in (archive.ARRAYS, archive.CONTENT))
    (folder / archive.SUMS).write_text(sums)


@pytest.mark.parametrize(
    "how", ["deep", "no zip", "compressed", "fifo", "no tree", "list", "other tree", "word", "odd kind", "no array"]
)
def test_hostile_checkpoint_is_one_error(tmp_path: Path, how: str) -> None:
    kept(tmp_path)
    hostile(tmp_path / "000005_step15", how)
    with pytest.raises(CheckpointError):
        fmbd.solve(swing(), t_end=0.3, dt=0.02, restart=tmp_path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
@pytest.mark.parametrize("how", ["torn", "flipped"])
@pytest.mark.parametrize("file", [archive.SUMS, archive.CONTENT, archive.ARRAYS])
def test_torn_and_flipped_files_are_seen(tmp_path: Path, file: str, how: str, share: float) -> None:
    """And the checkpoint before them is still good."""
    kept(tmp_path)
    path = tmp_path / "000005_step15" / file
    data = bytearray(path.read_bytes())
    at = int(share * len(data))
    if how == "torn":
        data = data[:at]
    else:
        data[at] ^= 0x10
    path.write_bytes(bytes(data))
    with pytest.raises(CheckpointError):
        fmbd.solve(swing(), t_end=0.3, dt=0.02, restart=tmp_path)
    shutil.rmtree(tmp_path / "000005_step15")
    assert fmbd.solve(swing(), t_end=0.3, dt=0.02, restart=tmp_path).status == "finished"


@pytest.mark.parametrize(
    "line, code",
    [
        ("fmbd.RigidBody('b', 'heavy', 1.0)", 2),
        ("raise fmbd.errors.ConvergenceError('x')", 71),
        ("raise fmbd.errors.CheckpointError('x')", 74),
        ("1 / 0", 1),
        ("sys.exit(9)", 9),
    ],
)
def test_exit_codes_of_serial_runs(line: str, code: int) -> None:
    script = f"import sys\nimport fmbd_fenicsx as fmbd\n{line}\n"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == code, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("rank", [0, 1])
def test_rank_that_leaves_ends_the_others(rank: int) -> None:
    script = (
        "import sys\nimport fmbd_fenicsx as fmbd\nfrom mpi4py import MPI\n"
        f"if MPI.COMM_WORLD.rank == {rank}:\n    sys.exit(5)\nMPI.COMM_WORLD.barrier()\n"
    )
    done = launch(script, 2, timeout=60)
    assert done.returncode != 0
