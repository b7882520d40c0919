"""The compiled step against the NumPy step, its fallbacks, and its cache."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_mobility import slider_crank

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.schemes.onestep.alpha.alpha_stepper import AlphaStepper
from fmbd_fenicsx.schemes.onestep.alpha.compiled_stepper import CompiledAlphaStepper
from fmbd_fenicsx.schemes.onestep.alpha.generalized_alpha import GeneralizedAlpha
from fmbd_fenicsx.system.layout import State

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.compiled


def chain(n: int) -> fmbd.Scene:
    e = np.array([0.8, -0.6])
    scene = fmbd.Scene("chain", gravity=(0.3, -9.81))
    links = [fmbd.RigidBody(f"{i}", 0.1 + 0.01 * (i % 3), 1e-4, (i + 0.5) * 0.1 * e, -0.6435) for i in range(n)]
    scene.add(*links)
    for i, (a, b) in enumerate(zip([fmbd.ground, *links], links, strict=False)):
        scene.add(fmbd.revolute(f"pin {i}", a, b, center=i * 0.1 * e))
    return scene


def mixed() -> fmbd.Scene:
    """Every elementary constraint, two drives, a locked body and a loop."""
    scene = slider_crank(2.0, 0.7, 0.0)
    scene.gravity = (0.0, -9.81)
    base = fmbd.RigidBody("base", 1.0, 1.0, position=(3.0, 2.0), rotation=0.3, locked=True)
    bob = fmbd.RigidBody("bob", 0.5, 0.1, position=(3.0, 1.0), rotation=0.2)
    cart = fmbd.RigidBody("cart", 0.5, 0.1, position=(-2.0, 0.0), rotation=0.1)
    bead = fmbd.RigidBody("bead", 0.5, 0.1, position=(-2.0, 0.5))
    scene.add(base, bob, cart, bead, fmbd.distance("rod", base, bob, length=1.0))
    scene.add(fmbd.drive_rotation("motor", fmbd.ground, scene.bodies["crank"], lambda t: 3 * t + t**2))
    scene.add(fmbd.prismatic("rail", fmbd.ground, cart, axis=(1, 0.2), center=(-2.0, 0.0)))
    scene.add(
        fmbd.drive_translation(
            "push", fmbd.ground, cart, lambda t: 0.2 * np.sin(3 * t), axis=(1, 0.2), center=(-2.0, 0.0)
        )
    )
    scene.add(fmbd.point_on_line("wire", cart, bead, axis=(1, 0.3), center=(-2.0, 0.5)))
    return scene


def pair(scene: Any, form: Any = None, **options: Any) -> tuple[fmbd.Run, fmbd.Run]:
    """The compiled and the NumPy run; ``form``: index 3 without one."""
    schemes = [GeneralizedAlpha(0.8, compiled=c, form=form or fmbd.Index3()) for c in (True, False)]
    runs = [fmbd.solve(scene(), scheme=scheme, **options) for scheme in schemes]
    return runs[0], runs[1]


@pytest.mark.parametrize(
    "make", [lambda: chain(1), lambda: chain(6), lambda: chain(40), mixed], ids="1 6 40 mixed".split()
)
def test_same_digits_as_numpy(make: Any) -> None:
    """Equal to roundoff: in q a few units, in a and lambda those over h^2."""
    fast, slow = pair(make, t_end=0.3, dt=1e-3)
    assert fast.counters["newton_iterations"] == slow.counters["newton_iterations"]
    assert fast.counters["core_factorisations"] == slow.counters["core_factorisations"]
    for name, bar in (("q", 1e-12), ("v", 1e-9), ("a", 1e-6), ("lam", 1e-6)):
        x, y = getattr(fast.state, name), getattr(slow.state, name)
        assert np.abs(x - y).max() < bar * np.abs(y).max(), name
    assert fast.local_error == pytest.approx(slow.local_error, rel=1e-5)


def stepper_of(scene: fmbd.Scene, scheme: GeneralizedAlpha | None = None) -> AlphaStepper:
    from fmbd_fenicsx.linear.condensation import StepSolver
    from fmbd_fenicsx.schemes.consistent import consistent

    system, given, _ = scene.build()
    solver = StepSolver(system)
    start, _ = consistent(system, given, solver)
    return (scheme or GeneralizedAlpha()).stepper(system, solver, fmbd.Newton(), start)


def test_kernel_is_used_where_it_can_and_only_there() -> None:
    assert isinstance(stepper_of(chain(3)), CompiledAlphaStepper)
    assert not isinstance(stepper_of(chain(3), GeneralizedAlpha(0.8, compiled=False)), CompiledAlphaStepper)
    spring = chain(2)
    spring.add(fmbd.Spring("s", *spring.bodies.values(), (0, 1), (1, 0), 1.0))
    assert isinstance(stepper_of(spring), CompiledAlphaStepper)
    geared = chain(2)
    turn = fmbd.angle(geared.joints["pin 1"])
    geared.add(fmbd.gear("teeth", fmbd.angle(geared.joints["pin 0"]), turn, ratio=2.0))
    assert isinstance(stepper_of(geared), CompiledAlphaStepper)
    twice = chain(1)
    twice.add(fmbd.revolute("again", fmbd.ground, twice.bodies["0"], center=(0, 0)))
    assert isinstance(stepper_of(twice), CompiledAlphaStepper)  # redundant rows


def test_steps_may_alternate_between_both() -> None:
    """Steps handed back to NumPy, and a state put in from outside, keep the history of the predictor."""
    a, b = stepper_of(chain(5)), stepper_of(chain(5), GeneralizedAlpha(0.8, compiled=False))
    for k in range(40):
        if k % 3 == 1:
            AlphaStepper.advance(a, 1e-3)
        else:
            a.advance(1e-3)
        b.advance(1e-3)
        if k == 20:
            a.A, a._past, a.state = a.A.copy(), list(a._past), State(*vars(a.state).values())
    assert np.abs(a.state.q - b.state.q).max() < 1e-13
    assert np.abs(a.A - b.A).max() < 1e-7 * np.abs(b.A).max()
    assert a.newton.iterations == b.newton.iterations


def test_failure_reads_as_in_numpy() -> None:
    """A step that one iteration does not solve, nor any part of it, fails with the message of the NumPy path."""
    with pytest.raises(ConvergenceError, match="Newton stopped at t = .*joint"):
        fmbd.solve(mixed(), t_end=30.0, dt=0.5, newton=fmbd.Newton(max_iterations=1))


def test_without_compiler_numpy_does_it(tmp_path: Path) -> None:
    code = (
        "import sys; sys.path.insert(0, 'tests')\n"
        "from fmbd_fenicsx.system.compiled.library import driver_library\n"
        "from test_compiled import chain, fmbd\n"
        "assert driver_library(2) is None\n"
        "assert fmbd.solve(chain(2), t_end=0.01, dt=1e-3).counters['steps'] == 10\n"
        "mesh = fmbd.read_gmsh('meshes/rod.py', dim=2, h=0.5, length=1.0, height=0.1)\n"
        "steel = fmbd.materials.plane_stress(1.2345e9, 0.3)\n"
        "scene = fmbd.Scene('rod')\n"
        "scene.add(fmbd.FloatingBody('rod', mesh, density=1000.0, elastic=steel))\n"
        "try:\n"
        "    fmbd.solve(scene, t_end=0.01, dt=1e-3)\n"
        "except fmbd.errors.FmbdError as error:\n"
        "    assert 'FEniCSx needs a C compiler' in str(error) and 'no-such-compiler' in str(error)\n"
        "else:\n"
        "    raise AssertionError('it runs')\n"
    )
    import os

    env = os.environ | {"CC": "no-such-compiler", "XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_sparse_saddle_keeps_its_pattern() -> None:
    """The sparse core with the order of the first factorisation: the dense solution, also when the pattern changes."""
    import scipy.sparse as sp

    from fmbd_fenicsx.linear.core import CoreSolver
    from fmbd_fenicsx.linear.residual import Judge

    rng = np.random.default_rng(3)
    solver = CoreSolver(Judge("a test"))
    for extra in (0.0, 0.0, 0.5):
        A = sp.csr_matrix(np.diag(rng.uniform(1, 5, 30)) + extra * np.eye(30, k=1) + extra * np.eye(30, k=-1))
        G = sp.random(10, 30, 0.3, format="csr", rng=3) + sp.csr_matrix(np.eye(10, 30))
        b, c = rng.standard_normal(30), rng.standard_normal(10)
        solver.factor(A, G)
        x, y = solver.solve(b, c)
        K = np.block([[A.toarray(), G.toarray().T], [G.toarray(), np.zeros((10, 10))]])
        assert np.abs(np.concatenate((x, y)) - np.linalg.solve(K, np.concatenate((b, c)))).max() < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("compiled_step, steps", [(True, 1_000_000), (False, 20_000)])
def test_pendulum_over_many_steps(compiled_step: bool, steps: int) -> None:
    """The constraint at roundoff, velocities and energy bounded, memory flat over a million steps of h = 0.01."""
    import resource

    theta = 2.0
    bob = fmbd.RigidBody("bob", 1.0, 1.0, (np.sin(theta), -np.cos(theta)))
    scene = fmbd.Scene("pendulum", gravity=(0, -1.0))
    scene.add(bob, fmbd.distance("rod", fmbd.ground, bob, point_a=(0, 0), length=1.0))
    stepper = stepper_of(scene, GeneralizedAlpha(0.8, compiled=compiled_step))
    worst = {"gap": 0.0, "slip": 0.0, "energy": 0.0}
    start = stepper.system.at(0.0, stepper.state.q, stepper.state.v).energies()
    for k in range(steps):
        s = stepper.advance(0.01)
        if k == 10_000:
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        x, v = s.q[:2], s.v[:2]
        worst["gap"] = max(worst["gap"], abs(float(x @ x) - 1.0))
        worst["slip"] = max(worst["slip"], abs(float(x @ v)))
        worst["energy"] = max(
            worst["energy"], abs(0.5 * float(v @ v) + float(x[1]) - start["kinetic"] - start["weight"])
        )
    assert worst["gap"] < 1e-13
    assert worst["slip"] < 1e-4
    assert worst["energy"] < 5e-4
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < 10 * 1024  # KiB


def test_angles_between_bodies_that_are_turned_at_the_start() -> None:
    """A torsion spring between two bodies, both given at an angle: it is relaxed there, on both paths."""

    def scene() -> fmbd.Scene:
        made = fmbd.Scene("turned", gravity=(0.0, -9.81))
        one = fmbd.RigidBody("one", 1.0, 0.1, (0.5, 0.0), 0.4)
        two = fmbd.RigidBody("two", 1.0, 0.1, (1.5, 0.0), 1.1)
        joint = fmbd.revolute("joint", one, two, center=(1.0, 0.0))
        made.add(one, two, joint, fmbd.revolute("pin", fmbd.ground, one, center=(0.0, 0.0)))
        made.add(fmbd.joint_spring("spring", fmbd.angle(joint), stiffness=20.0, damping=0.1))
        made.sensor("turn", fmbd.angle(joint))
        return made

    fast, slow = pair(scene, t_end=0.05, dt=1e-3)
    assert fast.counters["compiled_steps"] > 0 == slow.counters.get("compiled_steps", 0)
    assert fast["turn"] == pytest.approx(slow["turn"], abs=1e-11) and np.abs(fast["turn"]).max() > 1e-4


def test_dear_factors_serve_on_over_steps() -> None:
    """A lattice of masses on springs takes few factors, and moves as with one in each step; where springs become a hundred
    times as stiff within a step the factor at hand serves no longer.
    """
    size, h, steps, much = 5, 1e-3, 40, 0.0215  # masses along an edge; s; the time of the change, s

    def lattice(law: bool) -> fmbd.Scene:
        scene, at = fmbd.Scene("lattice", gravity=(0.0, 0.0, -9.81)), {}
        for i in np.ndindex(size, size, size):
            at[i] = fmbd.PointMass(f"{i}", 0.05, 0.1 * np.array(i)) if i[0] else fmbd.ground
            scene.add(*([at[i]] if i[0] else []))
        of: dict[str, Any] = {"stiffness": 500.0, "damping": 0.5}
        if law:
            of = {"law": lambda s, rate, t: (500.0 if t < much else 5e4) * s + 0.5 * rate}
        for i in at:
            for j in (tuple(map(int, np.add(i, axis))) for axis in np.eye(3, dtype=int)):
                if j in at and (i[0] or j[0]):
                    ends = 0.1 * np.array(i), 0.1 * np.array(j)
                    scene.add(fmbd.Spring(f"{i} {j}", at[i], at[j], *ends, length=0.09, **of))
        return scene

    for law, most in ((False, 0.2), (True, 1.2)):
        stepper = stepper_of(lattice(law), GeneralizedAlpha(0.8))
        for _ in range(steps):
            stepper.advance(h)
        output = fmbd.Output(progress=False, estimate_error=False)
        run = fmbd.solve(lattice(law), t_end=steps * h, dt=h, scheme=GeneralizedAlpha(0.8), output=output)
        assert run.counters["core_factorisations"] < most * steps, law
        assert run.counters["compiled_steps"] == steps and not run.counters["halved_steps"]
        assert run.counters["newton_iterations"] < 2.5 * steps
        for name, bar in (("q", 1e-8), ("v", 1e-6), ("a", 1e-6)):
            kept, fresh = getattr(run.state, name), getattr(stepper.state, name)
            assert np.abs(kept - fresh).max() < bar * np.abs(fresh).max(), (law, name)


def test_dear_factors_are_given_up_when_they_take_more_increments() -> None:
    """A net of masses on rods that swings down; kept whatever they take, its factors take 2.2 increments a step."""
    size, steps, scene = 14, 100, fmbd.Scene("net", gravity=(0.0, 0.0, -9.81))
    at: dict[tuple[int, ...], Any] = {}
    for i in np.ndindex(size, size):
        at[i] = scene.add(fmbd.PointMass(f"{i}", 0.05, (0.1 * i[0], 0.1 * i[1], 0.0))) if i[0] else fmbd.ground
    for i in at:
        for j in ((i[0] + 1, i[1]), (i[0], i[1] + 1)):
            if j in at and j[0]:
                ends = {f"point_{name}": (0.1 * k[0], 0.1 * k[1], 0.0) for name, k in (("a", i), ("b", j))}
                scene.add(fmbd.distance(f"{i} {j}", at[i], at[j], **ends))
    output = fmbd.Output(progress=False, estimate_error=False)
    run = fmbd.solve(scene, t_end=0.1, dt=1e-3, scheme=GeneralizedAlpha(0.8), output=output)
    assert run.counters["compiled_steps"] == steps and run.counters["core_factorisations"] < 0.5 * steps
    assert run.counters["newton_iterations"] < 2.12 * steps
