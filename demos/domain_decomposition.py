"""A cantilever hit at its end, cut into subdomains with meshes that do not match: waves travel through the interfaces.

Run:  ./with-dolfinx python3 demos/domain_decomposition.py --parts 4     (mpirun -n 2 ...; --fast; --picture FILE: the waves)

    clamp |== 0 ==|== 1 ==|== 2 ==|== 3 ==| <- smooth axial pulse       pieces by Cholesky, each on one rank

Interfaces and clamp are held by P1 multipliers beside P2 displacements, solved through the dual problem S lam = d by conjugate
gradients with the fractional preconditioner. Trapezoidal steps. Reference: d'Alembert's solution for the tip's velocity and the
traction at every interface; the pulse p comes back from the clamp as it is and from the free end turned over,

    sigma(x, t) = p(t - (L - x)) + p(t - (L + x)) - p(t - (3 L - x)) - p(t - (3 L + x)) + ...
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
    """Dual problem of the beam in ``parts`` pieces, this rank's pieces, and the load vector of the end face."""
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
    """Trapezoidal steps; tip velocity, multipliers (steps, nodes, 2), their places and signs, mean iterations, seconds."""
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
    mu = [t.multipliers for t in dual.ties]  # minus the traction on the slave, whose normal is along x
    place = np.concatenate([np.tile([m.trace.points[0, 0], -m.trace.normals[0, 0]], (m.n, 1)) for m in mu])
    dual.destroy()
    traction = np.array(traction).reshape(len(tip), -1, 2)
    return np.array(tip), traction, place, float(np.mean(counts)), time.perf_counter() - start


def pulse(t):
    return np.where((t > 0) & (t < PULSE), -(np.sin(np.pi * t / PULSE) ** 4), 0.0)


def stress(x, t):
    """Axial stress of the wave at places x and times t."""
    arrivals = (LENGTH - x, LENGTH + x, 3 * LENGTH - x, 3 * LENGTH + x)
    return sum(sign * pulse(t - a) for sign, a in zip((1, 1, -1, -1), arrivals, strict=True))


def error(parts, cells, t_end):
    """Largest errors of the tip velocity and of the tractions, iterations, and the series for a picture."""
    dt = LENGTH / cells / 2
    tip, traction, (x, sign), its, seconds = (
        f.T if i == 2 else f for i, f in enumerate(march(parts, cells, dt, t_end))
    )
    t = dt * np.arange(1, len(tip) + 1)
    exact = pulse(t) - 2 * pulse(t - 2 * LENGTH) + 2 * pulse(t - 4 * LENGTH)
    sigma = sign * traction[:, :, 0]
    off = max(np.abs(sigma - stress(x, t[:, None])).max(), np.abs(traction[:, :, 1]).max())
    demo.say(f"{parts} pieces, h = {LENGTH / cells:.4f} m: errors {np.abs(tip - exact).max():.2e} m/s, {off:.2e} Pa, "
             f"{its:.1f} iterations a step, {seconds:.2f} s on {WORLD.size} ranks")  # fmt: skip
    return np.abs(tip - exact).max(), off, its, (t, tip, exact, sigma[:, -1], stress(x[-1], t))


if __name__ == "__main__":
    args = demo.arguments(__doc__, {"--parts": 4})
    cells, t_end = ((32, 64) if args.fast else (16, 32, 64, 128)), 5.5
    one = [error(1, n, t_end) for n in cells]
    cut = [error(args.parts, n, t_end) for n in cells]
    order = [np.log2(cut[-2][k] / cut[-1][k]) for k in (0, 1)]
    checks = [
        demo.Check("order of the tip velocity in h = 2 c dt at least 2", min(order[0], 2.0), 2.0, 0.2),
        demo.Check("order of the tractions at least 2", min(order[1], 2.0), 2.0, 0.2),
        demo.Check.relative("error with interfaces against one piece", cut[-1][0], one[-1][0], 0.1),
        demo.Check("iterations beyond 25", max(max(c[2] for c in cut) - 25, 0.0), 0.0, 0.0),
    ]
    if args.picture is not None and WORLD.rank == 0:
        import matplotlib.pyplot as plt

        _, axes = plt.subplots(2, 1, figsize=(8, 6.4), sharex=True, layout="constrained")
        t, _, tip, _, sigma = cut[-1][3]
        for axis, k, exact, name in ((axes[0], 1, tip, "axial velocity of the free end, m/s"),
                                     (axes[1], 3, sigma, "traction at the last interface, Pa")):  # fmt: skip
            axis.plot(t, exact, "k-", lw=4, alpha=0.25, label="exact")
            for n, c in zip(cells, cut, strict=True):
                axis.plot(c[3][0], c[3][k], "--", label=f"{args.parts} pieces, {n} cells")
            axis.set_ylabel(name)
            axis.grid(alpha=0.3)
        axes[0].legend(), axes[1].set_xlabel("t, s")
        plt.savefig(args.picture, dpi=110)
    demo.finish(checks, None, args)
