"""What a small error in a constraint does: delta sin(omega t) in the position, the velocity or the
acceleration constraint of a clamp.

Run:  ./with-dolfinx python3 demos/perturbation.py          (--fast: two frequencies; --picture FILE: growth
against omega)

    |=========+                 A constraint of index k turns the error into its derivatives: with the clamp
    held by
    |  block  |                 positions (index 3) the displacement, velocity and clamp force of the block
    grow like
    |=========+                 omega^0, omega^1, omega^2; with velocities (index 2) one power less each, and
    with
    clamp: u = delta sin(w t)   accelerations (index 1) two less.  (Hairer, Lubich and Roche,
    doi:10.1007/BFb0093947)
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo

DELTA, MASS = 1e-3, 1.0  # m (or m/s, m/s^2), kg


def motion(omega, level):
    """s(t) whose derivative of order ``level`` oscillates with amplitude DELTA, after a smooth start of one
    period.
    """
    period = 2 * np.pi / omega

    def s(t):
        r = np.clip(np.real(t) / period, 0.0, 1.0) if np.real(t) >= period else t / period
        return DELTA / omega**level * np.sin(omega * t) * r**4 * (35 - 84 * r + 70 * r**2 - 20 * r**3)

    return s


def response(omega, level):
    """Amplitudes of displacement and velocity of the block's far face late in the run, clamp force at its
    last extreme.
    """
    mesh = fmbd.read_gmsh("meshes/block.py", cells=4)
    block = fmbd.AbsoluteBody("block", mesh, degree=1, density=MASS, elastic=fmbd.materials.linear_elastic(1e6, 0.3))
    scene = fmbd.Scene("perturbed clamp")
    shape = lambda x: np.stack([np.ones_like(x[0]), np.zeros_like(x[0])])
    clamp = fmbd.tie_surface("clamp", block.surface("left"), fmbd.ground, shape=shape, motion=motion(omega, level))
    scene.add(block, clamp)
    scene.sensor("x", fmbd.position(block.surface("right")))
    scene.sensor("v", fmbd.velocity(block.surface("right")))
    period = 2 * np.pi / omega
    run = fmbd.solve(scene, t_end=3.25 * period, dt=period / 80)
    late = run.times > 1.5 * period
    x, v = (run[n][late, 0] - (1.0 if n == "x" else 0.0) for n in ("x", "v"))
    return np.abs(x).max(), np.abs(v).max(), abs(clamp_force(run))


def clamp_force(run):
    """Force of the clamp at the end of the run, from the multipliers: int lam dS, x component."""
    rows = run.system.block("clamp").rows
    mu = run.system.traces[0][0].multipliers
    return float(np.asarray(mu.coupling().sum(axis=1)).ravel() @ run.state.lam[rows].reshape(-1, 2)[:, 0])


if __name__ == "__main__":
    args = demo.arguments(__doc__)
    omegas = 2 * np.pi * np.array([2.0, 8.0] if args.fast else [2.0, 4.0, 8.0, 16.0])
    checks, table = [], {}
    for level, index in ((0, 3), (1, 2), (2, 1)):
        found = table[index] = np.array([response(w, level) for w in omegas])
        growth = np.polyfit(np.log(omegas), np.log(found), 1)[0]
        demo.say(f"index {index}: growth with omega of displacement, velocity, clamp force: {growth.round(3)}")
        for k, name in enumerate(("displacement", "velocity", "clamp force")):
            checks.append(demo.Check(f"index {index}: power of omega, {name}", growth[k], k - level, 0.05))
    exact = MASS * DELTA * omegas**2
    checks.append(
        demo.Check("clamp force over the inertia of a rigid block", (table[3][:, 2] / exact).max(), 1.0, 0.02)
    )
    if args.picture is not None and fmbd.log.world_rank() == 0:
        import matplotlib.pyplot as plt

        _, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
        for k, (axis, name) in enumerate(
            zip(axes, ("displacement, m", "velocity, m/s", "clamp force, N"), strict=True)
        ):
            for index, found in table.items():
                axis.loglog(omegas, found[:, k], "o-", label=f"index {index}")
            axis.set(xlabel="omega, rad/s", title=name)
            axis.grid(alpha=0.3, which="both")
        axes[0].legend()
        plt.savefig(args.picture, dpi=110)
    demo.finish(checks, None, args)
