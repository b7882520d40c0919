"""A cantilever hit at its end, cut into subdomains with meshes that do not match: waves travel through the interfaces.

Run:  ./with-dolfinx python3 demos/domain_decomposition.py --parts 4     (mpirun -n 2 ...; --fast; --picture FILE: the waves)

    clamp |== 0 ==|== 1 ==|== 2 ==|== 3 ==| <- smooth axial pulse       pieces by Cholesky, each on one rank

Interfaces and clamp are held by P1 multipliers beside P2 displacements, solved through the dual problem S lam = d by conjugate
gradients with the fractional preconditioner. Trapezoidal steps. Reference: d'Alembert's solution for the tip's velocity and the
traction at every interface; the pulse p comes back from the clamp as it is and from the free end turned over,

    sigma(x, t) = p(t - (L - x)) + p(t - (L + x)) - p(t - (3 L - x)) - p(t - (3 L + x)) + ...
"""

import numpy as np
from mpi4py import MPI

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.fem.fields import ElasticForms, Field
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Ends
from fmbd_fenicsx.fem.traces.traces import trace_of
from fmbd_fenicsx.linear.blocks.domain_decomposition import DualInterface, shared_traces
from fmbd_fenicsx.linear.saddle.saddle import Elastic
from fmbd_fenicsx.post.demo import Check

LENGTH, HEIGHT, PULSE, T_END = 2.0, 0.25, 1.2, 5.5  # m, m, s, s
LAW = ElasticForms(fmbd.materials.linear_elastic(1.0, 0.0), 1.0, 2)  # wave speed 1 m/s
SPACE, WORLD = Continuous(1, Ends.KEPT), MPI.COMM_WORLD


def beam(parts, cells, dt):
    """Dual problem of the beam in ``parts`` pieces, this rank's pieces, and the load vector of the end face by piece."""
    own, size = {}, LENGTH / parts
    for i in range(WORLD.rank, parts, WORLD.size):
        n = max(cells // parts, 1) + (i % 2 if parts > 1 else 0)
        block = {"size": (size, HEIGHT), "counts": (n, max(n * parts // 8, 1) + i % 2), "origin": (i * size, 0.0)}
        mesh = fmbd.read_gmsh("meshes/block.py", comm=MPI.COMM_SELF, **block)
        own[i] = Elastic(Field(f"piece{i}", mesh, LAW), 4 / dt**2)
    sides = {(i, s): trace_of(e.body.space, e.body.mesh, s) for i, e in own.items() for s in ("left", "right")}
    traces = shared_traces(WORLD, sides)
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


def march(parts, cells):
    """Times, tip velocity, normal and shear traction of each multiplier over time, its places, mean iterations a step."""
    dt = LENGTH / cells / 2
    dual, own, face = beam(parts, cells, dt)
    u, v, a = ({i: np.zeros(e.rows) for i, e in own.items()} for _ in range(3))
    tip, lam, counts, times = [], [], [], dt * np.arange(1, round(T_END / dt) + 1)
    for t in times:
        old = {i: 4 / dt**2 * u[i] + 4 / dt * v[i] + a[i] for i in own}
        load = {i: pulse(t) * face[i].ravel() + e.body.mass(old[i].reshape(-1, 2)).ravel() for i, e in own.items()}
        u, found, iterations = dual.solve(load, np.zeros(dual.n))
        for i in own:
            new = 4 / dt**2 * u[i] - old[i]
            v[i], a[i] = v[i] + dt / 2 * (a[i] + new), new
        tip.append(WORLD.allreduce(sum(float(face[i][:, 0] @ v[i].reshape(-1, 2)[:, 0]) for i in own) / HEIGHT))
        lam.append(found)
        counts.append(iterations)
    mu = [tie.multipliers for tie in dual.ties]  # minus the traction on the slave, whose normal is along x
    place = [(m.trace.points[0, 0], m.trace.normals[0, 0]) for m in mu]
    x, normal = np.repeat(place, [m.n for m in mu], axis=0).T
    dual.destroy()
    lam = np.array(lam).reshape(len(tip), -1, 2)
    return times, np.array(tip), -normal * lam[:, :, 0], lam[:, :, 1], x, np.mean(counts)


def pulse(t):
    """Traction on the free end, Pa."""
    return np.where((t > 0) & (t < PULSE), -(np.sin(np.pi * t / PULSE) ** 4), 0.0)


def stress(x, t):
    """Axial stress of the wave at places x and times t."""
    arrivals = (LENGTH - x, LENGTH + x, 3 * LENGTH - x, 3 * LENGTH + x)
    return sum(sign * pulse(t - a) for sign, a in zip((1, 1, -1, -1), arrivals, strict=True))


def velocity(t):
    """Axial velocity of the free end."""
    return pulse(t) - 2 * pulse(t - 2 * LENGTH) + 2 * pulse(t - 4 * LENGTH)


def errors(parts, t, tip, sigma, shear, x, iterations):
    """Largest errors of the tip velocity (m/s) and of the tractions (Pa), printed."""
    off = max(np.abs(sigma - stress(x, t[:, None])).max(), np.abs(shear).max())
    first = np.abs(tip - velocity(t)).max()
    demo.say(
        f"{parts} pieces, {len(t)} steps: errors {first:.2e} m/s, {off:.2e} Pa, {iterations:.1f} iterations a step"
    )
    return first, off


args = demo.arguments(__doc__, {"--parts": 4})
cells = (32, 64) if args.fast else (16, 32, 64, 128)
whole = errors(1, *march(1, cells[-1]))
runs = [march(args.parts, n) for n in cells]
cut = [errors(args.parts, *run) for run in runs]
first, second = (np.log2(cut[-2][k] / cut[-1][k]) for k in (0, 1))
checks = [
    Check.at_least("order of the tip velocity in h = 2 c dt", first, 1.8),
    Check.at_least("order of the tractions", second, 1.8),
    Check.relative("error with interfaces against one piece", cut[-1][0], whole[0], 0.1),
    Check("iterations beyond 25", max(max(run[-1] for run in runs) - 25, 0.0), 0.0),
]
if args.picture:
    with plot.figure(args.picture, 2, 1, size=(8.0, 6.4), title=args.title) as (above, below):
        t, x = runs[-1][0], runs[-1][4][-1]
        above.plot(t, velocity(t), **plot.REFERENCE, label="d'Alembert")
        below.plot(t, stress(x, t), **plot.REFERENCE)
        for n, (t, tip, sigma, *_) in zip(cells, runs, strict=True):
            above.plot(t, tip, "--", label=f"{args.parts} pieces, {n} cells")
            below.plot(t, sigma[:, -1], "--")
        above.set(ylabel="velocity of the free end (m/s)")
        below.set(ylabel=f"traction at x = {x:g} m (Pa)", xlabel="time (s)")
demo.finish(checks, None, args)
