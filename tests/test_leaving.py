"""Behaviour at the top of a program: Ctrl-C in a serial run, a failing rank under mpirun."""

import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from programs import ROOT, launch

from fmbd_fenicsx.errors import ConstraintError
from fmbd_fenicsx.run.stop_requests import StopRequests

PENDULUM = """
import signal
import fmbd_fenicsx as fmbd
bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(1, 0))
scene = fmbd.Scene("long swing", gravity=(0, -9.81))
scene.add(bob, fmbd.revolute("pin", fmbd.ground, bob, center=(0, 0)))
scene.sensor("bob", fmbd.position(bob))
heard = []
def force(t):
    if not heard and signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        heard.append(t)
        print("ready", flush=True)  # steps are made, and listen
    return 0.0, 0.0
scene.add(fmbd.force("none", bob, force))
run = fmbd.solve(scene, t_end=1e4, dt=1e-3)
print("never", flush=True)
"""


@pytest.mark.serial
def test_ctrl_c_prints_the_report_so_far_and_exits_with_130():
    child = subprocess.Popen(
        [sys.executable, "-c", PENDULUM], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    )
    assert child.stdout is not None and child.stdout.readline() == "ready\n"
    child.send_signal(signal.SIGINT)
    out, err = child.communicate(timeout=30)
    assert child.returncode == 130
    assert "stopped at t =" in out and "never" not in out
    assert "Traceback" not in err


def test_first_ctrl_c_asks_and_the_second_interrupts():
    with StopRequests() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        assert stop.asked
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.1)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_asks_where_a_library_has_put_the_system_s_own_handler_back():
    """As gmsh.initialize() does."""
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        with StopRequests() as stop:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
            assert stop.asked
    finally:
        signal.signal(signal.SIGINT, before)


HOOK = """
from mpi4py import MPI
from fmbd_fenicsx.errors import ConstraintError
from fmbd_fenicsx.ranks import together
rank = MPI.COMM_WORLD.rank
"""


@pytest.mark.serial
@pytest.mark.skipif(shutil.which("mpirun") is None, reason="no mpirun")
@pytest.mark.parametrize(
    "body",
    [
        "if rank == 1:\n    raise ConstraintError('it broke')\nMPI.COMM_WORLD.barrier()",
        "raise ConstraintError('it broke')",
        "together(MPI.COMM_WORLD, ConstraintError('it broke') if rank == 1 else None)",
    ],
    ids=["one rank", "all ranks", "one rank tells all"],
)
def test_a_failing_rank_ends_all_with_one_message_and_its_exit_code(body):
    done = launch(HOOK + body, 3, timeout=60)
    assert done.returncode == ConstraintError.exit_code
    assert done.stderr.count("ConstraintError: it broke") == 1, done.stderr
