"""An elastic bar on a spherical joint against Exudyn 1.13.6: CPU time per step, agreement, and error at equal time.

Run:  ./with-dolfinx python3 tests/benchmarks/rod_vs_exudyn.py [--exudyn PYTHON] [--cases reduced,full] [--json FILE]

PYTHON: of an environment with exudyn==1.13.6. Both sides get the same matrices: ours are written to a file that exudyn_rod.py
reads, with the modes and with the weights that average a surface. Generalized-alpha of index 3, rho_inf = 0.8, the same step.

``reduced``: 16 free modes, our body by the compiled step and by NumPy, Exudyn's ObjectFFRFreducedOrder in the faster of full
and modified Newton iteration (its dense solver, fast build, one thread); then errors of the tip after 0.5 s over step sizes
against a run with h = 5e-6. ``full``: the field itself against Exudyn's nodal ObjectFFRF (modified Newton; steps after the
first; 3 075 unknowns take it half a minute, 7 203 several minutes and 2 GiB). ``modes``: set-up of 16 free modes and of the
reduced body.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.mixed import make_field
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.consistent import consistent

HERE = Path(__file__).parent
GRAVITY = (0.0, 0.0, -9.81)
MESHES = {"3075": (20, 2), "7203": (24, 3), "15795": (32, 4)}
FULL = {"3075": (6, 500), "7203": (4, 1500)}  # steps of Exudyn, ratio wanted
STEPS = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4, 1e-4)
FINER = (5e-5, 2.5e-5)  # of ours only: what Exudyn's time would buy


def bar(size):
    """The elastic body with so many unknowns."""
    along, across = MESHES[size]
    mesh = fmbd.read_gmsh(HERE / "bar_mesh.py", along=along, across=across)
    return fmbd.FloatingBody("bar", mesh, density=1000.0, elastic=fmbd.materials.linear_elastic(1e8, 0.3))


def pendulum(body):
    """Hinged at the mean point of its end section, released from rest."""
    scene = fmbd.Scene("elastic pendulum", gravity=GRAVITY)
    scene.add(body, fmbd.spherical("pin", fmbd.ground, body.surface("pin")))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene


def export(body, reduced, file):
    """Matrices, nodes, weights and modes of a body for Exudyn."""
    field = make_field(body.name, body.mesh, body.forms())
    M, K = field.mass_matrix(), field.combination(0.0, 1.0)
    out = {"nodes": field.X, "centre": field.center, "gravity": np.array(GRAVITY)}
    for name, A in (("M", M), ("K", K)):
        out |= dict(zip((f"{name}_start", f"{name}_cols", f"{name}_data"), A.getValuesCSR(), strict=True))
        A.destroy()
    for surface in ("pin", "tip"):
        found = field.moments(surface)
        out |= {f"{surface}_nodes": found.nodes, f"{surface}_weights": found.weights[:, 0]}
    out |= {"pin_at": field.moments("pin").center, "modes": reduced.reduction.phi}
    np.savez(file, eigenvalues=reduced.reduction.omega**2, **out)
    field.destroy()


def ours(body, steps, h, compiled=True):
    """CPU seconds per step, tip at the end, Newton iterations per step."""
    scene = pendulum(body)
    system, given, markers = scene.build()
    solver, newton = StepSolver(system), fmbd.Newton()
    start, _ = consistent(system, given, solver)
    stepper = fmbd.GeneralizedAlpha(0.8, compiled=compiled).stepper(system, solver, newton, start)
    stepper.advance(h)
    begin = time.process_time()
    for _ in range(steps - 1):
        stepper.advance(h)
    seconds = (time.process_time() - begin) / max(steps - 1, 1)
    s = stepper.state
    end = scene.sensors["tip"].read(system.at(s.t, s.q, s.v), s, markers["tip"])
    solver.destroy()
    return {"seconds": seconds, "end": end.tolist(), "iterations": newton.iterations / steps}


def theirs(python, kind, file, steps, h):
    """The same of Exudyn."""
    command = [python, "-W", "ignore", str(HERE / "exudyn_rod.py"), kind, str(file), str(steps), str(h)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3000)  # noqa: PLW1510
    if done.returncode:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def distance(a, b):
    """Largest difference of two tips, m."""
    return float(np.abs(np.subtract(a["end"], b["end"])).max())


def compare_reduced(python, file, body, repeat=5, steps=500, h=1e-3):
    """Times per step of the reduced body, medians over pairs of runs that take turns."""
    pairs = [(ours(body, steps, h), theirs(python, "reduced", file, steps, h)) for _ in range(repeat)]
    plain = ours(body, max(20, steps // 10), h, compiled=False)
    return {
        "us": 1e6 * float(np.median([a["seconds"] for a, _ in pairs])),
        "us_numpy": 1e6 * plain["seconds"],
        "us_exudyn": 1e6 * float(np.median([b["seconds"] for _, b in pairs])),
        "ratio": float(np.median([a["seconds"] / b["seconds"] for a, b in pairs])),
        "difference": distance(*pairs[0]),
        "iterations": pairs[0][0]["iterations"],
        "iterations_exudyn": pairs[0][1]["iterations"],
    }


def work_precision(python, file, body, t_end=0.5, finest=5e-6, sizes=STEPS):
    """Rows (h, our ms, our error, Exudyn's ms, its error; nan where it did not run) of the tip at ``t_end``."""
    exact = ours(body, round(t_end / finest), finest)
    rows = []
    for h in (*sizes, *FINER):
        n = round(t_end / h)
        a = ours(body, n, h)
        row = [h, 1e3 * a["seconds"] * n, distance(a, exact), np.nan, np.nan]
        if h in sizes:
            b = theirs(python, "reduced", file, n, h)
            row[3:] = 1e3 * b["seconds"] * n, distance(b, exact)
        rows.append(row)
    return rows


def error_at(rows, ms):
    """Our error at a given time per run, by straight lines in the logarithms; outside the runs that of the nearest."""
    times, errors = np.log([r[1] for r in rows]), np.log([r[2] for r in rows])
    return float(np.exp(np.interp(np.log(ms), times, errors)))


def compare_full(python, size, h=1e-3, steps=400):
    """Time per step of the field against the nodal object, which makes very few steps."""
    body = bar(size)
    few, goal = FULL[size]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bar.npz"
        export(body, body.reduced(modes=16), file)
        them = theirs(python, "full", file, few, h)
    us, same = ours(body, steps, h), ours(body, few, h)
    return {
        "size": size,
        "ms": 1e3 * us["seconds"],
        "ms_exudyn": 1e3 * them["seconds"],
        "first_exudyn": them["first"],
        "ratio": us["seconds"] / them["seconds"],
        "goal": 1 / goal,
        "difference": distance(same, them),
        "iterations": us["iterations"],
    }


def compare_modes(python, size):
    """Seconds of the set-up of 16 free modes."""
    body = bar(size)
    reduced = body.reduced(modes=16)
    first = reduced.reduction  # forms compiled, libraries loaded
    begin = time.process_time()
    assert np.allclose(body.reduced(modes=16).reduction.omega, first.omega)
    seconds = time.process_time() - begin
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bar.npz"
        export(body, reduced, file)
        them = theirs(python, "modes", file, 1, 1.0)
    return {"size": size, "seconds": seconds, **them}


def report_reduced(python, repeat):
    """Print and return the figures of the reduced body."""
    body = bar("3075")
    reduced = body.reduced(modes=16)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bar.npz"
        export(body, reduced, file)
        row = compare_reduced(python, file, reduced, repeat)
        rows = work_precision(python, file, reduced)
    print(
        f"reduced, 16 modes: {row['us']:.1f} us/step, NumPy {row['us_numpy']:.0f}, Exudyn {row['us_exudyn']:.1f}, ratio "
        f"{row['ratio']:.3f} (goal 0.333); tips differ by {row['difference']:.1e} m; iterations {row['iterations']:.2f} / "
        f"{row['iterations_exudyn']:.2f}"
    )
    print(
        "| h, s | ms here | error, m | ms Exudyn | error, m | error here at Exudyn's time |\n|---|---|---|---|---|---|"
    )
    for h, ms, e, ms_, e_ in rows:
        there = f"{ms_:.1f} | {e_:.1e} | {error_at(rows, ms_):.1e}" if ms_ > 0 else "| |"
        print(f"| {h:g} | {ms:.1f} | {e:.1e} | {there} |")
    return {"reduced": row, "work_precision": rows}


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--exudyn", default=os.environ.get("EXUDYN_PYTHON", ""))
    parser.add_argument("--cases", default="reduced,modes,full", help="some of reduced,modes,full")
    parser.add_argument("--sizes", default="3075,7203", help="of the full model")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    if not args.exudyn or shutil.which(args.exudyn) is None:
        sys.exit("No interpreter with exudyn: see --help.")
    found, cases = {}, args.cases.split(",")
    if "reduced" in cases:
        found |= report_reduced(args.exudyn, args.repeat)
    if "modes" in cases:
        found["modes"] = [compare_modes(args.exudyn, size) for size in MESHES]
        for r in found["modes"]:
            print(
                f"modes, {r['size']} unknowns: {r['seconds']:.2f} s with constants, "
                f"Exudyn {r['modes']:.2f} + {r['constants']:.2f} s"
            )
    if "full" in cases:
        found["full"] = [compare_full(args.exudyn, size) for size in args.sizes.split(",")]
        for r in found["full"]:
            print(
                f"full, {r['size']} unknowns: {r['ms']:.2f} ms/step ({r['iterations']:.2f} iterations), Exudyn "
                f"{r['ms_exudyn']:.0f} (first step {r['first_exudyn']:.0f} s), ratio 1/{1 / r['ratio']:.0f} "
                f"(goal 1/{1 / r['goal']:.0f}), tips differ by {r['difference']:.1e} m"
            )
    if args.json:
        args.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
