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
from fmbd_fenicsx import demo
from fmbd_fenicsx.traces.fields import ElasticForms, Field
from fmbd_fenicsx.traces.traces import trace_of

DELTA, CELLS = 1e-3, 4  # m, m/s or m/s^2
LOW, HIGH = 2 * np.pi * np.array([0.005, 0.01, 0.02]), 2 * np.pi * np.array([50.0, 100.0, 200.0])
NAMES = ("displacement", "velocity", "clamp force")


class Perturbed:
    """Adds -delta sin(omega t) d, switched on smoothly, to the equations of a form of the constraints."""

    def rows(self, ev, a):
        t = np.atleast_1d(ev.t)[:, None]  # of one instant or all stages
        r = np.minimum(t * self.omega / (2 * np.pi), 1.0)
        on = r**4 * (35 - 84 * r + 70 * r**2 - 20 * r**3)
        return super().rows(ev, a) - DELTA * on * np.sin(self.omega * t) * self.shape


FORMS = {3: fmbd.Index3, 2: fmbd.Index2, 1: fmbd.Index1}


def perturbed(index, omega, shape):
    """The form of an index with the error in its equations."""
    return type(f"Perturbed{index}", (Perturbed, FORMS[index]), {"omega": omega, "shape": shape})()


def block():
    """Mass and stiffness matrices of the block, its clamp B (tractions in x and y), and the error's shape d."""
    mesh = fmbd.read_gmsh("meshes/block.py", cells=CELLS, comm=MPI.COMM_SELF)
    field = Field("block", mesh, ElasticForms(fmbd.materials.linear_elastic(1.0, 0.3), 1.0, 1))
    M, K = (A[:, :] for A in (field.mass_matrix(), field.combination(0.0, 1.0)))
    B = fmbd.Continuous().on(trace_of(field.space, mesh, "left")).local_coupling().toarray()
    d = np.kron(B.sum(1), [1.0, 0.0])  # the clamp's data for a unit displacement in x
    return M, K, np.kron(B, np.eye(2)), d


def response(index, omega, M, K, B, d):
    """Largest rms displacement and velocity late in the run, and the clamp force at its end, an extreme of it."""
    body = fmbd.CoordinateBody("block", M, lambda q, v, t: -K @ q, np.zeros(len(M)),
                               constraint=lambda q, t: B @ q, jacobian=lambda q, t: B,
                               gamma=lambda q, v, t: np.zeros(len(B)))  # fmt: skip
    scene = fmbd.Scene("perturbed clamp")
    scene.add(body)
    scene.sensor("u", fmbd.coordinates(body))
    scene.sensor("v", fmbd.coordinates(body, level=1))
    period = 2 * np.pi / omega
    scheme = fmbd.Radau(3, perturbed(index, omega, d), rtol=None)
    end = 3.5 if index == 2 else 3.25  # of the clamp force's extremes, sin or cos
    run = fmbd.solve(scene, t_end=end * period, dt=period / 40, scheme=scheme)
    late, m = run.times > 1.5 * period, M.sum() / 2
    rms = lambda x: np.sqrt(np.einsum("ti,ij,tj->t", x, M, x) / m)[late].max()
    return rms(run["u"]), rms(run["v"]), abs(d @ run.state.lam)


def harmonic(omega, M, K, B, d):
    """The same amplitudes of the steady state at index 3, with some damping, for the picture."""
    A = np.block([[(1 + 0.02j) * K - omega**2 * M, B.T], [B, np.zeros((len(B),) * 2)]])
    x = np.linalg.solve(A, np.concatenate((np.zeros(len(M)), DELTA * d)))
    u = np.sqrt(np.real(x[: len(M)].conj() @ M @ x[: len(M)]) / (M.sum() / 2))
    return u, omega * u, abs(d @ x[len(M) :])


if __name__ == "__main__":
    args = demo.arguments(__doc__)
    model = M, K, B, d = block()
    weight = {"below": M.sum() / 2, "above": d @ np.linalg.solve(B @ np.linalg.solve(M, B.T), d)}
    checks, found = [], {}
    for where, omegas in (("below", LOW), ("above", HIGH)):
        omegas = omegas[-2:] if args.fast else omegas
        for index in FORMS:
            table = found[where, index] = np.array([response(index, w, *model) for w in omegas])
            growth = np.polyfit(np.log(omegas), np.log(table), 1)[0]
            demo.say(
                f"{where} the eigenfrequencies, index {index}: powers of omega of {', '.join(NAMES)}: {growth.round(3)}"
            )
            for k, name in enumerate(NAMES):
                checks.append(
                    demo.Check(f"index {index}, {where}: power of omega, {name}", growth[k], k + index - 3, 0.05)
                )
            force = table[:, 2] / (weight[where] * DELTA * omegas ** (index - 1))
            checks.append(demo.Check(f"index {index}, {where}: clamp force over inertia", force[-1], 1.0, 0.05))
    if args.picture is not None and MPI.COMM_WORLD.rank == 0:
        import matplotlib.pyplot as plt

        _, axes = plt.subplots(1, 3, figsize=(11, 3.8), layout="constrained")
        w = np.geomspace(LOW[0] / 2, HIGH[-1] * 2, 400)
        curve = np.array([harmonic(x, *model) for x in w])
        for k, (axis, name) in enumerate(
            zip(axes, ("displacement, m", "velocity, m/s", "clamp force, N"), strict=True)
        ):
            for j, index in enumerate(FORMS):
                axis.loglog(w, curve[:, k] * w ** (index - 3.0), f"C{j}-", lw=1, label=f"index {index}")
                for where, omegas in (("below", LOW), ("above", HIGH)):
                    axis.loglog(omegas[-len(found[where, index]) :], found[where, index][:, k], f"C{j}o", ms=4)
            axis.set(xlabel="omega, rad/s", title=name)
            axis.grid(alpha=0.3)
        axes[0].legend(title="lines: steady state\ndots: time integration", fontsize=8, title_fontsize=8)
        plt.savefig(args.picture, dpi=110)
    demo.finish(checks, None, args)
