"""Faults on purpose: processes killed, files torn, disks full, permissions lost, signals, ranks that leave or raise.

Run:  ./with-dolfinx python3 tests/faults.py [COUNT]     each kind so many times (100); exit code 1 for a loss

After each fault the run is taken up from what is on the disk, and its record must be that of a run which nothing disturbed, bit
by bit. Children of one process are killed, so that a hundred of them need no hundred imports.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from programs import launch

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CheckpointError

DT, T_END, EVERY = 1e-3, 0.2, 7
RIGHT = "went on"
SECONDS = 120.0  # after which a child counts as one that hangs


# ---------------------------------------------------------------------------------------------------- the run


def links() -> fmbd.Scene:
    """Three links that fall from the horizontal."""
    scene = fmbd.Scene("links", gravity=(0.0, -9.81))
    last: Any = fmbd.ground
    for k in range(3):
        arm = fmbd.RigidBody(f"arm {k}", 1.0, 0.1, position=(k + 0.5, 0.0))
        scene.add(arm, fmbd.revolute(f"pin {k}", last, arm, center=(k, 0.0)))
        last = arm
    scene.sensor("tip", fmbd.position(last))
    return scene


def solved(folder: Path, *, end: float = T_END, **options: Any) -> fmbd.Run:
    """The run, taken up from the newest checkpoint of the folder."""
    plan = fmbd.Checkpoint(folder, every=EVERY)
    scheme = fmbd.GeneralizedAlpha(compiled=False)
    return fmbd.solve(
        links(), t_end=end, dt=DT, scheme=scheme, checkpoint=plan, restart=options.get("restart", plan.newest)
    )


def in_child(action: Callable[[], None], *, death: float | None = None) -> int:
    """Exit code of an action in a process of its own, -9 when it was killed; ``death``: after so many seconds."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            action()
            code = 0
        except BaseException as error:
            code = int(getattr(error, "exit_code", 1))
        finally:
            os._exit(code)
    began = time.monotonic()
    while True:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return os.waitstatus_to_exitcode(status)
        lasted = time.monotonic() - began
        if lasted > min(SECONDS, SECONDS if death is None else death):
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return -signal.SIGKILL if death is not None else 124
        time.sleep(2e-3)


def verdict(folder: Path, whole: np.ndarray) -> str:
    """What comes of a run that is taken up after a fault."""
    if not np.array_equal(solved(folder)["tip"], whole):
        return "lost: another record"
    return RIGHT


# ---------------------------------------------------------------------------------------------------- one process


def kills(folder: Path, count: int) -> Counter[str]:
    """``kill -9`` at a random moment; each run goes on where the one before it was killed, and starts anew when it is done."""
    whole, luck, found = solved(folder / "whole")["tip"], random.Random(1), Counter[str]()
    usual, home, deaths = 0.3, folder / "run", 0
    while deaths < count:
        began = time.monotonic()
        code = in_child(lambda: solved(home) and None, death=luck.uniform(0.01, 0.9) * usual)
        deaths += code == -signal.SIGKILL
        if code == 0:
            usual = min(usual, time.monotonic() - began)
        elif code != -signal.SIGKILL:
            found[f"lost: a restart ended with {code}"] += 1
            shutil.rmtree(home)
        if code == 0 or deaths == count:
            found[verdict(home, whole)] += 1
            shutil.rmtree(home)
    return found + Counter({"killed": deaths})


def damages(folder: Path, count: int) -> Counter[str]:
    """A bit of a file of the newest checkpoint turned, or the file torn; the one before it is then taken."""
    whole, luck, found = solved(folder / "whole")["tip"], random.Random(2), Counter[str]()
    solved(folder / "run", end=0.15)
    for k in range(count):
        home = folder / f"run {k}"
        shutil.copytree(folder / "run", home)
        newest = fmbd.Checkpoint(home).newest
        assert newest is not None
        file = luck.choice(sorted(newest.iterdir()))
        data = bytearray(file.read_bytes())
        at = luck.randrange(len(data))
        if luck.random() < 0.5:
            data = data[:at]
        else:
            data[at] ^= 1 << luck.randrange(8)
        file.write_bytes(bytes(data))
        try:
            same = np.array_equal(solved(home)["tip"], whole)
            found["lost: damage was not seen" if not same else "harmless"] += 1
        except CheckpointError:
            shutil.rmtree(newest)
            found[verdict(home, whole)] += 1
        shutil.rmtree(home)
    return found


def full_disks(folder: Path, count: int) -> Counter[str]:
    """No file may grow beyond a random size; the run must end with 74 and go on when there is room again."""
    whole, luck, found = solved(folder / "whole")["tip"], random.Random(3), Counter[str]()
    for k in range(count):
        home = folder / f"run {k}"
        solved(home, end=DT * luck.randrange(1, 150))
        most = luck.randrange(16, 8192)

        def starved(home: Path = home, most: int = most) -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            solved(home)

        code = in_child(starved)
        found[verdict(home, whole) if code == 74 else f"exit code {code} with a full disk"] += 1
        shutil.rmtree(home)
    return found


def lost_permissions(folder: Path, count: int) -> Counter[str]:
    """The folder may not be written from a random moment on: exit code 74."""
    whole, luck, found = solved(folder / "whole")["tip"], random.Random(4), Counter[str]()
    for k in range(count):
        home, at = folder / f"run {k}", luck.uniform(0.01, 0.15)
        home.mkdir()

        def barred(home: Path = home, at: float = at) -> None:
            def shut(moment: Any) -> None:
                if moment.t > at:
                    home.chmod(0o555)

            if os.getuid() == 0:  # whom no permission stops
                os.chown(home, 65534, 65534)
                folder.chmod(0o777)
                os.setuid(65534)
            plan = fmbd.Checkpoint(home, every=EVERY)
            scheme = fmbd.GeneralizedAlpha(compiled=False)
            fmbd.solve(links(), t_end=T_END, dt=DT, scheme=scheme, checkpoint=plan, output=fmbd.Output(on_step=shut))

        code = in_child(barred)
        home.chmod(0o777)
        found[verdict(home, whole) if code == 74 else f"exit code {code} without permission"] += 1
        shutil.rmtree(home)
    return found


def requests(folder: Path, count: int) -> Counter[str]:
    """SIGUSR1, SIGTERM and SIGINT in one process: 75, 75, 130, and the run goes on."""
    whole, luck, found = solved(folder / "whole")["tip"], random.Random(5), Counter[str]()
    wanted = {signal.SIGUSR1: 75, signal.SIGTERM: 75, signal.SIGINT: 130}
    for k in range(count):
        home, at = folder / f"run {k}", luck.uniform(0.01, 0.15)
        number = list(wanted)[k % 3]

        def asked(home: Path = home, at: float = at, number: signal.Signals = number) -> None:
            sent: list[int] = []

            def ask(moment: Any) -> None:
                if moment.t > at and not sent:
                    sent.append(1)
                    os.kill(os.getpid(), number)

            plan = fmbd.Checkpoint(home, every=EVERY)
            scheme = fmbd.GeneralizedAlpha(compiled=False)
            fmbd.solve(links(), t_end=T_END, dt=DT, scheme=scheme, checkpoint=plan, output=fmbd.Output(on_step=ask))

        code = in_child(asked)
        found[verdict(home, whole) if code == wanted[number] else f"exit code {code} after {number.name}"] += 1
        shutil.rmtree(home)
    return found


# ---------------------------------------------------------------------------------------------------- ranks

PROGRAM = """
import os, signal, sys
from mpi4py import MPI
sys.path.insert(0, "tests")
import fmbd_fenicsx as fmbd
import faults
from fmbd_fenicsx.run.checkpoints import checkpoint
checkpoint.LOOK = 0.0  # the run is short
what, rank, folder = sys.argv[1], int(sys.argv[2]), sys.argv[3]
done = []
def fault(moment):
    if moment.step == 1:
        MPI.COMM_WORLD.Barrier()  # ranks of a scene without fields do not wait for each other
    if moment.t < 0.05 or MPI.COMM_WORLD.rank != rank or done or what == "nothing":
        return
    done.append(1)
    if what == "exits":
        sys.exit(5)
    if what == "raises":
        raise RuntimeError("a rank broke")
    os.kill(os.getpid(), getattr(signal, what))
plan = fmbd.Checkpoint(folder, every=faults.EVERY)
fmbd.solve(faults.links(), t_end=faults.T_END, dt=faults.DT, scheme=fmbd.GeneralizedAlpha(compiled=False),
           checkpoint=plan, restart=plan.newest, output=fmbd.Output(on_step=fault))
"""
# what happens on a rank -> exit codes of the whole; Ctrl-C on several ranks is Open MPI's: it ends them all
ENDS: dict[str, Callable[[int, int], bool]] = {
    "SIGUSR1": lambda code, ranks: code == 75,
    "SIGTERM": lambda code, ranks: code == 75,
    "SIGINT": lambda code, ranks: code == 130 if ranks == 1 else code != 0,
    "SIGKILL": lambda code, ranks: code != 0,
    "exits": lambda code, ranks: code == 5,
    "raises": lambda code, ranks: code == 1,
}


def exit_code(ranks: int, *words: str) -> int:
    """Exit code of the program on so many ranks, 124 for one that hangs."""
    try:
        return launch(PROGRAM, ranks, *words, timeout=SECONDS).returncode
    except subprocess.TimeoutExpired:
        return 124


def on_ranks(folder: Path, most: int) -> Counter[str]:
    """Each fault on the last of 1 ... ``most`` ranks; then one process goes on with what they left."""
    whole, found = solved(folder / "whole")["tip"], Counter[str]()
    for ranks in range(1, most + 1):
        for what, right in ENDS.items():
            home = folder / f"{what} {ranks}"
            code = exit_code(ranks, what, str(ranks - 1), str(home))
            if not right(code, ranks):
                found[f"{what} on {ranks} ranks: exit code {code}"] += 1
                continue
            again = solved(home)["tip"]
            same = np.array_equal(again, whole) if ranks == 1 else np.allclose(again, whole, rtol=0, atol=1e-9)
            found[RIGHT if same else f"lost: {what} on {ranks} ranks"] += 1
    return found


KINDS: dict[str, Callable[[Path, int], Counter[str]]] = {
    "kill -9": kills,
    "torn or flipped files": damages,
    "full disk": full_disks,
    "lost write permission": lost_permissions,
    "signals": requests,
}
FINE = (RIGHT, "harmless", "killed")


def all_of(count: int, ranks: int = 0) -> dict[str, Counter[str]]:
    """Each kind so many times, and each fault on 1 ... ``ranks`` ranks: how often what happened, printed."""
    found = {}
    kinds = {**KINDS, **({"on ranks": on_ranks} if ranks else {})}
    for name, make in kinds.items():
        with tempfile.TemporaryDirectory() as folder:
            found[name] = make(Path(folder), ranks if name == "on ranks" else count)
        print(f"{name}: " + ", ".join(f"{n} {what}" for what, n in found[name].most_common()), flush=True)
    return found


if __name__ == "__main__":
    outcome = all_of(int(sys.argv[1]) if len(sys.argv) > 1 else 100, ranks=3)
    sys.exit(any(what not in FINE for counted in outcome.values() for what in counted))
