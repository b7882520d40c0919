"""Planar chains and the slider crank against Exudyn 1.13.6: CPU time per step at the same step size, scheme and accuracy.

Run:  ./with-dolfinx python3 tests/benchmarks/chain_vs_exudyn.py [--exudyn PYTHON] [--repeat 5] [--json FILE]

PYTHON is an interpreter of a separate environment with exudyn (also: the variable EXUDYN_PYTHON):
    python3 -m venv exudyn-env && exudyn-env/bin/pip install exudyn==1.13.6

Both sides run in turn in one call and the medians of the ratios are shown, so that the load of the machine cancels. Exudyn runs
its fast build, one thread, its dense solver for the small models and the sparse one above, full and modified Newton iteration,
whichever is faster. Here whole steps are timed as the time loop makes them; the start and the recording are left out on both
sides. Generalized-alpha, rho_inf = 0.8, Newton's tolerances as each program sets them. Positions at the end must agree.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.consistent import consistent

HERE = Path(__file__).parent
CASES = {
    "crank": (10000, 1e-4, 1.0),
    "10": (2000, 1e-3, 1.0),
    "100": (300, 1e-3, 0.5),
    "1000": (60, 1e-3, 0.25),
}


def chain(n):
    """n links of 0.1 m and 0.1 kg from the origin along x."""
    scene = fmbd.Scene(f"chain of {n} links", gravity=(0, -9.81))
    links = [fmbd.RigidBody(f"link {i}", 0.1, 0.1 * 0.01 / 12, ((i + 0.5) * 0.1, 0.0)) for i in range(n)]
    scene.add(*links)
    for i, (a, b) in enumerate(zip([fmbd.ground, *links], links, strict=False)):
        scene.add(fmbd.revolute(f"pin {i}", a, b, center=(i * 0.1, 0)))
    scene.sensor("end", fmbd.position(links[-1], point=(n * 0.1, 0)))
    return scene


def crank():
    """Slider crank of the IVP test set, rigid, coasting from 150 rad/s."""
    r, arm, w = 0.15, 0.3, 150.0
    one = fmbd.RigidBody("crank", 0.36, 0.002727 - 0.36 * r**2 / 4, (r / 2, 0), 0.0, (0, w * r / 2), w)
    J2 = 0.0045339259 - 0.151104 * 0.15**2
    two = fmbd.RigidBody("rod", 0.151104, J2, (r + arm / 2, 0), 0.0, (0, w * r / 2), -w / 2)
    three = fmbd.RigidBody("block", 0.075552, 1e-4, (r + arm, 0))
    scene = fmbd.Scene("slider crank")
    scene.add(one, two, three, fmbd.revolute("main", fmbd.ground, one, center=(0, 0)))
    scene.add(
        fmbd.revolute("knee", one, two, center=(r, 0)),
        fmbd.revolute("wrist", two, three, center=(r + arm, 0)),
    )
    scene.add(fmbd.prismatic("slider", fmbd.ground, three, axis=(1, 0), center=(0, 0)))
    scene.sensor("end", fmbd.position(three))
    return scene


def ours(case, steps, h, compiled):
    """CPU seconds per step, position at the end, Newton iterations per step."""
    scene = crank() if case == "crank" else chain(int(case))
    system, given, markers = scene.build()
    solver, newton = StepSolver(system), fmbd.Newton()
    start, _ = consistent(system, given, solver)
    stepper = fmbd.GeneralizedAlpha(0.8, compiled=compiled).stepper(system, solver, newton, start)
    stepper.advance(h)
    begin = time.process_time()
    for _ in range(steps - 1):
        stepper.advance(h)
    seconds = (time.process_time() - begin) / (steps - 1)
    s = stepper.state
    end = scene.sensors["end"].read(system.at(s.t, s.q, s.v), s, markers["end"])
    return {"seconds": seconds, "end": end.tolist(), "iterations": newton.iterations / steps}


def theirs(python, case, steps, h):
    """The same of Exudyn."""
    command = [python, "-W", "ignore", str(HERE / "exudyn_models.py"), case, str(steps), str(h)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def compare(python, repeat, cases=tuple(CASES)):
    """Rows of the table: medians over ``repeat`` pairs of runs."""
    rows = []
    for case in cases:
        steps, h, goal = CASES[case]
        pairs = [(ours(case, steps, h, True), theirs(python, case, steps, h)) for _ in range(repeat)]
        plain = ours(case, max(20, steps // 20), h, False)
        a, b = (float(np.median([p[i]["seconds"] for p in pairs])) for i in (0, 1))
        away = float(np.abs(np.subtract(pairs[0][0]["end"], pairs[0][1]["end"])).max())
        ratio = float(np.median([x["seconds"] / y["seconds"] for x, y in pairs]))
        rows.append(
            {
                "case": case,
                "us": 1e6 * a,
                "us_numpy": 1e6 * plain["seconds"],
                "us_exudyn": 1e6 * b,
                "ratio": ratio,
                "goal": goal,
                "difference": away,
                "iterations": pairs[0][0]["iterations"],
                "iterations_exudyn": pairs[0][1]["iterations"],
            }
        )
    return rows


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--exudyn", default=os.environ.get("EXUDYN_PYTHON", ""))
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    if not args.exudyn or shutil.which(args.exudyn) is None:
        sys.exit("No interpreter with exudyn: see --help.")
    rows = compare(args.exudyn, args.repeat)
    print("| case | us/step | NumPy path | Exudyn | ratio | goal | difference, m | iterations here / there |")
    print("|---|---|---|---|---|---|---|---|")
    for r in rows:
        print(
            f"| {r['case']} | {r['us']:.1f} | {r['us_numpy']:.0f} | {r['us_exudyn']:.1f} | {r['ratio']:.3f} | {r['goal']} "
            f"| {r['difference']:.1e} | {r['iterations']:.2f} / {r['iterations_exudyn']:.2f} |"
        )
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
