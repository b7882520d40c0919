"""Wires against analytic values: frequencies and waves of strings and beams, static sag, form finding, slack droppers,
sliding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("dolfinx")
import scipy.linalg as sl
import scipy.sparse.linalg as spl

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.linear.blocks.low_rank import KEPT, SlackFactor
from fmbd_fenicsx.materials import linear_elastic
from fmbd_fenicsx.mechanics.catenary.line_field import LineField
from fmbd_fenicsx.mechanics.catenary.wires import WiresPart
from fmbd_fenicsx.run.built import build
from fmbd_fenicsx.schemes.onestep.alpha.alpha_stepper import AlphaStepper
from fmbd_fenicsx.system.compiled import choice
from fmbd_fenicsx.system.layout import State

WIRE = fmbd.Wire(1.35, 20e3, 195.0)


def dense(field: LineField) -> tuple[np.ndarray, np.ndarray]:
    return field.M[:, :], field.csr().toarray()


def test_frequencies_of_a_tensioned_beam() -> None:
    """omega_n = n pi / L sqrt((T + EI (n pi / L)^2) / mu) with hinged ends, to the Hermite element's order six."""
    L, errors = 60.0, []
    for cells in (20, 40):
        M, K = dense(LineField(fmbd.Wires("w", L, cells, (WIRE,), anchor=1e12)))
        k = 5 * np.pi / L
        exact = k * np.sqrt((20e3 + 195.0 * k**2) / 1.35)
        errors.append(abs(np.sqrt(np.abs(sl.eigh(K, M, eigvals_only=True)[4])) / exact - 1))
    assert errors[1] < 1e-6 and np.log2(errors[0] / errors[1]) > 3.5


@pytest.mark.smoke
def test_static_sag_of_a_string() -> None:
    """mu g L^2 / (8 T) in the middle, and the hinged tensioned beam's correction by EI."""
    L, g = 60.0, 9.81
    field = LineField(fmbd.Wires("w", L, 240, (WIRE,), anchor=1e12))
    w = spl.spsolve(field.csr().tocsc(), -g * field.weight)
    q, T, EI = 1.35 * g, 20e3, 195.0
    r = np.sqrt(T / EI)
    exact = -q * L**2 / (8 * T) + q * EI / T**2 * (1 - 1 / np.cosh(r * L / 2))
    assert (field.row(0, L / 2) @ w)[0] == pytest.approx(exact, rel=1e-6)


def test_hung_wires_are_in_equilibrium_at_the_wanted_sag() -> None:
    droppers = tuple(fmbd.Dropper(1, 0, x, 1e5) for x in (5.0, 15.0, 25.0))
    wires = fmbd.Wires("w", 30.0, 60, (WIRE, fmbd.Wire(1.07, 16e3, 131.7)), (), droppers).hung(lambda x: 1e-4 * x)
    scene = fmbd.Scene("hung", gravity=(0, -9.81), settle=True)
    scene.add(wires)
    scene.sensor("w", fmbd.wire_height(wires, 0, [5.0, 15.0, 25.0]))
    scene.sensor("N", fmbd.dropper_forces(wires))
    run = fmbd.solve(scene, t_end=0.05, dt=0.01)
    assert run["w"] == pytest.approx(np.tile([-5e-4, -15e-4, -25e-4], (6, 1)), abs=1e-9)
    assert run["N"].min() > 0
    with pytest.raises(fmbd.errors.InputError, match="would have to push"):
        wires.hung(lambda x: 0.1 if x == 15.0 else 0.0)


def test_modes_of_two_wires() -> None:
    """Two wires side by side, one of them without bending: n pi / L sqrt((T + E I (n pi / L)^2) / mu)."""
    L = 20.0
    scene = fmbd.Scene("wires", gravity=(0, -9.81))
    scene.add(fmbd.Wires("w", L, 40, (WIRE, fmbd.Wire(1.0, 1e4)), anchor=1e12))
    found = fmbd.modes(scene, 6, at=fmbd.equilibrium(scene))
    k = np.pi / L * np.arange(1, 5)
    exact = np.concatenate((k * np.sqrt((20e3 + 195.0 * k**2) / 1.35), 100.0 * k))
    assert found.omega == pytest.approx(np.sort(exact)[:6], rel=1e-5)


def test_wave_speed() -> None:
    """A pulse on a string reaches a point after distance / sqrt(T / mu)."""
    wire = fmbd.Wire(1.0, 1e4)
    wires = fmbd.Wires("w", 100.0, 400, (wire,))
    pan = fmbd.CoordinateBody(
        "pan", np.eye(1), lambda q, v, t: np.array([200 * np.exp(-(((t - 0.1) / 0.02) ** 2)) - 1e3 * q[0]]), np.zeros(1)
    )
    scene = fmbd.Scene("wave")
    scene.add(wires, pan, fmbd.SlidingContact("c", wires, pan, start=20.0))
    scene.sensor("w", fmbd.wire_height(wires, 0, [30.0, 60.0]))
    run = fmbd.solve(scene, t_end=0.6, dt=5e-4)
    near, far = (run.times[np.argmax(run["w"][:, k])] for k in (0, 1))
    assert 30.0 / (far - near) == pytest.approx(np.sqrt(wire.tension / wire.mass), rel=5e-3)


def moving_load(cells: int, h: float = 5e-4) -> fmbd.Run:
    """A constant force slides along a string at half the wave speed."""
    wires = fmbd.Wires("w", 60.0, cells, (fmbd.Wire(1.35, 20e3, 195.0),))
    pan = fmbd.CoordinateBody("pan", np.diag([1e-3, 1.0]), lambda q, v, t: np.array([100.0, 0.0]), np.zeros(2))
    scene = fmbd.Scene("moving load", settle=True)
    scene.add(wires, pan, fmbd.SlidingContact("c", wires, pan, start=10.0, speed=60.0, ramp=0.2, idle=1))
    scene.sensor("force", fmbd.reaction("c"))
    scene.sensor("y", fmbd.coordinates(pan))
    return fmbd.solve(scene, t_end=0.6, dt=h, scheme=fmbd.Unilateral(fmbd.GeneralizedAlpha(0.6)))


def test_element_borders_are_not_felt() -> None:
    """A nearly massless strip under a constant force keeps that force while it crosses some sixty borders."""
    run = moving_load(120)
    assert run["force"] == pytest.approx(100.0, rel=2e-2)
    assert run.counters["contact lost"] == 0


def test_height_under_a_moving_force_converges_with_the_mesh() -> None:
    y = [moving_load(n)["y"][-1, 0] for n in (120, 240, 480)]
    assert abs(y[2] - y[1]) < 0.2 * abs(y[1] - y[0])


def test_contact_is_lost_and_found() -> None:
    """A pan head that is pulled down leaves the wire, flies, and returns; the force is never negative."""
    wires = fmbd.Wires("w", 20.0, 40, (fmbd.Wire(1.0, 1e4),))
    pan = fmbd.CoordinateBody(
        "pan", np.diag([2.0, 1.0]), lambda q, v, t: np.array([50.0 - 400.0 * (0.2 < t < 0.23), 0.0]), np.zeros(2)
    )
    scene = fmbd.Scene("bounce", settle=True)
    scene.add(wires, pan, fmbd.SlidingContact("c", wires, pan, start=10.0, idle=1))
    scene.sensor("force", fmbd.reaction("c"))
    scene.sensor("y", fmbd.coordinates(pan))
    scene.sensor("w", fmbd.wire_height(wires, 0, 10.0))
    run = fmbd.solve(scene, t_end=0.8, dt=1e-3, scheme=fmbd.Unilateral(fmbd.GeneralizedAlpha(0.6)))
    open_ = run["force"][:, 0] == 0
    assert run.counters["contact lost"] >= 1 and run.counters["contact found"] >= 1
    assert run["force"].min() >= 0 and open_.any() and not open_[-1]
    gap = (run["w"] - run["y"][:, :1])[:, 0]
    assert gap.min() > -1e-9 and gap[open_].max() > 1e-3
    assert abs(gap[~open_]).max() < 1e-9


def test_steps_under_a_contact_are_made_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whose sizes do not add up to that of the whole step: the state is set to the time where it ends."""
    advance = AlphaStepper.advance

    def fails(self: AlphaStepper, h: float) -> State:
        if h > 0.6e-3:
            raise ConvergenceError("too large")
        return advance(self, h)

    monkeypatch.setattr(AlphaStepper, "advance", fails)
    wires = fmbd.Wires("w", 20.0, 40, (fmbd.Wire(1.0, 1e4),))
    pan = fmbd.CoordinateBody("pan", np.diag([2.0, 1.0]), lambda q, v, t: np.array([50.0, 0.0]), np.zeros(2))
    scene = fmbd.Scene("bounce", settle=True)
    scene.add(wires, pan, fmbd.SlidingContact("c", wires, pan, start=10.0, idle=1))
    scheme = fmbd.Unilateral(fmbd.GeneralizedAlpha(0.6, compiled=False))
    run = fmbd.solve(scene, t_end=0.02, dt=1e-3, scheme=scheme)
    assert run.counters["halved_steps"] and run.times == pytest.approx(np.linspace(0.0, 0.02, 21), abs=1e-12)


def test_each_of_two_heads_on_a_wire_is_lost_and_found() -> None:
    """Only the second is pulled down: it leaves the wire and returns, the first stays."""
    wires = fmbd.Wires("w", 20.0, 20, (fmbd.Wire(1.0, 1e4),))
    scene = fmbd.Scene("pair", settle=True)
    scene.add(wires)
    for name, place, pull in (("first", 6.0, 0.0), ("second", 14.0, 400.0)):
        pan = fmbd.CoordinateBody(
            name,
            np.diag([2.0, 1.0]),
            lambda q, v, t, f=pull: np.array([50.0 - f * (0.02 < t < 0.05), 0.0]),
            np.zeros(2),
        )
        scene.add(pan, fmbd.SlidingContact(f"on {name}", wires, pan, start=place, idle=1))
        scene.sensor(f"force {name}", fmbd.reaction(f"on {name}"))
        scene.sensor(f"y {name}", fmbd.coordinates(pan))
        scene.sensor(f"w {name}", fmbd.wire_height(wires, 0, place))
    run = fmbd.solve(scene, t_end=0.5, dt=1e-3, scheme=fmbd.Unilateral(fmbd.GeneralizedAlpha(0.6)))
    flying = run["force second"][:, 0] == 0
    assert run["force first"].min() > 0.0 and flying.any() and not flying[-1]
    assert run.counters["contact lost"] >= 1 and run.counters["contact found"] >= 1
    gaps = {name: (run[f"w {name}"] - run[f"y {name}"][:, :1])[:, 0] for name in ("first", "second")}
    assert np.abs(gaps["first"]).max() < 1e-9 and np.abs(gaps["second"][~flying]).max() < 1e-9
    assert gaps["second"].min() > -1e-9 and gaps["second"][flying].max() > 1e-4


def test_solves_with_slack_droppers_are_judged() -> None:
    """Against a dense solve; a damaged correction does not pass."""
    from fmbd_fenicsx.linear.blocks.low_rank import SlackFactor

    droppers = tuple(fmbd.Dropper(1, 0, x, 1e5) for x in (5.0, 15.0, 25.0))
    field = LineField(fmbd.Wires("w", 30.0, 60, (WIRE, fmbd.Wire(1.07, 16e3)), (), droppers))
    slack = np.array([0, 2])
    factor = SlackFactor(field, 3.0, 2e-3, slack)
    M, K = dense(field)
    B = field.B[slack].toarray()
    E = 3.0 * M + 2e-3 * (K - B.T @ (1e5 * B))
    b = np.sin(np.arange(field.n))
    assert factor.solve(b) == pytest.approx(np.linalg.solve(E, b), rel=1e-8, abs=1e-12)
    assert 0 < factor.judge.worst < 1e-10 and factor.judge.solves == 1
    factor.Y = factor.Y * (1 + 1e-5)
    with pytest.raises(fmbd.errors.LinearSolveError, match="wires"):
        factor.solve_columns(b[:, None])
    field.destroy()
    assert not field.factors


def test_factors_are_freed_after_a_run() -> None:
    run = moving_load(60, h=5e-3)
    assert run.system.fields and all(not part.field.factors for _, part in run.system.fields)


@pytest.mark.mpi
def test_stabilised_form_keeps_the_velocities_on_the_wire() -> None:
    """Index 3 leaves the speed across the sliding contact to the errors of the step; GGL holds it, with the same force."""
    wires = fmbd.Wires("w", 60.0, 120, (WIRE,))
    made = []
    for form in (fmbd.Index3(), fmbd.GGL()):
        pan = fmbd.CoordinateBody(
            "pan", np.diag([5.0, 1.0]), lambda q, v, t: np.array([100.0 + 20 * np.sin(30 * t), 0.0]), np.zeros(2)
        )
        scene = fmbd.Scene("forms", settle=True)
        scene.add(wires, pan, fmbd.SlidingContact("c", wires, pan, start=10.0, speed=60.0, ramp=0.2, idle=1))
        scene.sensor("y", fmbd.coordinates(pan))
        scheme = fmbd.Unilateral(fmbd.GeneralizedAlpha(0.6, form=form))
        made.append(fmbd.solve(scene, t_end=0.3, dt=2e-3, scheme=scheme))
    plain, stabilised = made
    assert stabilised.drift[1] < 1e-2 * plain.drift[1]
    assert stabilised["y"][:, 0] == pytest.approx(plain["y"][:, 0], abs=1e-2 * np.ptp(plain["y"][:, 0]))


@pytest.mark.mpi
def test_inner_products_count_wires_once(rod_mesh: Any) -> None:
    """Each rank holds the wires whole, but only its nodes of a body beside them."""
    block = fmbd.FloatingBody("block", rod_mesh(dim=2, h=0.5), density=1e3, elastic=linear_elastic(1e6, 0.3))
    scene = fmbd.Scene("beside wires")
    scene.add(fmbd.Wires("w", 20.0, 40, (WIRE,)), block)
    system = build(scene).system
    (_, field), (_, wires) = system.fields
    components = system.n_core + field.comm.allreduce(field.n) + wires.n
    assert system.dot(np.ones(system.n_v), np.ones(system.n_v)) == components


def test_factors_in_use_are_not_freed() -> None:
    """Schemes with several sizes of steps hold more factors than the field keeps; those that nobody holds are freed."""
    field, none = LineField(fmbd.Wires("w", 20.0, 4, (WIRE,))), np.zeros(0, dtype=int)
    held = [SlackFactor(field, 1.0, 1e-6 * 2.0**k, none) for k in range(KEPT + 3)]
    for factor in held:
        factor.solve(np.ones(field.n))  # judged by its residual
    for factor in held:
        factor.destroy()
    SlackFactor(field, 2.0, 1e-6, none)
    assert len(field.factors) == KEPT
    field.destroy()


def sliding(case: str) -> fmbd.Scene:
    """Two heads that slide along a wire under another one: held, with one that is pulled off (``lost``), or pushed so that
    droppers go ``slack``.
    """
    scene = fmbd.Scene(case, gravity=(0, -9.81), settle=True)
    droppers = tuple(fmbd.Dropper(1, 0, x, 1e5) for x in (5.0, 10.0, 15.0)) if case == "slack" else ()
    wires = fmbd.Wires("w", 20.0, 40, (WIRE, fmbd.Wire(1.07, 16e3, 130.0)), (), droppers, 0.01, 1e-4)
    wires = wires.hung(0.01) if droppers else wires
    scene.add(wires)
    push = 300.0 if case == "slack" else 20.0
    for name, start, pull in (("first", 2.0, 0.0), ("second", 8.0, 600.0 if case == "lost" else 0.0)):

        def force(q: Any, v: Any, t: Any, pull: float = pull) -> Any:
            pushed = 90.0 + push * np.sin(40 * t) - pull * (0.02 < t < 0.05)
            return np.array([pushed - 300 * v[0] - 1000 * q[0], 0.0])

        head = fmbd.CoordinateBody(name, np.diag([5.0, 1.0]), force, np.zeros(2))
        scene.add(head, fmbd.SlidingContact(f"on {name}", wires, head, start=start, speed=20.0, ramp=0.1, idle=1))
        scene.sensor(f"force {name}", fmbd.reaction(f"on {name}"))
    scene.sensor("w", fmbd.wire_height(wires, 0, [5.0, 12.0]))
    scene.sensor("droppers", fmbd.dropper_forces(wires))
    return scene


@pytest.mark.parametrize(
    ("case", "form"),
    [("held", fmbd.GGL()), ("lost", fmbd.Index3()), ("lost", fmbd.GGL()), ("slack", fmbd.Index3())],
    ids=["held, GGL", "lost, index 3", "lost, GGL", "slack, index 3"],
)
def test_compiled_steps_of_wires_are_those_of_numpy(case: str, form: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two heads on one wire, contact that is lost and found, and slack droppers."""
    made, advance = [0], AlphaStepper.advance

    def counted(self: AlphaStepper, h: float) -> State:
        made[0] += 1
        return advance(self, h)

    monkeypatch.setattr(AlphaStepper, "advance", counted)
    runs = []
    for compiled in (False, True):
        made[0] = 0
        scheme: Any = fmbd.GeneralizedAlpha(0.5, form=form, compiled=compiled)
        scheme = fmbd.Unilateral(scheme) if case == "lost" else scheme
        runs.append(fmbd.solve(sliding(case), t_end=0.15, dt=1e-3, scheme=scheme))
    numpys, compiled = runs
    changes = sum(compiled.counters.get(f"contact {x}", 0) for x in ("lost", "found"))
    assert made[0] <= changes + 1 and (changes > 0) == (case == "lost")
    for counter in ("newton_iterations", "contact lost", "contact found"):
        assert compiled.counters.get(counter) == numpys.counters.get(counter)
    assert (numpys["droppers"] == 0.0).any() == (case == "slack")
    assert compiled.counters["back_solves"] < 1.2 * numpys.counters["back_solves"]  # none for tangents that are at hand
    assert compiled["w"] == pytest.approx(numpys["w"], rel=1e-12, abs=1e-13)
    assert compiled["droppers"] == pytest.approx(numpys["droppers"], rel=1e-12, abs=1e5 * 1e-13)
    for kind, energy in numpys.energy.items():
        assert compiled.energy[kind] == pytest.approx(energy, rel=1e-12, abs=1e-10)
    for name in ("force first", "force second"):  # of roundoff of places over the square of a step
        assert compiled[name] == pytest.approx(numpys[name], rel=1e-12, abs=1e-15 * 5.0 / 1e-3**2)


@pytest.mark.parametrize(
    ("scheme", "case", "t_end", "dt"),
    [
        (fmbd.Radau(2, rtol=None), "slack", 0.06, 1e-3),
        (fmbd.Radau(3, rtol=1e-5), "held", 0.1, None),
        (fmbd.BDF(2, rtol=None), "lost", 0.06, 1e-3),
        (fmbd.BDF(rtol=1e-4), "held", 0.05, None),
        (fmbd.Rattle(), "held", 0.01, 1e-4),
        (fmbd.HalfExplicit(rtol=None), "held", 0.005, 1e-4),
    ],
    ids=lambda x: getattr(x, "name", None),
)
def test_all_schemes_make_compiled_steps_of_wires(
    scheme: Any, case: str, t_end: float, dt: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of NumPy, which is asked for no forces; ports stand at both times of stages, at which explicit schemes look."""
    asked, force = [0], WiresPart.force

    def counted(self: WiresPart, *given: Any) -> Any:
        asked[0] += 1
        return force(self, *given)

    monkeypatch.setattr(WiresPart, "force", counted)
    same, seen = (
        (1e-6, slice(None)) if dt else (10 * scheme.rtol, slice(-1, None))
    )  # own steps end elsewhere on the way
    scheme = fmbd.Unilateral(scheme) if case == "lost" else scheme
    runs = []
    for states in (choice.driver_states, lambda system: None):
        monkeypatch.setattr(choice, "driver_states", states)
        asked[0] = 0
        runs.append(fmbd.solve(sliding(case), t_end=t_end, dt=dt, scheme=scheme))
        runs[-1].counters["asked"] = asked[0]

    compiled, numpys = runs
    assert compiled.counters["steps"] == numpys.counters["steps"]
    assert compiled.counters["asked"] < compiled.counters["steps"] < numpys.counters["asked"]
    for name in ("w", "droppers", "force first", "force second"):
        size = np.abs(numpys[name]).max(initial=1e-300)
        assert np.abs(compiled[name][seen] - numpys[name][seen]).max(initial=0.0) < same * size, name


def test_moving_force_on_a_beam_under_tension() -> None:
    """F slides with v along a hinged beam at rest: w = sum q_n sin(k_n x), W_n = k_n v < omega_n,

    q_n = 2 F / (mu L (omega_n^2 - W_n^2)) (sin W_n t - W_n / omega_n sin omega_n t).
    """
    L, v, F = 20.0, 40.0, 100.0
    wires = fmbd.Wires("w", L, 40, (WIRE,), anchor=1e12)
    strip = fmbd.CoordinateBody("strip", np.eye(1) * 1e-6, lambda q, v, t: np.array([F]), np.zeros(1))
    scene = fmbd.Scene("moving force")
    scene.add(wires, strip, fmbd.SlidingContact("c", wires, strip, speed=v))
    scene.sensor("w", fmbd.wire_height(wires, 0, [6.0, 12.0]))
    errors = []
    for dt in (1e-3, 5e-4):
        run = fmbd.solve(scene, t_end=0.4, dt=dt, scheme=fmbd.GeneralizedAlpha(0.8))
        assert run.counters["compiled_steps"] == run.counters["steps"]
        k = np.pi / L * np.arange(1, 200)
        omega, W = k * np.sqrt((WIRE.tension + WIRE.bending * k**2) / WIRE.mass), k * v
        t = run.times[:, None]
        modes = 2 * F / (WIRE.mass * L * (omega**2 - W**2)) * (np.sin(W * t) - W / omega * np.sin(omega * t))
        exact = modes @ np.sin(np.outer(k, [6.0, 12.0]))
        errors.append(np.abs(run["w"] - exact).max() / np.abs(exact).max())
    assert errors[1] < 2.5e-3 and errors[0] > 2.0 * errors[1]
