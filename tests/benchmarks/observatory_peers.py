"""The observatory's neighbours: SciPy's integrators and IDA on the equations of a scene, and Exudyn on models of its own.

SciPy and IDA (scikit-sundae) take planar scenes of rigid bodies, whose coordinates need no charts. SciPy gets the accelerations
of the index-1 form, without stabilisation; IDA the form of Gear, Gupta and Leimkuhler with the multipliers as derivatives:

    q' = v - G^T mu',     M a + f + G^T lambda' = 0,     G v + g_t = 0,     g = 0                                        (1)

Their equations are evaluated by this package in Python. Exudyn runs in an interpreter of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from observatory_problem import Problem
from scipy.integrate import solve_ivp

from fmbd_fenicsx.errors import FmbdError
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.consistent import consistent

MASS = Weights(1.0, 0.0, 0.0)
MODELS = Path(__file__).with_name("observatory_exudyn.py")


class PeerError(Exception):
    """A neighbour did not come to the end; the message says why."""


class NotForItError(Exception):
    """A neighbour does not take this problem."""


class Equations:
    """A scene as functions of (t, q, v): what general solvers take."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.scene = problem, problem.scene()
        self.system, given, self.markers = self.scene.build()
        s = self.system
        if s.fields or s.contacts is not None or len(given.q) != s.n_v:
            raise NotForItError("elastic fields, contact and rotations in space have no such equations")
        self.solver = StepSolver(s)
        self.start, _ = consistent(s, given, self.solver)
        self.evaluations = 0

    def accelerations(self, t: float, y: Any) -> Any:
        """(v, a) of y = (q, v)."""
        n = self.system.n_v
        ev = self.system.at(t, y[:n], y[n:])
        self.evaluations += 1
        self.solver.prepare(ev, MASS)
        a, _ = self.solver.solve(-ev.balance(np.zeros(n)), -ev.gamma())
        return np.concatenate((y[n:], a))

    def stabilised(self, t: float, y: Any, rate: Any) -> Any:
        """Residual of (1), y = (q, v, lambda, mu)."""
        n, m = self.system.n_v, self.system.n_lam
        v, lam, mu = y[n : 2 * n], rate[2 * n : 2 * n + m], rate[2 * n + m :]
        ev = self.system.at(t, y[:n], v)
        self.evaluations += 1
        G = ev.jacobian
        rows = [rate[:n] - v + G.transposed(mu), ev.balance(rate[n : 2 * n], lam)]
        return np.concatenate((*rows, G.times(v) + ev.constraint_rate(), ev.constraint()))

    def end(self, y: Any) -> Any:
        """The sensor of the problem at the end."""
        n, t = self.system.n_v, self.problem.t_end
        state = replace(self.start, t=t, q=y[:n], v=y[n : 2 * n])
        marker = self.markers[self.problem.sensor]
        return self.scene.sensors[self.problem.sensor].read(self.system.at(t, state.q, state.v), state, marker)


def scipy_solver(method: str) -> Callable[[str, Problem, float], tuple[Any, float]]:
    """(name, problem, rtol) -> the value at the end and the number of evaluations."""

    def run(name: str, problem: Problem, rtol: float) -> tuple[Any, float]:
        e = Equations(problem)
        y = np.concatenate((e.start.q, e.start.v))
        found = solve_ivp(
            e.accelerations, (0.0, problem.t_end), y, method, rtol=rtol, atol=1e-2 * rtol, t_eval=[problem.t_end]
        )
        if not found.success:
            raise PeerError(found.message)
        return e.end(found.y[:, -1]), e.evaluations

    return run


def ida(name: str, problem: Problem, rtol: float) -> tuple[Any, float]:
    """IDA by scikit-sundae, form (1)."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from sksundae.ida import IDA
    except ImportError:
        raise NotForItError("scikit-sundae is not installed") from None
    e = Equations(problem)
    m = e.system.n_lam

    def residual(t: float, y: Any, rate: Any, out: Any) -> None:
        out[:] = e.stabilised(t, y, rate)

    y = np.concatenate((e.start.q, e.start.v, np.zeros(2 * m)))
    rate = np.concatenate((e.start.v, e.start.a, e.start.lam, np.zeros(m)))
    solver = IDA(residual, rtol=rtol, atol=1e-2 * rtol, max_num_steps=100_000)
    found = solver.solve(np.array([0.0, problem.t_end]), y, rate)
    if not found.success:
        raise PeerError(str(found.message))
    return e.end(np.asarray(found.y[-1])), e.evaluations


def exudyn(name: str, problem: Problem, steps: float) -> tuple[Any, float, float]:
    """Exudyn's generalized-alpha with equal steps: value at the end, steps, its own CPU seconds without set-up of Python."""
    if not problem.exudyn:
        raise NotForItError("there is no model of it")
    interpreter = os.environ.get("EXUDYN_PYTHON", sys.executable)
    command = [interpreter, str(MODELS), problem.exudyn, str(int(steps)), repr(problem.t_end)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    if "No module named 'exudyn'" in done.stderr:
        raise NotForItError("Exudyn is not installed")
    if done.returncode:
        raise PeerError((done.stderr.strip().splitlines() or ["no message"])[-1])
    found = json.loads(done.stdout.strip().splitlines()[-1])
    return np.array(found["end"]), steps, found["seconds"]


FAILURES = (PeerError, FmbdError, np.linalg.LinAlgError, subprocess.TimeoutExpired, ValueError)
PEERS_CONTROLLED: dict[str, Any] = {
    "SciPy DOP853, index 1": scipy_solver("DOP853"),
    "SciPy Radau, index 1": scipy_solver("Radau"),
    "IDA, GGL": ida,
}
PEERS_EQUAL: dict[str, Any] = {"Exudyn, generalized-alpha": exudyn}
