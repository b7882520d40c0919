"""Masses of grams and kilograms on springs of any stiffness move as on rigid links, to the error of the step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd

G, ANGLE, END = 9.81, 0.5, 1.0
DIRECTION = np.array([np.sin(ANGLE), -np.cos(ANGLE)])


def chain(masses: Sequence[float], k: float, c: float = 0.0) -> fmbd.Scene:
    """Masses on a line at a distance of 1 m, on springs that hold the weight at rest."""
    scene = fmbd.Scene("chain", gravity=(0.0, -G))
    above = fmbd.ground
    for i, mass in enumerate(masses):
        body = fmbd.RigidBody(f"mass {i}", mass, 0.1 * mass, position=(i + 1) * DIRECTION)
        weight = sum(masses[i:]) * G * np.cos(ANGLE)
        ends = {"point_a": i * DIRECTION, "point_b": (i + 1) * DIRECTION}
        scene.add(body, fmbd.Spring(f"tie {i}", above, body, **ends, stiffness=k, damping=c, length=1.0 - weight / k))
        scene.sensor(f"place {i}", fmbd.position(body))
        above = body
    return scene


def on_rigid_links(masses: Sequence[float]) -> np.ndarray:
    """Places of the masses at the end, (n, 2): angles of links by Lagrange's equations."""
    n, m = len(masses), np.array(masses)
    below = np.array([m[i:].sum() for i in range(n)])
    shared = below[np.maximum.outer(np.arange(n), np.arange(n))]

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        angle, rate = y[:n], y[n:]
        between = angle[:, None] - angle
        pull = -(shared * np.sin(between)) @ rate**2 - G * below * np.sin(angle)
        return np.concatenate((rate, np.linalg.solve(shared * np.cos(between), pull)))

    start = np.concatenate((np.full(n, ANGLE), np.zeros(n)))
    angle = solve_ivp(rates, (0.0, END), start, method="DOP853", rtol=1e-10, atol=1e-12).y[:n, -1]
    return np.cumsum(np.stack((np.sin(angle), -np.cos(angle)), axis=-1), axis=0)


def error(run: Any, masses: Sequence[float]) -> float:
    exact = on_rigid_links(masses)
    return max(float(np.abs(run[f"place {i}"][-1] - x).max()) for i, x in enumerate(exact))


@pytest.mark.parametrize("damping", [0.0, 1e-6], ids=["undamped", "damped"])
@pytest.mark.parametrize("k", [1e8, 1e10, 1e12, 1e14])
@pytest.mark.parametrize("masses", [(1.0, 1e-3), (1e-3, 1.0), (1e-3, 1.0, 1e-3, 1.0)], ids=str)
def test_stiff_ties(masses: tuple[float, ...], k: float, damping: float) -> None:
    """The error does not grow with the stiffness, nor does Newton's work; nothing is repeated in parts."""
    run = fmbd.solve(chain(masses, k, damping * k), t_end=END, dt=1e-2)
    assert error(run, masses) <= 3.5e-4
    assert run.counters["newton_iterations"] <= 4.5 * run.counters["steps"]
    assert not run.counters["halved_steps"] and not run.warnings


@pytest.mark.parametrize("loaded", [True, False])
def test_reactions_push_across(loaded: bool) -> None:
    """A gram on a rigid link carries a tonne on a stiff spring: what the link pulls across it is in the matrix at once."""
    masses = (1e-3, 1e3)
    scene = fmbd.Scene("tonne", gravity=(0.0, -G))
    light, heavy = (fmbd.RigidBody(f"mass {i}", m, 0.1 * m, position=(i + 1) * DIRECTION) for i, m in enumerate(masses))
    link = fmbd.distance("link", fmbd.ground, light, point_a=(0.0, 0.0), point_b=DIRECTION, length=1.0)
    stretched = 1e3 * G * np.cos(ANGLE) / 1e10 if loaded else 0.0
    ends = {"point_a": DIRECTION, "point_b": 2 * DIRECTION}
    scene.add(light, heavy, link, fmbd.Spring("tie", light, heavy, **ends, stiffness=1e10, length=1.0 - stretched))
    for i, body in enumerate((light, heavy)):
        scene.sensor(f"place {i}", fmbd.position(body))

    run = fmbd.solve(scene, t_end=END, dt=1e-2)
    assert error(run, masses) <= 3.5e-4
    assert not run.counters["halved_steps"] and not run.warnings


@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()], ids=lambda x: type(x).__name__)
def test_without_compiled_steps(form: Any) -> None:
    masses = (1.0, 1e-3)
    scheme = fmbd.GeneralizedAlpha(form=form, compiled=False)
    run = fmbd.solve(chain(masses, 1e13), t_end=END, dt=5e-3, scheme=scheme)
    assert error(run, masses) <= 8e-5 and not run.warnings


def test_slack_ties_need_no_tangent() -> None:
    """A net that is held at its side falls: pulls of slack springs change much, and are not worth a second tangent of a step."""
    scene, at = fmbd.Scene("net", gravity=(0.0, -G)), {}
    for i, j in np.ndindex(4, 3):
        at[i, j] = fmbd.PointMass(f"{i} {j}", 0.05, (0.1 * i, 0.1 * j)) if i else fmbd.ground
        if i:
            scene.add(at[i, j])
    law = {"stiffness": 500.0, "damping": 0.5, "length": 0.1}
    for (i, j), one in at.items():
        for k, m in {(i + 1, j), (i, j + 1)} & at.keys() if i else {(1, j)}:
            ends = (0.1 * i, 0.1 * j), (0.1 * k, 0.1 * m)
            scene.add(fmbd.Spring(f"{i} {j} {k} {m}", one, at[k, m], *ends, **law))

    counters = fmbd.solve(scene, t_end=0.3, dt=1e-3).counters
    assert counters["newton_iterations"] > 1.5 * counters["steps"]
    assert counters["core_factorisations"] < 1.1 * counters["steps"]


def test_springs_that_do_not_turn_take_one_tangent_a_step() -> None:
    """Those in hinges, in steps of NumPy as in compiled ones: a second matrix is for what an increment has changed."""
    scene, above = fmbd.Scene("hinges", gravity=(0.0, -G)), fmbd.ground
    for k in range(4):
        link = fmbd.RigidBody(f"link {k}", 1.0, 1 / 12, (k + 0.5, 0.0))
        pin = fmbd.revolute(f"pin {k}", above, link, center=(k, 0.0))
        scene.add(link, pin, fmbd.joint_spring(f"spring {k}", fmbd.angle(pin), stiffness=1e4, damping=1.0))
        above = link
    run = fmbd.solve(scene, t_end=0.1, dt=2e-3, scheme=fmbd.GeneralizedAlpha(compiled=False))
    assert run.counters["newton_iterations"] > 1.9 * 50
    assert run.counters["core_factorisations"] < 1.2 * 50
