"""What the demos of rods share: equilibrium along a path of loads, and a drawing of rods with their sections."""

import numpy as np
from scipy.linalg import eigh, null_space

from fmbd_fenicsx.errors import FmbdError
from fmbd_fenicsx.linear.condensation import StepSolver, Weights, dense
from fmbd_fenicsx.mechanics.rods.skin import skin
from fmbd_fenicsx.system.force_tangent import force_tangent


def follow(scene, stops, first=0.1, tolerance=1e-11):
    """System and configurations at the load factors ``stops``, ascending; laws of loads take the factor as their time."""
    system, state, _ = scene.build()
    solver, rest = StepSolver(system), np.zeros(system.n_v)
    now, past, step, out = (0.0, state.q, state.lam), None, first, {}

    for stop in stops:
        while now[0] < stop:
            made = _newton(system, solver, rest, _predicted(system, now, past, min(now[0] + step, stop)), tolerance)
            if made is None:
                step = 0.5 * min(step, stop - now[0])
                assert step > 1e-7, f"no equilibrium beyond the load factor {now[0]}"
                continue
            past, now = now, made[0]
            step *= 1.5 if made[1] <= 5 else 1.0
        out[stop] = now[1]
    return system, out


def _predicted(system, now, past, target):
    """Factor, configuration and multipliers along the secant."""
    if past is None:
        return target, now[1], now[2]
    share = (target - now[0]) / (now[0] - past[0])
    moved = share * system.difference(past[1], now[1])
    return target, system.compose(now[1], moved), now[2] + share * (now[2] - past[2])


def _newton(system, solver, rest, start, tolerance):
    """The equilibrium near ``start`` and the number of iterations; None without one."""
    factor, q, lam = start
    for k in range(12):
        ev = system.at(factor, q, rest)
        try:
            solver.prepare(ev, Weights(0.0, 0.0, 1.0))
            dq, dlam = solver.solve(-ev.balance(rest, lam), -ev.constraint())
        except FmbdError:
            return None
        size = system.max_abs(dq) / system.length
        if not size < 0.5:
            return None
        q, lam = system.compose(q, dq), lam + dlam
        if size < tolerance:
            return (factor, q, lam), k + 1
    return None


def poses(system, q):
    """Poses of all frames, (n, 7)."""
    return q[: system.n_frames * 7].reshape(-1, 7)


def tip(system, q):
    """Place of the last frame."""
    return poses(system, q)[-1, :3]


def panels(file, content):
    """Pictures side by side: title -> [(rod, poses of its nodes), ...], from light to dark."""
    from matplotlib.figure import Figure

    page = Figure(figsize=(5.5 * len(content), 4.5), layout="constrained")
    for k, (title, shapes) in enumerate(content.items()):
        axes = page.add_subplot(1, len(content), k + 1, projection="3d")
        for i, (rod, pose) in enumerate(shapes):
            rings = skin(rod, pose)
            rings = np.concatenate((rings, rings[:, :1]), axis=1)
            shade = 0.25 + 0.75 * (i + 1) / len(shapes)
            color = (1 - 0.8 * shade, 1 - 0.55 * shade, 1 - 0.3 * shade)
            axes.plot_surface(*np.moveaxis(rings, -1, 0), color=color, rstride=1, cstride=1, linewidth=0)
        axes.set(title=title, xlabel="x / m", ylabel="y / m", zlabel="z / m")
        axes.set_aspect("equal")
        axes.locator_params(nbins=4)
        if np.ptp(axes.get_zlim()) < 0.05 * np.ptp(axes.get_xlim()):
            axes.set(zticks=[], zlabel="")
    page.savefig(file, dpi=120)


def frequencies(system, found, count):
    """The lowest natural frequencies (rad/s) about an equilibrium, its constraints held."""
    q = list(found.values())[-1]
    ev = system.at(1.0, q, np.zeros(system.n_v))
    M = dense(StepSolver(system).core_matrix(ev, Weights(1.0, 0.0, 0.0)))
    K = dense(force_tangent(ev, 0.0, 1.0).core)
    free = null_space(dense(ev.jacobian.core))
    M, K = free.T @ M @ free, free.T @ (K + K.T) @ free / 2
    return np.sqrt(np.maximum(eigh(K, M, eigvals_only=True, subset_by_index=(0, count - 1)), 0.0))
