"""Contact of two elastic bodies in space with many multipliers: unknowns, set changes, solves, seconds, and ranks compared.

Run:  ./with-dolfinx python3 docs/scripts/large_contact.py --save one.npz                              (about 2e5 unknowns)
      mpirun -n 2 ./with-dolfinx python3 docs/scripts/large_contact.py --compare one.npz               (also -n 3)

Half a ball hits a block; meshes do not match, and the ball is graded towards the contact. ``--h 0.03 --cells 12`` is a small
version, ``--columns`` solves the same by columns of the compliance matrix, ``--friction 0.3`` adds
friction and an oblique impact.
"""

import argparse
import resource
import time

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.linear.complementarity import delassus

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--h", type=float, default=0.0075)
parser.add_argument("--cells", type=int, default=42)
parser.add_argument("--steps", type=int, default=6)
parser.add_argument("--friction", type=float, default=0.0)
parser.add_argument("--columns", action="store_true")
parser.add_argument("--save")
parser.add_argument("--compare")
args = parser.parse_args()
if args.columns:
    delassus.MANY = 10**9
start = time.perf_counter()
R, v0, gap = 0.5, 0.2, 1e-4
ball_mesh = fmbd.read_gmsh("meshes/half_ball.py", dim=3, radius=R, h=args.h, near=0.2, coarse=0.12)
block_mesh = fmbd.read_gmsh("meshes/block.py", size=(1.2, 1.2, 0.6), cells=args.cells, origin=(-0.6, -0.6, -0.6 - gap))
elastic = fmbd.materials.linear_elastic(1.0, 0.3)
along = 0.2 * v0 if args.friction else 0.0
ball = fmbd.AbsoluteBody("ball", ball_mesh, degree=1, density=1.0, elastic=elastic, velocity=(along, 0.0, -v0))
block = fmbd.AbsoluteBody("block", block_mesh, degree=1, density=1.0, elastic=elastic)
scene = fmbd.Scene("large contact")
scene.add(ball, block, fmbd.contact("hit", ball.surface("contact"), block.surface("front"), friction=args.friction))
scene.sensor("force", fmbd.contact_force("hit"))
scene.sensor("impulse", fmbd.contact_impulse("hit"))
dt = 0.05
run = fmbd.solve(scene, t_end=args.steps * dt, dt=dt)

found, n = run.state.contact, run.counters
unknowns = sum(f.field.n_global for _, f in run.system.fields)
memory = MPI.COMM_WORLD.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 2**20
cpu = MPI.COMM_WORLD.allreduce(time.process_time())
energy = sum(run.energy.values())
active = int((found.normal_force > 0).sum())
across = np.linalg.norm(found.force - found.normal_force[:, None] * found.normal, axis=1)
slip = int(((found.normal_force > 0) & (across > (1 - 1e-9) * args.friction * found.normal_force)).sum())
demo.say(run.report())
demo.say(
    f"{MPI.COMM_WORLD.size} ranks: {unknowns} unknowns, {len(found.gap)} contact points, {active} closed at the end"
    + (f", {slip} of them slip\n" if args.friction else "\n")
    + f"{n['active_set_iterations']:.0f} active-set iterations, {n['active_set_changes']:.0f} changes, "
    f"{n['compliance_products']:.0f} products, {n['compliance_columns']:.0f} columns, "
    f"{n['contact_newton_iterations'] / n['contact_steps']:.2f} Newton iterations a step, "
    f"residual {n['complementarity_residual']:.1e}, energy gain {energy.max() / energy[0] - 1:.1e}\n"
    f"{time.perf_counter() - start:.0f} s, CPU {cpu:.0f} s, steps {run.seconds['steps']:.0f} s, peak {memory:.1f} GiB"
)
forces = {"x": found.x, "pressure": found.pressure, "force": run["force"], "impulse": run["impulse"], "energy": energy}
if args.save and MPI.COMM_WORLD.rank == 0:
    np.savez(args.save, **forces)
if args.compare:
    with np.load(args.compare) as other:
        place = cKDTree(other["x"]).query(found.x)[1]  # nodes are numbered by rank
        forces["x"], forces["pressure"] = found.x - other["x"][place], found.pressure - other["pressure"][place]
        errors = {
            "positions": np.abs(forces["x"]).max() / R,
            "pressure": np.abs(forces["pressure"]).max() / other["pressure"].max(),
            "force": np.abs(run["force"] - other["force"]).max() / np.abs(other["force"]).max(),
            "energy": np.abs(energy - other["energy"]).max() / other["energy"].max(),
        }
    demo.say("largest relative differences: " + ", ".join(f"{k} {e:.1e}" for k, e in errors.items()))
    assert max(errors.values()) < 1e-8
