"""The two ways to solve the contact problem of a step, columns and products, give the same motion."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.linear.complementarity import delassus
from fmbd_fenicsx.linear.complementarity.coulomb import ContactCounts, solve_friction
from fmbd_fenicsx.linear.complementarity.coulomb_matrix_free import solve_many
from fmbd_fenicsx.schemes.impacts.elastic_contact_stepper import ElasticContactStepper

ROOT = Path(__file__).resolve().parents[1]
BLOCK = ROOT / "meshes/block.py"
LINEAR = fmbd.materials.linear_elastic(100.0, 0.3)


def neo_hookean(u: Any, dx: Any) -> Any:
    from ufl import Identity, det, grad, inner, ln

    mu, lmbda = fmbd.materials.lame(100.0, 0.3)
    F = Identity(len(u)) + grad(u)
    J = det(F)
    return (mu / 2 * (inner(F, F) - len(u) - 2 * ln(J)) + lmbda / 2 * (J - 1) ** 2) * dx


def tilted(kind: str, dim: int) -> Any:
    """A spinning block close above a floor."""
    size = (1.0, 0.5) if dim == 2 else (1.0, 1.0, 0.5)
    mesh = fmbd.read_gmsh(BLOCK, size=size, cells=10 if dim == 2 else 5, origin=(0.0,) * dim)
    speed = (0.0,) * (dim - 1) + (-0.5,)
    spin = 0.3 if dim == 2 else (0.2, 0.3, 0.0)
    make = fmbd.FloatingBody if kind == "floating" else fmbd.AbsoluteBody
    law = {"energy": neo_hookean} if kind == "nonlinear" else {"elastic": LINEAR}
    return make("block", mesh, degree=1, density=1.0, velocity=speed, angular_velocity=spin, **law)


def on_a_plate(kind: str, dim: int, friction: float = 0.0) -> fmbd.Scene:
    """The block falls on a plate, a rigid body that carries the obstacle."""
    body, up = tilted(kind, dim), np.eye(dim)[-1]
    inertia = 0.1 if dim == 2 else (0.1, 0.1, 0.1)
    plate = fmbd.RigidBody("plate", 1.0, inertia, position=tuple(-0.06 * up))
    box = fmbd.Obstacle("plate", fmbd.Box((3.0,) * (dim - 1) + (0.1,)), on=plate)
    scene = fmbd.Scene("drop")
    face = body.surface("bottom" if dim == 2 else "back")
    scene.add(body, plate, fmbd.contact("hit", face, box, friction=friction))
    return scene


def on_a_block(kind: str, dim: int, friction: float = 0.0) -> fmbd.Scene:
    """The block falls on another one."""
    body = tilted(kind, dim)
    low = fmbd.read_gmsh(BLOCK, size=(1.2,) * (dim - 1) + (0.3,), cells=4, origin=(-0.1,) * (dim - 1) + (-0.31,))
    other = fmbd.AbsoluteBody("low", low, degree=1, density=1.0, elastic=LINEAR)
    names = ("bottom", "top") if dim == 2 else ("back", "front")
    scene = fmbd.Scene("drop")
    scene.add(body, other, fmbd.contact("hit", body.surface(names[0]), other.surface(names[1]), friction=friction))
    return scene


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("make", "kind", "dim", "friction", "scheme"),
    [
        (on_a_plate, "absolute", 2, 0.0, fmbd.ContactMidpoint()),
        (on_a_plate, "floating", 2, 0.0, fmbd.ContactAlpha(0.8)),
        (on_a_plate, "nonlinear", 2, 0.0, fmbd.ContactMidpoint()),
        (on_a_block, "absolute", 3, 0.0, fmbd.ContactMidpoint()),
        (on_a_plate, "absolute", 2, 0.3, fmbd.ContactAlpha(0.8)),
        (on_a_plate, "floating", 3, 0.3, fmbd.ContactMidpoint()),
        (on_a_block, "absolute", 3, 0.3, fmbd.ContactMidpoint()),
        (on_a_block, "absolute", 3, 1.0, fmbd.ContactMidpoint()),
    ],
)
def test_columns_and_products_give_the_same(
    make: Any, kind: str, dim: int, friction: float, scheme: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In compiled steps, and in those of Python."""

    def run(many: int) -> Any:
        monkeypatch.setattr(delassus, "MANY", many)
        monkeypatch.setattr(delassus, "PRODUCTS", float(many) ** 3)
        return fmbd.solve(make(kind, dim, friction), t_end=0.1, dt=0.01, scheme=scheme)

    few, compiled = run(10**6), run(1)
    monkeypatch.setattr(ElasticContactStepper, "marches", False)
    alone = run(1)
    assert few.counters["compliance_columns"] > 0 and few.counters["compliance_products"] == 0
    force, impulse = few.state.contact.normal_force, few.state.contact.impulse
    assert (force > 0).sum() > 1 or impulse.any()
    for many in (compiled, alone):
        assert many.counters["compliance_columns"] == 0 and many.counters["compliance_products"] > 0
        assert many.state.q == pytest.approx(few.state.q, abs=1e-9 * few.system.length)
        assert many.state.contact.impulse == pytest.approx(impulse, abs=1e-8 * np.abs(impulse).max())
        assert many.counters["complementarity_residual"] < (1e-12 if friction else 1e-10)


def test_a_contact_that_moves_on_asks_for_columns_seldom(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ball that is drawn along a beam of 81 nodes: columns of nodes ahead are solved with those that are asked for."""
    asked: list[int] = []
    solve = delassus.Compliance._solve
    monkeypatch.setattr(
        delassus.Compliance, "_solve", lambda o, i, some: (asked.append(len(some)), solve(o, i, some))[1]
    )
    mesh = fmbd.read_gmsh(BLOCK, size=(4.0, 0.2), cells=80, origin=(0.0, -0.2))
    beam = fmbd.AbsoluteBody("beam", mesh, degree=1, density=1.0, elastic=LINEAR)
    drawn = fmbd.Obstacle("ball", fmbd.Sphere(0.5), motion=lambda t: ((0.5 + 2 * t, 0.5 - 0.01 * t), 0.0))
    scene = fmbd.Scene("drawn")
    scene.add(
        beam, fmbd.fixed("held", fmbd.ground, beam.surface("bottom")), fmbd.contact("on", beam.surface("top"), drawn)
    )
    fmbd.solve(scene, t_end=1.4, dt=0.02, scheme=fmbd.ContactMidpoint(theta=1.0))
    assert len(asked) <= 8
    assert sum(asked) <= 2 * 81


def test_the_order_of_bodies_does_not_count() -> None:
    """A compliance is that of the matrix of a step, also where fields without frames come first: the same increments."""
    runs = []
    for order in (1, -1):
        given = on_a_block("floating", 2, 0.3)
        low = given.bodies["low"]
        scene = fmbd.Scene("drop", gravity=(0, -9.81))
        scene.add(*list(given.bodies.values())[::order], *given.contacts.values())
        scene.add(fmbd.fixed("clamp", fmbd.ground, low.surface("bottom")))
        scene.sensor("place", fmbd.position(given.bodies["block"].surface("top")))
        runs.append(fmbd.solve(scene, t_end=0.06, dt=2e-3, scheme=fmbd.ContactMidpoint()))
    one, other = runs
    assert one.counters["contact_steps"] > 10
    assert one.counters["newton_iterations"] == other.counters["newton_iterations"]
    np.testing.assert_allclose(one["place"], other["place"], rtol=0, atol=1e-10)


@pytest.mark.mpi
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_contact_of_bodies_with_many_tie_multipliers(friction: float) -> None:
    """Two blocks tied to each other slide on a floor: multipliers of the tie by iteration and in the dense core."""
    runs = []
    for linear in (None, fmbd.Schur(limit=1)):
        bodies = [
            fmbd.AbsoluteBody(
                name, fmbd.read_gmsh(BLOCK, size=(1.0, 0.4), cells=cells, origin=(0.0, y)), degree=1, density=1.0,
                elastic=LINEAR, velocity=(0.2, -0.5),
            )
            for name, cells, y in (("low", 8, 0.0), ("high", 6, 0.4))
        ]  # fmt: skip
        floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, -0.01), (0.0, 1.0)))
        scene = fmbd.Scene("tied")
        scene.add(*bodies, fmbd.tie_surface("glue", bodies[0].surface("top"), bodies[1].surface("bottom")))
        scene.add(fmbd.contact("floor", bodies[0].surface("bottom"), floor, friction=friction))
        runs.append(fmbd.solve(scene, t_end=0.08, dt=0.01, linear=linear))
    dense, many = runs
    assert many.counters["tie_iterations"] > 0 and many.counters["compliance_products"] > 0
    assert dense.state.contact.impulse[0, 1] > 0
    assert many.state.q == pytest.approx(dense.state.q, abs=1e-10)
    assert many.state.contact.impulse == pytest.approx(dense.state.contact.impulse, abs=1e-10)
    assert many.counters["complementarity_residual"] < 1e-10


def test_failure_of_the_iteration_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delassus, "MANY", 1)
    monkeypatch.setattr(ElasticContactStepper, "marches", False)
    for name in ("FOUND", "ACCEPTED"):
        monkeypatch.setattr(f"fmbd_fenicsx.linear.complementarity.coulomb.{name}", 0.0)
    with pytest.raises(ConvergenceError, match="contact problem did not converge"):
        fmbd.solve(on_a_plate("absolute", 2), t_end=0.1, dt=0.01)


class Stored:
    """A matrix in the place of products."""

    def __init__(self, W: np.ndarray) -> None:
        import scipy.sparse as sp

        self.W, self.inverse, self.products = W, sp.diags(1 / np.diag(W)).tocsr(), 0

    def __matmul__(self, f: np.ndarray) -> np.ndarray:
        self.products += 1
        return np.asarray(self.W @ f)


def test_friction_by_products_against_the_matrix() -> None:
    """Random problems with sticking, slipping and open points; few products, since the preconditioner knows the cone."""
    import scipy.sparse as sp

    rng = np.random.default_rng(7)
    for m, d, mu in ((4, 2, 0.3), (40, 3, 0.3), (40, 3, 0.8)):
        x = rng.random((m, 2))
        near = np.exp(-3 * np.linalg.norm(x[:, None] - x[None], axis=2))
        coupled = np.array([[1.0, 0.15, 0.1], [0.15, 1.2, 0.1], [0.1, 0.1, 1.2]])  # normal and tangential motions
        W = np.kron(near, coupled[:d, :d])
        q = np.c_[0.3 - rng.random(m), 0.1 * rng.standard_normal((m, d - 1))]
        stored, counts = Stored(W), ContactCounts()
        stored.inverse = sp.csr_matrix(np.linalg.inv(W))
        found = solve_many(stored, q, np.full(m, mu), np.zeros((m, d)), counts)  # type: ignore[arg-type]
        dense = ContactCounts()
        exact = solve_friction(W, q, np.full(m, mu), np.zeros((m, d)), dense)
        assert counts.iterations <= dense.iterations + 4  # a rough linear solve is still Newton's
        across = np.linalg.norm(exact[:, 1:], axis=1)
        slips = (exact[:, 0] > 0) & (across > (1 - 1e-9) * mu * exact[:, 0])
        assert m == 4 or (slips.any() and (~slips & (exact[:, 0] > 0)).any() and (exact[:, 0] == 0).any())
        assert found == pytest.approx(exact, abs=1e-9 * np.abs(exact).max())
        assert counts.residual <= 1e-12
        assert stored.products < 12 * counts.iterations  # two of them not in GMRES


def test_random_problems_against_the_matrix() -> None:
    """Without friction, from any forces; gaps a millionth as large make forces a millionth as large, by as many products."""
    rng = np.random.default_rng(5)
    for m in (3, 12, 40):
        x = rng.random((m, 2))
        W = np.exp(-3 * np.linalg.norm(x[:, None] - x[None], axis=2))  # a smooth positive definite kernel
        q, none = rng.standard_normal(m), np.zeros(m)
        guess = np.maximum(rng.standard_normal(m), 0.0)
        exact = solve_friction(W, q[:, None], none, none[:, None], ContactCounts())
        made = []
        for unit in (1.0, 1e-6):
            stored, counts = Stored(W), ContactCounts()
            gap, force = unit * (q + W @ guess)[:, None], unit * guess[:, None]
            found = solve_many(stored, gap, none, force, counts)  # type: ignore[arg-type]
            assert found == pytest.approx(unit * exact, abs=unit * 1e-9 * np.abs(exact).max())
            assert counts.residual < 1e-10
            made.append(stored.products)
        assert abs(made[0] - made[1]) <= 1
