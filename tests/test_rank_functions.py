"""Functions of the user's own that differ between ranks are refused; a rank that leaves a run ends all with an exit code."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest
from programs import launch

pytestmark = [
    pytest.mark.serial,
    pytest.mark.skipif(shutil.which("mpirun") is None, reason="no mpirun"),
]
SCENE = """
import sys
from mpi4py import MPI
import numpy as np
import fmbd_fenicsx as fmbd
rank = MPI.COMM_WORLD.rank
mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.1), origin=(0.0, -0.05), counts=(4, 1))
elastic = fmbd.materials.plane_stress(1e7, 0.3)

def scene(motion=lambda t: 0.1 * t**2, law=lambda s, v, t: 10.0 * s, load=lambda t: 1.0):
    pull = fmbd.loads.traction("right", (0.0, 1.0), time=load)
    rod = fmbd.FloatingBody("rod", mesh, degree=1, density=1e3, elastic=elastic, loads=[pull])
    made = fmbd.Scene("swing", gravity=(0.0, -9.81))
    pin = fmbd.revolute("pin", fmbd.ground, rod.surface("left"), center=(0.0, 0.0))
    made.add(rod, pin, fmbd.drive("motor", fmbd.angle(pin), motion))
    made.add(fmbd.joint_spring("spring", fmbd.angle(pin), law=law))
    return made

def solve(made, dt=0.01, **more):
    return fmbd.solve(made, t_end=0.02, dt=dt, output=fmbd.Output(progress=False, **more))
"""


def run(code: str, n: int) -> subprocess.CompletedProcess[str]:
    """A program on n ranks; it has to end by itself."""
    return launch(SCENE + code, n, timeout=120)


@pytest.mark.parametrize(
    "what, name",
    [
        ("motion=lambda t: (0.1 + 1e-3 * rank) * t**2", 'The motion of drive "motor"'),
        pytest.param("law=lambda s, v, t: (10.0 + rank) * s + 1e-3 * rank", '"spring"', marks=pytest.mark.slow),
        pytest.param("load=lambda t: 1.0 + 0.1 * rank", 'a load on body "rod"', marks=pytest.mark.slow),
    ],
    ids=["drive", "law", "load"],
)
def test_a_function_that_depends_on_the_rank_is_refused(what: str, name: str) -> None:
    done = run(f"solve(scene({what}))", 2)
    assert done.returncode == 2, done.stderr[-2000:]
    assert name in done.stderr and "on rank 1 for the same arguments" in done.stderr


REFUSED = """
def refusal(call):
    try:
        call()
    except fmbd.errors.FmbdError as error:
        told = MPI.COMM_WORLD.gather(str(error))
        if rank == 0:
            print(*told, sep="\\n", flush=True)

made, other = scene(), scene()
other.gravity = (0.0, -9.81 + rank)
refusal(lambda: solve(made, dt=0.01 / (1 + rank)))
refusal(lambda: fmbd.equilibrium(other))
with fmbd.stepper(made, dt=0.01) as s:
    refusal(lambda: s.step(0.01 / (1 + rank)))
"""


def test_numbers_that_differ_between_ranks_are_refused() -> None:
    """Of settings, parts and steps, on all ranks in the same words."""
    done = run(REFUSED, 2)
    assert done.returncode == 0, done.stderr[-2000:]
    for found in ("solve: dt is 0.01", "equilibrium: gravity is [ 0.   -9.81]", "step: dt is 0.01"):
        lines = [line for line in done.stdout.splitlines() if found in line]
        assert len(lines) == 2 and lines[0] == lines[1], done.stdout
        assert "on rank 0 and" in lines[0] and "on rank 1." in lines[0]


@pytest.mark.slow
def test_a_law_that_fails_on_one_rank_ends_all() -> None:
    law = "def law(s, v, t):\n    if rank and t > 0.005:\n        1 / 0\n    return 10.0 * s\n"
    done = run(f"{law}solve(scene(law=law))", 2)
    assert done.returncode == 2 and "The law of" in done.stderr and "ZeroDivisionError" in done.stderr


@pytest.mark.parametrize(
    "code, wanted", [("sys.exit(3)", 3), ("sys.exit(0)", 1), ("1 / 0", 1), ("raise SystemExit(5)", 5)]
)
def test_a_rank_that_leaves_a_run_ends_all(code: str, wanted: int) -> None:
    done = run(f"def look(now):\n    if rank == 1:\n        {code}\nsolve(scene(), on_step=look)\nprint('never')", 2)
    assert done.returncode == wanted, done.stderr[-2000:]
    assert "never" not in done.stdout


@pytest.mark.slow
def test_all_ranks_may_leave_a_run_together() -> None:
    done = run("solve(scene(), on_step=lambda now: sys.exit(0))", 2)
    assert done.returncode == 0, done.stderr[-2000:]


def test_equal_functions_give_what_one_rank_gives() -> None:
    code = "r = solve(scene())\nif rank == 0:\n    print(repr(float(r.state.q[0])), r.counters['steps'])"
    one, two = run(code, 1), run(code, 2)
    assert one.returncode == two.returncode == 0, two.stderr[-2000:]
    assert float(one.stdout.split()[0]) == pytest.approx(float(two.stdout.split()[0]), rel=1e-9)


def test_values_of_ranks_are_compared() -> None:
    """Roundoff is none; what is not finite has to be the same."""
    from fmbd_fenicsx.agreement import differ

    assert not differ((1.0, [2.0, np.inf]), (1.0 + 1e-12, [2.0, np.inf]))
    assert not differ(np.nan, np.nan)
    assert differ(np.inf, 1.0)
    assert differ([1.0, np.inf], [1.0, -np.inf])
    assert differ([1.0, 2.0], [1.0, 2.1])
    assert differ(1.0, [1.0])
