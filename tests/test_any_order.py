"""What is asked of two states, in any order, is what two systems would tell that have seen one state each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

pytest.importorskip("dolfinx")
import scipy.sparse as sp
from combinations import BODIES, YOUNG, Hung, elastic, spring

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import materials
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.linear.core_matrix import core_matrix
from fmbd_fenicsx.system.compiled.choice import use_driver
from fmbd_fenicsx.system.evaluation import Evaluation
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.system import System

WEIGHTS = Weights(1.0, 0.1, 0.01)


# -- scenes -------------------------------------------------------------------------------------------------------
def stiffened() -> Hung:
    """A floating field that the stress of its inertia forces stiffens."""
    return elastic(fmbd.FloatingBody, elastic=materials.plane_stress(YOUNG, 0.3), stiffening="pin")


def stiffened_modes() -> Hung:
    """The same by four modes."""
    body = stiffened().body.reduced(modes=4)
    return Hung(body, body.surface("pin"), body.surface("tip"))


def damped(law: Any) -> Callable[[], Hung]:
    """A body of large strains with damping by stiffness."""
    return lambda: elastic(fmbd.AbsoluteBody, energy=law, stiffness_damping=1e-3)


def hung(made: Callable[[], Hung]) -> Callable[[], fmbd.Scene]:
    """A scene of a body in a hinge with a motor of a law in Python, on a spring."""

    def scene() -> fmbd.Scene:
        out, body = fmbd.Scene("hung", gravity=made().at(0, -9.81)), made()
        out.add(body.body)
        spring(out, body)
        hinge = out.joints["pin"]
        out.add(fmbd.joint_spring("motor", fmbd.angle(hinge), law=lambda s, rate, t: 200.0 * np.sin(s) + 5.0 * rate))
        return out

    return scene


def wires() -> fmbd.Scene:
    """Two wires on droppers that can be slack, and a contact that slides along the lower one."""
    wire = fmbd.Wire(1.35, 20e3, 195.0)
    droppers = tuple(fmbd.Dropper(1, 0, x, 1e5) for x in (5.0, 15.0, 25.0))
    line = fmbd.Wires("wires", 30.0, 20, (wire, wire), (), droppers, stiffness_damping=1e-3)
    pan = fmbd.CoordinateBody("pan", np.eye(1), lambda q, v, t: np.array([100.0 * t - 1e3 * q[0]]), np.zeros(1))
    scene = fmbd.Scene("wires", gravity=(0, -9.81))
    scene.add(line, pan, fmbd.SlidingContact("head", line, pan, start=7.0, speed=20.0))
    return scene


SCENES: dict[str, Callable[[], fmbd.Scene]] = {
    **{name: hung(made) for name, made in BODIES.items()},
    "stiffened": hung(stiffened),
    "stiffened modes": hung(stiffened_modes),
    "damped": hung(damped(materials.sheet_saint_venant_kirchhoff(YOUNG, 0.3))),
    "damped, incompressible": hung(damped(materials.neo_hookean_incompressible(YOUNG))),
    "damped, pressure": hung(damped(materials.neo_hookean_mixed(YOUNG, 0.45))),
    "wires": wires,
}


# -- what is asked ------------------------------------------------------------------------------------------------
def dense(A: Any) -> np.ndarray:
    """A matrix, sparse or not."""
    return A.toarray() if sp.issparse(A) else np.asarray(A)


def tangents(ev: Evaluation, s: State) -> np.ndarray:
    """New tangents at the state: their products, the columns of inertia and of the ports."""
    ev.take_tangents()
    found = [np.zeros(0)]
    for k, part in ev.system.fields:
        along = np.cos(np.arange(part.n))
        found += [part.field.tangent(along), part.inertia_columns.ravel()]
        found += [part.port_columns(np.arange(part.n_port), s.t).ravel(), *(np.ravel(x) for x in ev.local(k))]
    return np.concatenate(found)


ASKED: dict[str, Callable[[Evaluation, State], np.ndarray]] = {
    "balance": lambda ev, s: ev.balance(s.a, s.lam),
    "rates of ports": lambda ev, s: ev.port_rate,
    "core": lambda ev, s: dense(core_matrix(ev, WEIGHTS)),
    "tangents": tangents,  # which the matrices of floating fields depend on, and no state
    "balance again": lambda ev, s: ev.balance(s.a, s.lam),
    "constraint": lambda ev, s: ev.constraint(),
    "opening": lambda ev, s: ev.opening(),
    "gamma": lambda ev, s: ev.gamma(),
    "G^T lambda": lambda ev, s: ev.jacobian.transposed(s.lam),
    "energies": lambda ev, s: np.array(list(ev.energies().values())),
    "momenta": lambda ev, s: np.concatenate(ev.momenta()),
}


def state_near(system: System, start: State, number: int) -> State:
    """A state that is not far from the start, the same for equal systems."""
    rng = np.random.default_rng(number)
    xi, v, a = 0.02 * rng.normal(size=(3, system.n_v)) / system.units
    return State(0.1 * number, system.compose(start.q, xi), v, a, rng.normal(size=system.n_lam))


def told(scene: fmbd.Scene, numbers: Sequence[int], turns: Sequence[int]) -> list[dict[str, np.ndarray]]:
    """What states of these numbers tell, evaluated first and asked afterwards: each thing in the given order of states."""
    system, start, _ = scene.build()
    states = [state_near(system, start, number) for number in numbers]
    evaluated = [system.at(s.t, s.q, s.v) for s in states]
    out: list[dict[str, np.ndarray]] = [{} for _ in states]
    for name, ask in ASKED.items():
        for i in turns:
            out[i][name] = ask(evaluated[i], states[i])
    return out


@pytest.mark.parametrize("name", SCENES)
def test_two_states_in_any_order(name: str) -> None:
    """Two states asked in turn, in both orders, against fresh systems; to roundoff, since parts may add in another order."""
    alone = [told(SCENES[name](), [number], [0])[0] for number in (1, 2)]
    for turns in ((0, 1), (1, 0)):
        both = told(SCENES[name](), [1, 2], turns)
        for expected, found in zip(alone, both, strict=True):
            for what, value in expected.items():
                size = np.abs(value).max(initial=1e-300)
                np.testing.assert_allclose(found[what], value, atol=1e-12 * size, rtol=0, err_msg=what)


def test_rows_close_in_the_masses_of_their_configuration() -> None:
    """Compiled code moves a state onto its constraints alike, whichever state it evaluated before: a mass matrix with moments of
    another deflection need not be positive.
    """
    closed = []
    for before in (1, 2):
        system, start, _ = SCENES["stiffened modes"]().build()
        use_driver(system)
        other, state = (state_near(system, start, number) for number in (before, 2))
        driver = StepSolver(system).driver
        assert driver is not None
        states = driver.one_call(state.t, state.q, state.v)
        system.at(other.t, other.q, other.v).balance(other.a, other.lam)
        found = states and states.closed(state.t, state.q, state.v)
        assert found is not None
        closed.append(np.concatenate(found))
    np.testing.assert_allclose(closed[0], closed[1], atol=1e-12 * np.abs(closed[1]).max())
