"""Eigenvalues of a step of generalized-alpha where rows of joints turn: of the model of docs/theory.md, and of whole scenes.

Run:  ./with-dolfinx python3 docs/scripts/turning_rows.py      (30 s; prints the tables of docs/theory.md)
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.run.judges.turning_rows import turned
from fmbd_fenicsx.schemes.consistent import consistent
from fmbd_fenicsx.schemes.newton import Newton

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "demos"))
import bicycle_model as bicycle  # noqa: E402

H = 4e-3


def model(rho, angle, level):
    """Largest alternating eigenvalue for a point whose one row turns by ``angle`` a step, on positions (0) or velocities (1)."""
    am, af, gamma, beta = fmbd.GeneralizedAlpha(rho_inf=rho).parameters
    one, none = np.eye(2), np.zeros((2, 2))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    row, share = turn[:, 0], (1 - af) / (1 - am)

    # of x = (q, v, A, a) at the start of the step, without its reaction
    q = np.hstack((one, one, (0.5 - beta) * one, none))
    v = np.hstack((none, one, (1 - gamma) * one, none))
    A = np.hstack((none, none, -am * one, af * one)) / (1 - am)
    missed = row @ (q + beta * A) / beta if level == 0 else row @ (v + gamma * A) / gamma
    a = -np.outer(row, missed) / share
    A = A + share * a
    step = np.kron(np.eye(4), turn.T) @ np.vstack((q + beta * A, v + gamma * A, A, a))
    values = np.linalg.eigvals(step)
    return np.abs(values[values.real < 0.3]).max()


def map_of_step(scene, scheme, h):
    """Largest alternating eigenvalue of one step of a scene, in axes that do not turn with its round bodies."""
    system, given, _ = scene.build()
    solver = StepSolver(system)
    state, _ = consistent(system, given, solver)
    stepper = scheme.stepper(system, solver, Newton(tolerance=1e-13, max_iterations=60), state)
    for _ in range(3):
        stepper.advance(h)
    base, memory, past, n = stepper.state, stepper.A.copy(), list(stepper._past), system.n_v

    def step(d):
        dq, dv, dA, da = d.reshape(4, n)
        state = replace(base, q=system.compose(base.q, dq), v=base.v + dv / h, a=base.a + da / h**2)
        stepper.state, stepper.A, stepper._past = state, memory + dA / h**2, list(past)
        stepper.newton.theta = 0.5
        return stepper.advance(h), stepper.A.copy()

    end, end_A = step(np.zeros(4 * n))

    def column(d):
        s, A = step(d)
        return np.concatenate(
            (system.difference(end.q, s.q), (s.v - end.v) * h, (A - end_A) * h**2, (s.a - end.a) * h**2)
        )

    columns = [(column(1e-6 * e) - column(-1e-6 * e)) / 2e-6 for e in np.eye(4 * n)]
    values = np.linalg.eigvals(
        _in_space(system, end, h) @ np.array(columns).T @ np.linalg.inv(_in_space(system, base, h))
    )
    return np.abs(values[values.real < -0.3]).max()


def _in_space(system, state, h):
    """Turns (dq, dv, dA, da) to the axes of space, with the spin that dq turns."""
    n, R = system.n_v, system.motions.matrix(system.poses(state.q))[:-1]
    B = np.eye(4 * n)
    for f, turn in enumerate(R):
        at = slice(6 * f + 3, 6 * f + 6)
        x, y, z = state.v[at]
        for k in range(4):
            B[k * n :, k * n :][at, at] = turn
        B[n:, :][at, at] = -h * turn @ np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return B


def rotor(angle):
    """A wheel that turns by an angle a step on an axle in a free frame."""
    frame = fmbd.RigidBody("frame", 1.0, (0.1, 0.2, 0.15))
    spin = (0, angle / H, 0)
    wheel = fmbd.RigidBody("wheel", 2.0, (0.06, 0.12, 0.06), position=(0.5, 0, 0), angular_velocity=spin)
    scene = fmbd.Scene("rotor")
    scene.add(frame, wheel, fmbd.revolute("axle", frame, wheel, center=(0.5, 0, 0), axis=(0, 1, 0)))
    return scene


def main():
    angles = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
    for level, name in enumerate(("positions", "velocities")):
        print(f"\n| rho_inf, row on {name} | " + " | ".join(f"{x:g} rad" for x in angles) + " |")
        for rho in (0.5, 0.8, 0.9, 0.95):
            print(f"| {rho:g} | " + " | ".join(f"{model(rho, x, level):.3f}" for x in angles) + " |")

    print("\n| scene | turn of its rows (rad) | rho_inf | index 3 | GGL |")
    for name, make in (("rotor, 0.2 rad", lambda: rotor(0.2)), ("bicycle, 5 m/s", lambda: bicycle.build(5.0))):
        system, state, _ = make().build()
        for rho in (0.8, 0.95):
            found = [
                map_of_step(make(), fmbd.GeneralizedAlpha(rho_inf=rho, compiled=False, form=form), H)
                for form in (fmbd.Index3(), fmbd.GGL())
            ]
            print(f"| {name} | {turned(system, state, H):.3f} | {rho:g} | {found[0]:.3f} | {found[1]:.3f} |")


if __name__ == "__main__":
    main()
