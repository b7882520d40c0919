"""How much faster two ranks make a step than one: an elastic rod of 10^5 unknowns, by a factor and by multigrid.

Run:  ./with-dolfinx python3 tests/benchmarks/rank_speed.py [--unknowns 100000] [--steps 20] [--repeat 3]

Runs of one and of two ranks take turns, each a process of its own; seconds are wall times, so the machine must have two cores to
itself. "steps": all of them, the factor (or the hierarchy) of the first included; "later": the median of those after it. Wanted
at 10^5 unknowns: 1.6 times faster. Exit code 1 where that is missed.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WAYS = ("direct", "multigrid")
WANTED = 1.6


def worker(way, unknowns, steps):
    """One run; rank 0 prints its seconds."""
    import fmbd_fenicsx as fmbd
    from fmbd_fenicsx import materials

    # gravity grows, so that every step has one Newton increment as in a motion under way
    mesh = fmbd.read_gmsh(ROOT / "meshes/rod.py", dim=3, h=0.0132 * (1e5 / unknowns) ** (1 / 3))
    body = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=materials.linear_elastic(5e6, 0.3))
    scene = fmbd.Scene("ranks", gravity=(0, -9.81, 0), gravity_ramp=0.5)
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0, 0, 0)))

    marks = [time.perf_counter()]
    output = fmbd.Output(every=steps, progress=False, energy=False, on_step=lambda _: marks.append(time.perf_counter()))
    linear = None if way == "direct" else fmbd.solvers.Schur(fmbd.Multigrid(), rtol=1e-6)
    run = fmbd.solve(scene, t_end=steps * 1e-3, dt=1e-3, output=output, linear=linear)
    later = statistics.median(b - a for a, b in zip(marks[2:-1], marks[3:], strict=True))
    found = {"steps": run.seconds["steps"] / steps, "later": later, "unknowns": sum(n for _, n in run.plan.unknowns)}
    fmbd.say("FOUND " + json.dumps(found))


def measured(ranks, given, way):
    """The seconds of a run on so many ranks."""
    command = [sys.executable, __file__, "--way", way, "--unknowns", str(given.unknowns), "--steps", str(given.steps)]
    start = ["mpirun", "--allow-run-as-root", "--bind-to", "none", "-n", str(ranks)]
    done = subprocess.run([*start, *command], capture_output=True, text=True, check=True)
    return json.loads(done.stdout.split("FOUND ")[1].splitlines()[0])


def main():
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--unknowns", type=int, default=100_000)
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--way", choices=WAYS, help="make one run on the ranks that there are")
    given = parser.parse_args()
    if given.way:
        worker(given.way, given.unknowns, given.steps)
        return

    missed = False
    print("| way | unknowns | ms a step, 1 rank | 2 ranks | ratio | later steps, 1 rank | 2 ranks | ratio |")
    print("|---|---|---|---|---|---|---|---|")
    for way in WAYS:
        pairs = [(measured(1, given, way), measured(2, given, way)) for _ in range(given.repeat)]
        cells = []
        for what in ("steps", "later"):
            one, two = (1e3 * statistics.median(pair[k][what] for pair in pairs) for k in (0, 1))
            ratio = statistics.median(a[what] / b[what] for a, b in pairs)
            cells += [f"{one:.0f}", f"{two:.0f}", f"{ratio:.2f}"]
            missed |= what == "steps" and ratio < WANTED
        print(f"| {way} | {pairs[0][0]['unknowns']:.0f} | {' | '.join(cells)} |", flush=True)
    sys.exit(int(missed))


if __name__ == "__main__":
    main()
