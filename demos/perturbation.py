"""What a small error in a constraint does: delta sin(omega t) in the equation that each form of the constraints solves.

Run:  ./with-dolfinx python3 demos/perturbation.py          (--fast: fewer frequencies; --picture FILE: growth over omega)

    |=========+      index 3:  B u   = delta sin(omega t) d      An elastic block (P1) on its clamp B, the forms as the schemes
    |  block  |      index 2:  B u'  = delta sin(omega t) d      solve them (Radau IIA). Displacement, velocity and clamp force
    |=========+      index 1:  B u'' = delta sin(omega t) d      grow like omega^0, omega^1, omega^2 at index 3, one power less
    clamp                                                        at index 2, two at index 1: each index costs one derivative.

Below the first eigenfrequency the whole block follows (force m delta omega^2); above the largest of the mesh, the nodes of the
clamp alone (force m_clamp delta omega^2, m_clamp = d (B M^-1 B^T)^-1 d): the mesh, not the material, then sets the size.
In the picture the dots of index 2 and 1 lie above the lines of the steady state: those forms drift off B u = 0.
Hairer, Lubich and Roche, doi:10.1007/BFb0093947.
"""

import numpy as np
from mpi4py import MPI

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import Check, demo, plot
from fmbd_fenicsx.fem.elastic_forms import ElasticForms
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.traces.traces import trace_of

DELTA, CELLS = 1e-3, 4  # m, m/s or m/s^2
RANGES = {"below": 2 * np.pi * np.array([0.005, 0.01, 0.02]), "above": 2 * np.pi * np.array([50.0, 100.0, 200.0])}
FORMS, NAMES = {3: fmbd.Index3, 2: fmbd.Index2, 1: fmbd.Index1}, ("displacement", "velocity", "clamp force")


class Perturbed:
    """Adds -delta sin(omega t) d, switched on smoothly, to the equations of a form of the constraints."""

    def rows(self, ev, a):
        t = np.atleast_1d(ev.t)[:, None]  # of one instant or all stages
        r = np.minimum(t * self.omega / (2 * np.pi), 1.0)
        on = r**4 * (35 - 84 * r + 70 * r**2 - 20 * r**3)
        return super().rows(ev, a) - DELTA * on * np.sin(self.omega * t) * self.shape


def block():
    """Mass and stiffness matrices of the block, its clamp B (tractions in x and y), and the error's shape d."""
    mesh = fmbd.read_gmsh("meshes/block.py", cells=CELLS, comm=MPI.COMM_SELF)
    field = Field("block", mesh, ElasticForms(fmbd.materials.linear_elastic(1.0, 0.3), 1.0, 1))
    M, K = (A[:, :] for A in (field.mass_matrix(), field.combination(0.0, 1.0)))
    left = trace_of(field.space, mesh, "left")
    B = left.columns(fmbd.Continuous().on(left).coupling()).toarray()
    return M, K, np.kron(B, np.eye(2)), np.kron(B.sum(1), [1.0, 0.0])  # d: a unit displacement in x


def response(index, omega, M, K, B, d):
    """Largest rms displacement and velocity late in the run, and the clamp force at its end, an extreme of it."""
    scene, zero, period = fmbd.Scene("perturbed clamp"), np.zeros(len(M)), 2 * np.pi / omega
    body = scene.add(fmbd.CoordinateBody("block", M, lambda q, v, t: -K @ q, zero, constraint=lambda q, t: B @ q))
    scene.sensor("u", fmbd.coordinates(body))
    scene.sensor("v", fmbd.coordinates(body, level=1))
    form = type(f"Perturbed{index}", (Perturbed, FORMS[index]), {"omega": omega, "shape": d})()
    periods = 3.5 if index == 2 else 3.25  # to an extreme of the clamp force, sin or cos
    run = fmbd.solve(scene, t_end=periods * period, dt=period / 40, scheme=fmbd.Radau(3, form, rtol=None))
    late, m = run.times > 1.5 * period, M.sum() / 2
    rms = lambda x: np.sqrt(np.einsum("ti,ij,tj->t", x, M, x) / m)[late].max()
    return rms(run["u"]), rms(run["v"]), abs(d @ run.state.lam)


def harmonic(omega, M, K, B, d):
    """The same amplitudes of the steady state at index 3, with some damping, for the picture."""
    A = np.block([[(1 + 0.02j) * K - omega**2 * M, B.T], [B, np.zeros((len(B),) * 2)]])
    x = np.linalg.solve(A, np.concatenate((np.zeros(len(M)), DELTA * d)))
    u = np.sqrt(np.real(x[: len(M)].conj() @ M @ x[: len(M)]) / (M.sum() / 2))
    return u, omega * u, abs(d @ x[len(M) :])


args = demo.arguments(__doc__)
model = M, K, B, d = block()
weight = {"below": M.sum() / 2, "above": d @ np.linalg.solve(B @ np.linalg.solve(M, B.T), d)}
checks, runs = [], {where: omegas[-2:] if args.fast else omegas for where, omegas in RANGES.items()}
tables = {(x, index): np.array([response(index, w, *model) for w in runs[x]]) for x in runs for index in FORMS}
for (where, index), table in tables.items():
    for k, power in enumerate(np.polyfit(np.log(runs[where]), np.log(table), 1)[0]):
        checks.append(Check(f"index {index}, {where}: power of omega, {NAMES[k]}", power, k + index - 3, 0.05))
    force = table[-1, 2] / (weight[where] * DELTA * runs[where][-1] ** (index - 1))
    checks.append(Check(f"index {index}, {where}: clamp force over inertia", force, 1.0, 0.05))
if args.picture:
    w = np.geomspace(RANGES["below"][0] / 2, RANGES["above"][-1] * 2, 400)
    curves = np.array([harmonic(x, *model) for x in w])
    with plot.figure(args.picture, 1, 3, size=(12.0, 4.0), title=args.title) as panels:
        for k, axes in enumerate(panels):
            for index in FORMS:
                axes.loglog(w, curves[:, k] * w ** (index - 3.0), f"C{index}-", lw=0.8, label=f"index {index}")
            for (where, index), table in tables.items():
                axes.loglog(runs[where], table[:, k], f"C{index}o", ms=4)
            axes.set(xlabel="omega (rad/s); dots: runs", ylabel=f"{NAMES[k]} ({('m', 'm/s', 'N')[k]})")
demo.finish(checks, None, args)
