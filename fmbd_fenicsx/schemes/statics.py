"""Static equilibrium of a system: where it stays at rest under the loads of its start.

    f(q) + G(q)^T lambda = 0,    g(q) = 0,        f = balance of forces at rest, weights and springs included           (1)

Newton's iteration with the matrix of a long time step, (M / tau^2 + C / tau + K, G): inertia keeps it regular where bodies can
move freely and fades like 1 / (tau omega)^2; the residual is that of (1) without inertia, so the answer does not depend on tau
(pseudo-transient continuation: Kelley and Keyes, SIAM J. Numer. Anal. 35 (1998), doi:10.1137/S0036142996304796).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import ConvergenceError, LinearSolveError
from ..linear.condensation import StepSolver, Weights
from ..rotations import Array
from ..system.system import State, System

ITERATIONS, DEPTH = 200, 12


def equilibrium(system: System, given: State, solver: StepSolver) -> State:
    """The state at rest that satisfies (1), searched from the given placement; collective.

    Raises ConvergenceError when there is none nearby, say for a body that can move freely under its weight.
    """
    g = float(np.abs(system.gravity(given.t)).max(initial=0.0)) or 1.0
    tau = 10.0 * float(np.sqrt(system.length / g))
    while True:  # a step so long that elastic blocks become singular to working precision is refused by the solver
        try:
            return _march(system, given, solver, tau)
        except LinearSolveError:
            if tau < 1e-3 * float(np.sqrt(system.length / g)):
                raise
            tau /= 3.0


def _march(system: System, given: State, solver: StepSolver, tau: float) -> State:
    """Newton's iteration with time steps tau (s)."""
    v: Array = np.zeros(system.n_v)
    xi: Array = np.zeros(system.n_v)
    lam: Array = np.zeros(system.n_lam)
    mix, sizes = _Mixing(system), [np.inf]
    for _ in range(ITERATIONS):
        q = system.compose(given.q, xi)
        ev = system.at(given.t, q, v)
        solver.prepare(ev, Weights(1.0, tau, tau * tau))
        dq, dlam = solver.step(-tau * tau * ev.balance(v, lam), -ev.constraint())
        sizes.append(system.max_abs(dq))
        if not sizes[-1] < 1e3 * system.length:
            break
        stalled = sizes[-1] > 0.5 * sizes[-2] and sizes[-1] <= 1e-10 * system.length
        if sizes[-1] <= 1e-13 * system.length or stalled:
            return replace(given, q=system.compose(q, dq), v=v, lam=lam + dlam / tau**2)
        xi, lam = mix.next(xi, lam, np.asarray(system.rate(xi, dq)), np.asarray(dlam / tau**2))
    raise ConvergenceError(
        f"No static equilibrium was found from the given placement: after {len(sizes) - 1} iterations bodies still move by "
        f"{sizes[-1]:.3g} m in one. Is every body held by joints or springs? scene.check() lists the degrees of freedom."
    )


class _Mixing:
    """Anderson's mixing of the last iterates: takes out the few slow motions (doi:10.1137/10078356X)."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.last: tuple[Array, ...] | None = None
        self.steps: list[tuple[Array, ...]] = []

    def next(self, *now: Array) -> tuple[Array, Array]:
        """The next iterate (x, lambda) from the iterate and its increment (x, lambda, dx, dlambda); collective."""
        x, lam, f, f_lam = now
        if self.last is not None:
            self.steps = [tuple(a - b for a, b in zip(now, self.last, strict=True)), *self.steps][:DEPTH]
        self.last = now
        dot, F = self.system.dot, [step[2] for step in self.steps]
        if F:
            gram = np.array([[dot(a, b) for b in F] for a in F])
            scale = 1.0 / np.sqrt(np.diag(gram).clip(min=1e-300))
            right = np.array([dot(a, f) for a in F]) * scale
            c = np.linalg.lstsq(gram * scale * scale[:, None], right, rcond=1e-12)[0] * scale
            for ck, (sx, s_lam, sf, sf_lam) in zip(c, self.steps, strict=True):
                x, lam, f, f_lam = x - ck * sx, lam - ck * s_lam, f - ck * sf, f_lam - ck * sf_lam
        return x + f, lam + f_lam
