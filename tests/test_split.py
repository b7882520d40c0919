"""FieldSplit in scenes: the whole matrix of a step as named PETSc blocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dolfinx")

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError, LinearSolveError
from fmbd_fenicsx.linear.blocks.elastic_blocks import Bddc, Multigrid
from fmbd_fenicsx.linear.fieldsplit.solver import SplitSolver
from fmbd_fenicsx.linear.presets import FieldSplit

ROOT = Path(__file__).resolve().parents[1]
KIND = {"a": fmbd.AbsoluteBody, "f": fmbd.FloatingBody}


def block(kind: str, name: str, *, cells: int, origin: tuple[float, float] = (0.0, 0.0)):
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.5), cells=cells, origin=origin)
    return KIND[kind](name, mesh, density=1000.0, elastic=fmbd.materials.linear_elastic(1e7, 0.3))


def swinging(kind: str) -> fmbd.Scene:
    """A bar on a pin."""
    scene = fmbd.Scene("swing", gravity=(0, -9.81))
    bar = block(kind, "bar", cells=3)
    scene.add(bar, fmbd.revolute("pin", bar.surface("left"), fmbd.ground, center=(0.0, 0.25)))
    scene.sensor("tip", fmbd.position(bar.surface("right")))
    return scene


def tied(kinds: str) -> fmbd.Scene:
    """A bar that swings on a pin, with another bar tied to it; meshes that do not match."""
    scene = fmbd.Scene("two bars", gravity=(0, -9.81))
    one = block(kinds[0], "one", cells=4)
    two = block(kinds[1], "two", cells=3, origin=(1.0, 0.0))
    scene.add(one, two, fmbd.revolute("pin", one.surface("left"), fmbd.ground, center=(0.0, 0.25)))
    scene.add(fmbd.tie_surface("glue", one.surface("right"), two.surface("left")))
    scene.sensor("tip", fmbd.position(two.surface("right")))
    return scene


def run(scene: fmbd.Scene, linear=None, steps: int = 4) -> fmbd.Run:
    return fmbd.solve(scene, t_end=steps * 5e-3, dt=5e-3, linear=linear)


def per_solve(found: fmbd.Run) -> float:
    """Iterations of one linear solve."""
    return found.counters["saddle_iterations"] / found.counters["newton_iterations"]


@pytest.mark.mpi
@pytest.mark.parametrize(
    "make, kinds, linear, most",
    [
        (swinging, "a", FieldSplit(), 4),
        (swinging, "f", FieldSplit(), 25),
        (swinging, "f", FieldSplit(Multigrid()), 40),
        (swinging, "f", FieldSplit(Bddc()), 40),
        (tied, "aa", FieldSplit(), 35),
        (tied, "fa", FieldSplit(method="fgmres"), 60),
    ],
)
def test_motion_of_direct(make, kinds: str, linear, most: float) -> None:
    """Absolute and floating bodies, a joint and a mortar tie: the motion and the multipliers of Direct()."""
    plain, split = run(make(kinds)), run(make(kinds), linear)
    moved = np.abs(plain["tip"] - plain["tip"][0]).max()
    assert np.abs(split["tip"] - plain["tip"]).max() < 1e-8 * moved
    lam = plain.state.lam
    assert np.abs(split.state.lam - lam).max() < 1e-6 * np.abs(lam).max()
    assert plain.counters["saddle_iterations"] == 0
    assert 1 <= per_solve(split) <= most
    assert split.counters["worst_linear_residual"] <= 100 * linear.rtol


@pytest.mark.mpi
@pytest.mark.parametrize("method", ["fgmres", "gmres"])
def test_stiff_tie_to_a_hub(method: str) -> None:
    """Forces of a stiff tie are large beside what drives them: every step is made whole, in few iterations."""

    def scene() -> fmbd.Scene:
        out = fmbd.Scene("wheel", gravity=(0, -9.81))
        mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.5), cells=4)
        bar = fmbd.FloatingBody("bar", mesh, density=1000.0, elastic=fmbd.materials.linear_elastic(1e11, 0.3))
        hub = fmbd.RigidBody("hub", mass=50.0, inertia=5.0, position=(-0.2, 0.25))
        out.add(bar, hub, fmbd.revolute("pin", hub, fmbd.ground, center=(-0.4, 0.25)))
        out.add(fmbd.tie_surface("glue", bar.surface("left"), hub))
        out.sensor("force", fmbd.reaction("pin"))
        return out

    plain, split = run(scene(), steps=2), run(scene(), FieldSplit(method=method, max_iterations=100), steps=2)
    assert np.abs(split["force"] - plain["force"]).max() < 1e-6 * np.abs(plain["force"]).max()
    assert split.counters.get("halved_steps", 0) == 0
    assert per_solve(split) < 40


@pytest.mark.mpi
def test_right_sides_without_a_residual() -> None:
    """A first residual of zero, which PETSc asks nobody about, is a solution: clamped, without loads."""
    scene = fmbd.Scene("clamped")
    bar = block("a", "bar", cells=2)
    scene.add(bar, fmbd.tie_surface("glue", bar.surface("left"), fmbd.ground))
    for method in ("gmres", "fgmres", "minres"):
        assert np.abs(run(scene, FieldSplit(method=method), steps=1).state.lam).max() == 0.0


def landing(kind: str, friction: float) -> fmbd.Scene:
    """A spinning bar that falls on a floor."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.5), cells=6)
    elastic = fmbd.materials.linear_elastic(1e5, 0.3)
    bar = KIND[kind]("bar", mesh, degree=1, density=1000.0, elastic=elastic, velocity=(0.3, -1.0), angular_velocity=0.2)
    scene, floor = fmbd.Scene("landing"), fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, -0.01), (0.0, 1.0)))
    scene.add(bar, fmbd.contact("floor", bar.surface("bottom"), floor, friction=friction))
    scene.sensor("tip", fmbd.position(bar.surface("right")))
    return scene


@pytest.mark.parametrize(("kind", "friction"), [("a", 0.0), pytest.param("a", 0.3, marks=pytest.mark.mpi), ("f", 0.3)])
def test_contact_of_direct(kind: str, friction: float) -> None:
    """Contact forces by solves with the whole matrix are those by eliminated blocks."""
    made = [
        fmbd.solve(landing(kind, friction), t_end=0.02, dt=1e-3, scheme=fmbd.ContactMidpoint(), linear=linear)
        for linear in (None, FieldSplit(method="fgmres", rtol=1e-10))
    ]
    plain, split = (run.state.contact.impulse for run in made)
    assert np.abs(plain).max() > 1.0
    assert np.abs(split - plain).max() < 1e-7 * np.abs(plain).max()
    assert np.abs(made[1]["tip"] - made[0]["tip"]).max() < 1e-9
    assert made[1].counters["saddle_iterations"] > 0 == made[0].counters["saddle_iterations"]


@pytest.mark.mpi
def test_turned_body() -> None:
    """A nonlinear body that has turned: nodal values are solved in the axes of its factor."""

    def scene() -> fmbd.Scene:
        out = fmbd.Scene("swing", gravity=(0, -9.81))
        mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.5), cells=2)
        law = fmbd.materials.saint_venant_kirchhoff(1e7, 0.3)
        bar = fmbd.AbsoluteBody("bar", mesh, density=1000.0, energy=law)
        out.add(bar, fmbd.revolute("pin", bar.surface("left"), fmbd.ground, center=(0.0, 0.25)))
        out.sensor("tip", fmbd.position(bar.surface("right")))
        return out

    plain, split = (fmbd.solve(scene(), t_end=0.2, dt=2e-2, linear=x) for x in (None, FieldSplit()))
    assert np.abs(split["tip"] - plain["tip"]).max() < 1e-7
    assert per_solve(split) < 6  # a factor in wrong axes would not be one


@pytest.fixture
def option():
    """Sets PETSc options for one test."""
    from petsc4py import PETSc

    names: list[str] = []

    def put(name: str, value: str) -> None:
        PETSc.Options()[name] = value
        names.append(name)

    yield put
    for name in names:
        PETSc.Options().delValue(name)


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["frame", "bar.u", "bar.frame.force"])
def test_options_of_splits(name: str, option) -> None:
    """Each split has its own options; a poorer method there costs iterations and gives the same motion."""
    plain = run(swinging("f"), FieldSplit(), steps=1)
    if name == "bar.u":
        option(f"swing_fieldsplit_{name}_pc_type", "jacobi")
    else:  # these are all but diagonal here: one damped step instead of the solution
        for key, value in (("type", "richardson"), ("max_it", "1"), ("richardson_scale", "0.01")):
            option(f"swing_fieldsplit_{name}_ksp_{key}", value)
    found = run(swinging("f"), FieldSplit(max_iterations=2000), steps=1)
    assert np.abs(found["tip"] - plain["tip"]).max() < 1e-10
    assert per_solve(found) > per_solve(plain)  # equal where the option does nothing


@pytest.mark.mpi
@pytest.mark.parametrize(
    "name, value, message",
    [
        ("fieldsplit_rod.u_pc_type", "jacobi", r"nothing used: -swing_fieldsplit_rod\.u_pc_type jacobi"),
        ("fieldsplit_pin.force_pc_typo", "jacobi", r"nothing used: -swing_fieldsplit_pin\.force_pc_typo"),
        ("bar.u_pc_type", "jacobi", r"nothing used: -swing_bar\.u_pc_type"),
        ("pc_fieldsplit_type", "schur", "splits of a scene are additive"),
        ("pc_type", "lu", "a scene under FieldSplit"),
    ],
)
def test_wrong_options(name: str, value: str, message: str, option) -> None:
    option(f"swing_{name}", value)
    with pytest.raises(InputError, match=message):
        run(swinging("f"), FieldSplit(), steps=1)


@pytest.mark.mpi
def test_what_has_no_splits() -> None:
    """One clear error each: dependent rows, an unknown method, too few iterations, no elastic body."""
    scene = swinging("a")
    scene.add(fmbd.revolute("pin again", scene.bodies["bar"].surface("left"), fmbd.ground, center=(0.0, 0.25)))
    with pytest.raises(InputError, match="constraints that do not depend on each other"):
        run(scene, FieldSplit(), steps=1)
    with pytest.raises(InputError, match=r'method "cg" is none of minres, fgmres, gmres'):
        FieldSplit(method="cg")
    with pytest.raises(LinearSolveError, match=r"after 2 iterations .* Raise FieldSplit\(max_iterations"):
        run(swinging("f"), FieldSplit(max_iterations=2), steps=1)
    rigid = fmbd.Scene("rigid")
    rigid.add(fmbd.RigidBody("stone", mass=1.0, inertia=1.0))
    with pytest.raises(InputError, match="splits elastic bodies; this scene has none"):
        fmbd.solve(rigid, t_end=0.1, dt=0.1, linear=FieldSplit())


def test_work_is_counted_from_nothing():
    system, _, _ = swinging("f").build()
    assert SplitSolver(system, FieldSplit(), "fresh_").iterations == 0
