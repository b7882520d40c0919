"""A cantilever hit at its end, cut into subdomains with meshes that do not match: waves travel through the
interfaces.

Run:  ./with-dolfinx python3 demos/domain_decomposition.py --parts 4     (mpirun -n 2 ...; --fast; --picture
FILE: axial velocity)

    clamp |== 0 ==|== 1 ==|== 2 ==|== 3 ==| <- smooth axial pulse       E u'' blocks by Cholesky on one rank
    each,

interfaces by P1 multipliers beside P2 displacements, solved through the dual problem S lam = d by conjugate
gradients with the
fractional preconditioner. Trapezoidal steps. Reference: d'Alembert's solution; the pulse s comes back from
the clamp turned over,
v_tip = s(t) - 2 s(t - 2 L / c) + 2 s(t - 4 L / c) - ...
"""

import time

import numpy as np
from mpi4py import MPI

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.linear.domain_decomposition import DualInterface, shared_traces
from fmbd_fenicsx.linear.saddle import Elastic
from fmbd_fenicsx.traces.fields import ElasticForms, Field
from fmbd_fenicsx.traces.multipliers import Continuous, Ends
from fmbd_fenicsx.traces.traces import trace_of

LENGTH, HEIGHT, PULSE = 2.0, 0.25, 1.2  # m, m, s
LAW = ElasticForms(fmbd.materials.linear_elastic(1.0, 0.0), 1.0, 2)  # wave speed 1 m/s
SPACE, WORLD = Continuous(1, Ends.KEPT), MPI.COMM_WORLD


def beam(parts, cells, dt):
    """Dual problem of the beam in ``parts`` pieces, this rank's pieces, and the load vector of the end
    face.
    """
    own, size = {}, LENGTH / parts
    for i in range(WORLD.rank, parts, WORLD.size):
        n = max(cells // parts, 1) + (i % 2 if parts > 1 else 0)
        mesh = fmbd.read_gmsh(
            "meshes/block.py",
            size=(size, HEIGHT),
            counts=(n, max(n * parts // 8, 1) + i % 2),
            origin=(i * size, 0.0),
            comm=MPI.COMM_SELF,
        )
        own[i] = Elastic(Field(f"piece{i}", mesh, LAW), 4 / dt**2)
    traces = shared_traces(
        WORLD,
        {(i, s): trace_of(e.body.space, e.body.mesh, s) for i, e in own.items() for s in ("left", "right")},
    )
    dual = DualInterface(WORLD, own, traces)
    dual.hold((0, "left"), SPACE)
    for i in range(1, parts):
        a, b = (i, "left"), (i - 1, "right")
        dual.tie(*((a, b) if traces[a].h < traces[b].h else (b, a)), SPACE)
    dual.prepare()
    face = {i: np.zeros((e.body.n, 2)) for i, e in own.items()}
    if parts - 1 in own:
        t = traces[parts - 1, "right"]
        face[parts - 1][t.owned, 0] = t.mass() @ np.ones(t.n)
    return dual, own, face


def march(parts, cells, dt, t_end):
    """Trapezoidal steps; tip velocity series, multipliers of the last interface, mean iterations, seconds."""
    dual, own, face = beam(parts, cells, dt)
    u, v, a = ({i: np.zeros(e.rows) for i, e in own.items()} for _ in range(3))
    tip, traction, counts, start = [], [], [], time.perf_counter()
    for step in range(round(t_end / dt)):
        t = (step + 1) * dt
        p = float(pulse(np.array(t)))
        r = {
            i: p * face[i].ravel() + e.body.mass((4 / dt**2 * u[i] + 4 / dt * v[i] + a[i]).reshape(-1, 2)).ravel()
            for i, e in own.items()
        }
        new, lam, its = dual.solve(r, np.zeros(dual.n))
        for i in own:
            acceleration = 4 / dt**2 * (new[i] - u[i]) - 4 / dt * v[i] - a[i]
            v[i], a[i], u[i] = v[i] + dt / 2 * (a[i] + acceleration), acceleration, new[i]
        last = sum(float(face[i][:, 0] @ v[i].reshape(-1, 2)[:, 0]) for i in own) / HEIGHT
        tip.append(WORLD.allreduce(last))
        traction.append(lam)
        counts.append(its)
    dual.destroy()
    return np.array(tip), np.array(traction), float(np.mean(counts)), time.perf_counter() - start


def pulse(t):
    return np.where((t > 0) & (t < PULSE), -(np.sin(np.pi * t / PULSE) ** 4), 0.0)


def error(parts, cells, t_end):
    """Largest error of the tip velocity against the exact wave; times, series, traction, iterations,
    seconds.
    """
    dt = LENGTH / cells / 2
    tip, traction, its, seconds = march(parts, cells, dt, t_end)
    t = dt * np.arange(1, len(tip) + 1)
    exact = pulse(t) - 2 * pulse(t - 2 * LENGTH) + 2 * pulse(t - 4 * LENGTH)
    demo.say(f"{parts} pieces, h = {LENGTH / cells:.4f} m: error {np.abs(tip - exact).max():.2e} m/s, "
             f"{its:.1f} iterations a step, "
             f"largest traction {np.abs(traction).max():.3f} Pa, {seconds:.2f} s on {WORLD.size} ranks")  # fmt: skip
    return np.abs(tip - exact).max(), (t, tip, exact), np.abs(traction).max(), its


if __name__ == "__main__":
    args = demo.arguments(__doc__, {"--parts": 4})
    cells, t_end = ((16, 32) if args.fast else (16, 32, 64, 128)), 5.5
    one = [error(1, n, t_end) for n in cells]
    cut = [error(args.parts, n, t_end) for n in cells]
    order = np.log2(cut[-2][0] / cut[-1][0])
    checks = [
        demo.Check("order of the error in h = 2 c dt at least 2", min(order, 2.0), 2.0, 0.2),
        demo.Check.relative("error with interfaces against one piece", cut[-1][0], one[-1][0], 0.1),
        demo.Check("iterations beyond 25", max(max(c[3] for c in cut) - 25, 0.0), 0.0, 0.0),
        demo.Check("largest traction: twice the pulse, at the clamp", cut[-1][2], 2.0, 0.1),
    ]
    if args.picture is not None and WORLD.rank == 0:
        import matplotlib.pyplot as plt

        plt.plot(cut[-1][1][0], cut[-1][1][2], "k-", lw=3, alpha=0.3, label="exact")
        for n, c in zip(cells, cut, strict=True):
            plt.plot(*c[1][:2], "--", label=f"{args.parts} pieces, {n} cells along the beam")
        (
            plt.xlabel("t, s"),
            plt.ylabel("axial velocity of the free end, m/s"),
            plt.legend(),
            plt.grid(alpha=0.3),
        )
        plt.savefig(args.picture, dpi=110)
    demo.finish(checks, None, args)
