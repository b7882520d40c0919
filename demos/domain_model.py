"""The beam of the demo domain_decomposition: its pulse and d'Alembert's solution, steps in time, errors and figure."""

import numpy as np
from mpi4py import MPI

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.fem.elastic_forms import ElasticForms
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.linear.blocks.elastic_blocks import Elastic

LENGTH, HEIGHT, PULSE, T_END = 2.0, 0.25, 1.2, 5.5  # m, m, s, s
LAW = ElasticForms(fmbd.materials.linear_elastic(1.0, 0.0), 1.0, 2)  # wave speed 1 m/s
WORLD = MPI.COMM_WORLD


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


def pieces(parts, cells, dt):
    """This rank's pieces of the beam by number, for steps of dt; every other one has a cell more along and across."""
    own, size = {}, LENGTH / parts
    for i in range(WORLD.rank, parts, WORLD.size):
        n = max(cells // parts, 1) + (i % 2 if parts > 1 else 0)
        block = {"size": (size, HEIGHT), "counts": (n, max(n * parts // 8, 1) + i % 2), "origin": (i * size, 0.0)}
        mesh = fmbd.read_gmsh("meshes/block.py", comm=MPI.COMM_SELF, **block)
        own[i] = Elastic(Field(f"piece{i}", mesh, LAW), 4 / dt**2)
    return own


def end_load(dual, parts):
    """Load vectors, by piece on this rank, of a unit traction along x on the beam's free end."""
    face = {i: np.zeros((e.body.n, 2)) for i, e in dual.own.items()}
    if parts - 1 in face:
        end = dual.traces[parts - 1, "right"]
        face[parts - 1][end.owned, 0] = end.mass() @ np.ones(end.n)
    return face


def march(dual, parts, dt):
    """Trapezoidal steps of a cut beam, its free end under the pulse.

    Returns times, tip velocity, normal and shear traction of each multiplier over time, its places, mean iterations a step.
    """
    own, face = dual.own, end_load(dual, parts)
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

    on = [tie.sides[0][1] for tie in dual.ties]  # minus the traction on the slave, whose normal is along x
    place, counts_of = [(t.points[0, 0], t.normals[0, 0]) for t in on], [tie.rows // 2 for tie in dual.ties]
    x, normal = np.repeat(place, counts_of, axis=0).T
    dual.destroy()
    lam = np.array(lam).reshape(len(tip), -1, 2)
    return times, np.array(tip), -normal * lam[:, :, 0], lam[:, :, 1], x, np.mean(counts)


def errors(parts, t, tip, sigma, shear, x, iterations):
    """Largest errors of the tip velocity (m/s) and of the tractions (Pa), printed."""
    off = max(np.abs(sigma - stress(x, t[:, None])).max(), np.abs(shear).max())
    first = np.abs(tip - velocity(t)).max()
    demo.say(
        f"{parts} pieces, {len(t)} steps: errors {first:.2e} m/s, {off:.2e} Pa, {iterations:.1f} iterations a step"
    )
    return first, off


def picture(args, cells, runs):
    """Velocity of the tip and traction at the last interface over time, beside d'Alembert's."""
    with plot.figure(args.picture, 2, 1, size=(8.0, 6.4), title=args.title) as (above, below):
        t, x = runs[-1][0], runs[-1][4][-1]
        above.plot(t, velocity(t), **plot.REFERENCE, label="d'Alembert")
        below.plot(t, stress(x, t), **plot.REFERENCE)
        for n, (t, tip, sigma, *_) in zip(cells, runs, strict=True):
            above.plot(t, tip, "--", label=f"{args.parts} pieces, {n} cells")
            below.plot(t, sigma[:, -1], "--")
        above.set(ylabel="velocity of the free end (m/s)")
        below.set(ylabel=f"traction at x = {x:g} m (Pa)", xlabel="time (s)")
