"""Every public function and class is called with values that mean nothing: it works, or ends with an error of the package."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import FmbdError, InputError

NAMESPACES = ("forces", "loads", "sensors", "contacts", "schemes", "forms", "solvers", "multipliers", "materials")
ROD = Path(__file__).parents[1] / "meshes" / "rod.py"
JUNK = (None, "junk", -1, 0.5, float("nan"), float("inf"), True, (), (1.0,), [1, "a"], {"a": 1}, object(), int)
JUNK = (*JUNK, np.full((2, 3), np.nan))
APART = {"Ends", "number", "require"}  # an enumeration, and checks that stand beside


def public() -> dict[str, Callable[..., Any]]:
    """Public functions and classes by name."""
    out = {}
    for place in (fmbd, *(getattr(fmbd, name) for name in NAMESPACES)):
        for name in dir(place):
            found = getattr(place, name)
            ours = getattr(found, "__module__", "").startswith("fmbd_fenicsx")
            error = isinstance(found, type) and issubclass(found, BaseException)
            if callable(found) and ours and not error and not name.startswith("_") and name not in APART:
                out[name] = found
    return out


def arguments(function: Callable[..., Any], junk: Any) -> tuple[list[Any], dict[str, Any]]:
    """One value for every argument that has to be given."""
    positional, named = [], {}
    for p in inspect.signature(function).parameters.values():
        if p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD) or p.default is not p.empty:
            continue
        if p.kind is p.KEYWORD_ONLY:
            named[p.name] = junk
        else:
            positional.append(junk)
    return positional, named


@pytest.mark.parametrize("name", sorted(public()))
def test_values_that_mean_nothing(name: str) -> None:
    function = public()[name]
    for junk in JUNK:
        positional, named = arguments(function, junk)
        try:
            function(*positional, **named)
        except FmbdError:
            pass


@pytest.mark.parametrize("name", sorted(public()))
def test_optional_values_that_mean_nothing(name: str) -> None:
    """One optional argument at a time, beside a first name that is right."""
    function = public()[name]
    for p in inspect.signature(function).parameters.values():
        if p.default is p.empty or p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD):
            continue
        for junk in JUNK:
            positional, named = arguments(function, "right")
            try:
                function(*positional, **named, **{p.name: junk})
            except FmbdError:
                pass


def own_force(**options: Any) -> Any:
    """A force between two bodies."""
    a, b = (fmbd.RigidBody(name, 1.0, 0.1) for name in "ab")
    return fmbd.force_element("x", a, b, lambda a, b, t: (b.x - a.x) @ (b.x - a.x), **options)


# -- calls that are right but for one value ---------------------------------------------------------------------------


def right_calls(mesh: Any) -> list[tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]]:
    """Function, values by place and by name: all of them work."""
    m, c = fmbd.materials, fmbd.contacts
    flat, space = fmbd.RigidBody("flat", 1.0, 0.1), fmbd.RigidBody("space", 1.0, (0.4, 0.4, 0.4))
    other = fmbd.RigidBody("other", 1.0, (0.4, 0.4, 0.4))
    soft = fmbd.FloatingBody("soft", mesh, density=1e3, elastic=m.plane_stress(1e8, 0.3))
    pin = fmbd.revolute("pin", fmbd.ground, flat, center=(0, 0))
    hinge = fmbd.revolute("hinge", fmbd.ground, space, center=(0, 0, 0), axis=(0, 0, 1))
    slide = fmbd.cylindrical("slide", fmbd.ground, space, center=(0, 0, 0), axis=(0, 0, 1))
    floor = c.Obstacle("floor", c.HalfSpace((0, 0), (0, 1)))
    section = fmbd.RodSection(stiffness=(1e6, 1e5, 1e5, 1e3, 1e3, 1e3), mass=1.0, inertia=(0.1, 0.1, 0.1))
    at, axis = {"center": (0, 0, 0)}, {"axis": (0, 0, 1)}

    scene = fmbd.Scene("scene", gravity=(0, -9.81))
    scene.add(flat, pin)
    scene.sensor("place", fmbd.position(flat))
    run = fmbd.solve(scene, t_end=0.01, dt=0.01)
    return [
        (fmbd.RigidBody, ("x", 1.0, 0.1), {"position": (0, 0), "rotation": 0.1}),
        (fmbd.FloatingBody, ("x", mesh), {"density": 1e3, "elastic": m.plane_stress(1e8, 0.3), "degree": 1}),
        (soft.reduced, (), {"modes": 2}),
        (soft.reduced, (), {"basis": soft.reduced(modes=2).basis}),
        (soft.surface, ("pin",), {}),
        (fmbd.spherical, ("x", space, other), at),
        (fmbd.cylindrical, ("x", space, other), at | axis),
        (fmbd.gear, ("x", fmbd.angle(pin), fmbd.angle(hinge)), {"ratio": 2.0}),
        (fmbd.screw, ("x", slide), {"lead": 0.1}),
        (fmbd.joint_limit, ("x", fmbd.angle(pin)), {"lower": -1.0, "upper": 1.0}),
        (fmbd.joint_spring, ("x", fmbd.angle(pin)), {"stiffness": 1.0, "damping": 0.1}),
        (fmbd.force, ("x", space, (1, 0, 0)), {"point": (0, 0, 0)}),
        (c.HalfSpace, ((0, 0), (0, 1)), {}),
        (c.Sphere, (1.0,), {}),
        (c.Box, ((1.0, 1.0, 1.0),), {}),
        (fmbd.contact, ("x", fmbd.ball(flat, 0.1), floor), {"restitution": 0.5, "friction": 0.3}),
        (fmbd.schemes.Moreau, (), {"impacts": 3}),
        (fmbd.solvers.FieldSplit, (), {"method": "fgmres", "rtol": 1e-8, "max_iterations": 9, "elastic": fmbd.Cholesky()}),
        (fmbd.solvers.FieldSplit, (), {"multiplier": fmbd.solvers.FieldSplit().multiplier}),
        (fmbd.Schur, (), {"rtol": 1e-8, "limit": 9, "elastic": fmbd.Multigrid()}),
        (fmbd.Multigrid, (), {"cycles": 1, "smoothing": 2}),
        (fmbd.Bddc, (), {"adaptive": 2.0}),
        (fmbd.Newton, (), {"tolerance": 1e-6, "max_iterations": 12, "slow": 0.9, "patience": 4.0}),
        (fmbd.Rod, ("x", [(0, 0, 0), (1, 0, 0)], section), {"damping": 0.1, "stations": {"mid": 0.5}, "degree": 3}),
        (fmbd.RodSection, (), {"stiffness": (1e6, 1e5, 1e5, 1e3, 1e3, 1e3), "mass": 1.0, "inertia": (0.1, 0.1, 0.1)}),
        (fmbd.Wires, ("x", 9.0, 5, (fmbd.Wire(1.0, 1e4),)), {"supports": (fmbd.PointSupport(0, 1.0, 1e5),)}),
        (fmbd.Spring, ("x", space, other), {"point_b": (1, 0, 0), "stiffness": 1e5, "damping": 1e2, "length": 0.1}),
        (fmbd.Tyre, ("x", flat), {"road": lambda x, t: 0.0, "stiffness": 1e5}),
        (fmbd.bushing, ("x", space, other), {"stiffness": (1,) * 6, "damping": (1,) * 6, "axes": np.eye(3)}),
        (fmbd.pid, ("x", fmbd.angle(pin)), {"target": 0.0, "gains": (1.0, 0.1, 0.1), "limit": 5.0, "every": 0.1}),
        (fmbd.contacts.corners, (flat, [(0, 0), (1, 0)]), {}),
        (fmbd.Output, (), {"times": (0.0, 0.01), "events": ()}),
        (fmbd.View, (), {"camera": (1, 1, 1), "size": (300, 200)}),
        (fmbd.Paint, (lambda u: u, "stress (Pa)"), {}),
        (fmbd.multipliers.Continuous, (), {"degree": 1}),
        (fmbd.multipliers.Discontinuous, (), {"degree": 1}),
        (fmbd.Unilateral, (fmbd.GeneralizedAlpha(),), {}),
        (fmbd.study.orders, (lambda h: run, [0.02, 0.01]), {"names": ["place"], "reference": run}),
        (run.__getitem__, ("place",), {}),
        (run.momenta, (), {"state": run.state}),
        (fmbd.solve, (scene,), {"t_end": 0.01, "dt": 0.01, "linear": None, "checkpoint": None, "scheme": None}),
    ]  # fmt: skip


def test_one_value_that_means_nothing(rod_mesh: Any) -> None:
    """In calls that are right otherwise; whole numbers beyond the range of the machine, and what has no hash, among them."""
    raw: set[str] = set()
    for function, values, names in right_calls(rod_mesh(dim=2, h=0.5, height=0.2)):
        function(*values, **names)
        for junk in (*JUNK, 10**400, [], np.zeros(0), b"x", 1j, fmbd.ground):
            calls = [((*values[:i], junk, *values[i + 1 :]), names) for i in range(len(values))]
            calls += [(values, names | {name: junk}) for name in names]
            for given, named in calls:
                try:
                    function(*given, **named)
                except FmbdError:
                    pass
                except Exception as error:
                    raw.add(f"{function.__name__}: {type(error).__name__}: {error}")
    assert not raw


@pytest.mark.parametrize(
    "make, says",
    [
        (lambda: fmbd.solvers.FieldSplit(method="fgmre"), 'Did you mean "fgmres"'),
        (lambda: fmbd.solvers.FieldSplit(rtol=0.0), "between 0 and 1"),
        (lambda: fmbd.solvers.FieldSplit(elastic="chol"), "elastic 'chol' must be"),
        (lambda: fmbd.Schur(multiplier=3), "multiplier 3 must be"),
        (lambda: fmbd.Multigrid(smoothing=0), "whole number, at least 1"),
        (lambda: fmbd.schemes.Moreau(impacts=-1), "whole number"),
        (lambda: fmbd.Newton(slow=1.5), "a rate, between 0 and 1"),
        (lambda: fmbd.RigidBody("x", 10**400, 0.1), "mass"),
        (lambda: fmbd.read_gmsh(ROD, h=float("nan")), r"rod.py: h nan must be a finite number"),
        (lambda: fmbd.read_gmsh(ROD, h=np.float32("inf")), r"rod.py: h .*inf.* must be a finite number"),
        (lambda: fmbd.read_gmsh(ROD, h=True), r"rod.py: h True must be a finite number"),
        (lambda: fmbd.Dropper(0, 0, 1.0, 1e5), "both wire 0"),
        (lambda: fmbd.study.map(None, [1.0], t_end=1.0), "make None must be a function of 1 argument"),
        (lambda: fmbd.study.map(lambda p: p, 3, t_end=1.0), "parameters 3 must be a list or tuple"),
        (lambda: own_force(points=()), r"points \(\) must be a pair"),
        (lambda: own_force(points=np.eye(3)), "points .* must be a pair"),
        (lambda: fmbd.PointSupport(0, 1.0, -1e5), "stiffness -100000.0 N/m must be a number that is not negative"),
        (lambda: fmbd.Wheel(0.3, (0, 1)), r"Wheel: axis \(0, 1\) must be 3 finite numbers"),
        (lambda: fmbd.Spin(1.0, center=(1.0,)), "must be a point"),
        (lambda: fmbd.contacts.SignedDistance(lambda x: x[2], thickness=-1.0), "thickness = -1.0 m must be positive"),
        (lambda: fmbd.multipliers.Discontinuous(degree=-1), "whole number, at least 0"),
        (lambda: fmbd.Unilateral("alpha"), "must be an object such as"),
        (lambda: fmbd.Tyre("x", fmbd.ground, road=lambda x, t: 0.0, stiffness=1.0), "not the ground"),
        (lambda: fmbd.Rod("x", [(0, 0, 0), (1, 0, 0)], "steel"), 'Rod "x": section .steel. must be a RodSection'),
        (lambda: fmbd.solve(fmbd.Scene("x"), t_end=1.0, linear="direct"), "linear 'direct' must be"),
        (lambda: fmbd.solve(fmbd.Scene("x"), t_end=1.0, checkpoint="here"), "checkpoint 'here' must be a Checkpoint"),
    ],
)
def test_what_was_silent_or_raw(make: Callable[[], Any], says: str) -> None:
    """Each named, with what would do."""
    with pytest.raises(InputError, match=says):
        make()


@pytest.mark.parametrize("name", ["renewals", "iterations", "theta", "left", "solved"])
def test_counters_of_newton_are_its_own(name: str) -> None:
    with pytest.raises(TypeError, match=f"unexpected keyword argument '{name}'"):
        fmbd.Newton(**{name: -1})  # type: ignore[arg-type]


# -- functions of the user's that give nothing that could be used ------------------------------------------------------

LINE = {"mass": lambda z, w, ds: ufl.inner(z, w) * ds, "energy": lambda z, ds: ufl.inner(z, z) * ds}


def level(s: Any) -> Any:
    """A line along x."""
    return np.stack((s, 0 * s, 0 * s))


def rod(**options: Any) -> fmbd.Rod:
    """A straight rod, its end loose."""
    section = fmbd.RodSection(stiffness=(1e4, 1e3, 1e3, 10.0, 10.0, 10.0), mass=1.0, inertia=(0.1, 0.1, 0.1))
    return fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=1, degree=1, **options)


ASKED: dict[str, Callable[[Any], Any]] = {
    "normal": lambda law: rod(normal=law),
    "twist": lambda law: rod(twist=law),
    "prestrain": lambda law: rod(prestrain=law),
    "law of a load": lambda law: rod(loads=(fmbd.RodLoad(lambda s, t: law(s)),)),
    "curve": lambda law: fmbd.Rod("rod", law, rod().section),
    "start": lambda law: fmbd.LineBody("rod", 1.0, **LINE, start=law, cells=1),
    "start_rate": lambda law: fmbd.LineBody("rod", 1.0, **LINE, start=level, start_rate=law, cells=1),
    "force": lambda law: fmbd.CoordinateBody("rod", [[1.0]], lambda q, v, t: law(t), [0.1]),
}


def no_key(s: Any) -> Any:
    return {}[s]


@pytest.mark.parametrize("what", ASKED)
@pytest.mark.parametrize(
    "law",
    [
        no_key,
        lambda s: "x",
        lambda s: None,
        lambda s: np.zeros(5),
        lambda s: np.full(3, np.nan),
        lambda s: [[1], [2, 3]],
    ],
    ids=["raises", "word", "None", "other size", "nan", "ragged"],
)
def test_what_functions_along_a_body_give_is_checked(what: str, law: Any) -> None:
    """One error names the body and the function, before the first step."""
    with pytest.raises(InputError, match=f'(?s)"rod".*{what}|{what}.*"rod"|force.*"rod"'):
        scene = fmbd.Scene("x")
        scene.add(ASKED[what](law))
        scene.build()
        fmbd.solve(scene, t_end=0.01, dt=0.01)


def test_a_law_that_takes_numbers_only_is_no_formula() -> None:
    """Asked with a symbol it fails as it likes, and is differenced."""

    def law(s: Any, rate: Any, t: Any) -> float:
        return {True: 0.5}[isinstance(s, float)]

    scene = fmbd.Scene("x")
    body = fmbd.RigidBody("body", 1.0, 0.1, position=(0.5, 0.0))
    scene.add(body)
    scene.add(fmbd.force_element("x", fmbd.ground, body, lambda a, b, t: b.x[0] - a.x[0], law=law))
    run = fmbd.solve(scene, t_end=0.01, dt=0.01)
    assert run.state.a[0] == pytest.approx(-0.5)


@pytest.mark.parametrize(
    "make",
    [
        lambda: fmbd.Wires("x", 9.0, 1, (fmbd.Wire(1.0, 1e3),)),
        lambda: fmbd.LineBody("x", 1.0, **LINE, start=level, cells=1),
    ],
)
def test_bodies_of_the_plane_are_refused_in_space(make: Callable[[], Any]) -> None:
    scene = fmbd.Scene("x")
    scene.add(fmbd.RigidBody("body", 1.0, (0.1, 0.1, 0.1)), make())
    with pytest.raises(InputError, match=r"body \(3\), x \(2\)"):
        scene.build()


def test_a_run_may_be_longer_than_any_record() -> None:
    """It is meant to end at an event: room for ten petabytes is not asked for."""
    scene = fmbd.Scene("x", gravity=(0, -9.81))
    ball = fmbd.RigidBody("ball", 1.0, 0.1)
    scene.add(ball)
    scene.sensor("place", fmbd.position(ball))
    down = fmbd.Event("place y", level=-0.1)
    run = fmbd.solve(scene, t_end=1e12, dt=1e-2, output=fmbd.Output(events=(down,)))
    assert run.state.t < 0.2
