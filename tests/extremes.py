"""Ten scenes at the edge: what happens there, and why. Each is turned up until it is refused, or until the numbers end.

Run:  ./with-dolfinx python3 tests/extremes.py            all of them (a few minutes); writes docs/extremes.md
      ./with-dolfinx python3 tests/extremes.py spin       some; prints only

Every run is compared with something found without the package: an integration by SciPy, a formula, a conserved quantity.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from dae_problems import parallelograms
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import FmbdError
from fmbd_fenicsx.notices import Gathered

ROOT = Path(__file__).resolve().parents[1]
MESHES = ROOT / "meshes"
G = 9.81  # m/s^2
RIGHT, WARNED, REFUSED, WRONG = "right", "warned", "refused", "WRONG"


@dataclass(frozen=True)
class Row:
    """One run: what was set, how it ended, its error and the error allowed, what it said."""

    setting: str
    verdict: str
    error: float = float("nan")
    allowed: float = float("nan")
    words: str = ""


@dataclass(frozen=True)
class Edge:
    """A scene at the edge: ``measure`` says what the error is; ``why`` what one sees in the rows."""

    title: str
    setting: str
    measure: str
    why: str
    rows: Callable[[], Iterator[Row]]


def tried(setting: str, solve: Callable[[], Any], error_of: Callable[[Any], float], allowed: float) -> Row:
    """A run, judged: right, right or wrong with a warning, refused, or wrong without a word."""
    heard = Gathered()
    try:
        with heard:
            run = solve()
    except FmbdError as found:
        return Row(setting, REFUSED, words=str(found))
    error, said = float(error_of(run)), " ".join(heard.lines())
    verdict = WARNED if said else RIGHT if error <= allowed else WRONG
    return Row(setting, verdict, error, allowed, said)


# ---------------------------------------------------------------------------------------------------- heavy on light


def double_pendulum(upper: float, lower: float, t_end: float) -> tuple[fmbd.Scene, np.ndarray]:
    """Two rods of 1 m from the horizontal, and where the lower one's end is at ``t_end`` by an integration in two angles."""
    a = fmbd.RigidBody("upper", upper, upper / 12, position=(0.5, 0.0))
    b = fmbd.RigidBody("lower", lower, lower / 12, position=(1.5, 0.0))
    scene = fmbd.Scene("double pendulum", gravity=(0.0, -G))
    scene.add(a, b, fmbd.revolute("pin", fmbd.ground, a, center=(0.0, 0.0)))
    scene.add(fmbd.revolute("knee", a, b, center=(1.0, 0.0)))
    scene.sensor("end", fmbd.position(b, point=(2.0, 0.0)))
    whole = upper + lower  # rows over the total mass: ratios of 1e16 stay in range

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        (p, q), w = y[:2], y[2:]
        m, n = upper / whole, lower / whole
        M = np.array([[m / 3 + n, 0.5 * n * np.cos(p - q)], [0.5 * np.cos(p - q), 1 / 3]])
        s = 0.5 * np.sin(p - q)
        f = [-n * s * w[1] ** 2 - G * (0.5 * m + n) * np.cos(p), s * w[0] ** 2 - 0.5 * G * np.cos(q)]
        return np.r_[w, np.linalg.solve(M, f)]

    p, q = solve_ivp(rates, (0.0, t_end), np.zeros(4), "DOP853", rtol=1e-11, atol=1e-12).y[:2, -1]
    return scene, np.array([np.cos(p) + np.cos(q), np.sin(p) + np.sin(q)])


def hoist(t_end: float) -> tuple[fmbd.Scene, np.ndarray]:
    """1e3 kg on links of 1 m and 1e-6 to 1 kg from 0.3 rad, and where it is by an integration: links without mass are a rod."""
    way, before = np.array([np.sin(0.3), -np.cos(0.3)]), fmbd.ground
    scene = fmbd.Scene("hoist", gravity=(0.0, -G))
    for i, mass in enumerate((1e-6, 1e-4, 1e-2, 1e-1, 1.0, 1e3)):
        link = fmbd.RigidBody(f"link {i}", mass, 1e-2 * mass, tuple((i + 1.0) * way))
        scene.add(link, fmbd.revolute(f"pin {i}", before, link, center=tuple(i * way)))
        before = link
    scene.sensor("end", fmbd.position(before))

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        (p, q), w = y[:2], y[2:]
        c, s = 5 * np.cos(p - q), 5 * np.sin(p - q)
        return np.r_[
            w,
            np.linalg.solve([[25, c], [c, 1.01]], [-s * w[1] ** 2 - 5 * G * np.sin(p), s * w[0] ** 2 - G * np.sin(q)]),
        ]

    p, q = solve_ivp(rates, (0.0, t_end), (0.3, 0.3, 0.0, 0.0), "DOP853", rtol=1e-11, atol=1e-12).y[:2, -1]
    return scene, np.array([5 * np.sin(p) + np.sin(q), -5 * np.cos(p) - np.cos(q)])


def heavy_on_light() -> Iterator[Row]:
    for upper, lower in ((1, 1), (1, 1e4), (1, 1e8), (1, 1e12), (1, 1e16), (1e8, 1), (1e16, 1)):
        scene, exact = double_pendulum(upper, lower, 0.5)
        yield tried(
            f"{upper:.0e} kg above {lower:.0e} kg",
            lambda scene=scene: fmbd.solve(scene, t_end=0.5, dt=2e-3),
            lambda run, exact=exact: np.abs(run["end"][-1] - exact).max(),
            1e-3,
        )
    scene, exact = hoist(0.5)
    yield tried(
        "1e-06, 1e-04, 1e-02, 1e-01, 1e+00 kg above 1e+03 kg",
        lambda: fmbd.solve(scene, t_end=0.5, dt=2e-3),
        lambda run: np.abs(run["end"][-1] - exact).max(),
        1e-3,
    )


# ---------------------------------------------------------------------------------------------------- stiff on soft


def stiff_on_soft() -> Iterator[Row]:
    end, height = 0.1, 0.1
    rate = G / 2 / ((1 + height**2) / 12 + 0.25)
    fall = solve_ivp(lambda t, y: (y[1], -rate * np.cos(y[0])), (0.0, end), (0.0, 0.0), rtol=1e-11, atol=1e-13)
    exact = float(np.sin(fall.y[0, -1]))
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, height), cells=8, origin=(0.0, -height / 2))
    for kind, make in (("floating", fmbd.FloatingBody), ("absolute", fmbd.AbsoluteBody)):
        for modulus in (1e9, 1e12, 1e15, 1e18):
            if make is fmbd.FloatingBody:
                law = {"elastic": fmbd.materials.plane_stress(modulus, 0.3)}
            else:
                law = {"energy": fmbd.materials.sheet_saint_venant_kirchhoff(modulus, 0.3)}
            body = make("rod", mesh, density=1000.0, **law)
            scene = fmbd.Scene("fall", gravity=(0.0, -G))
            scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("left"), center=(0.0, 0.0)))
            scene.sensor("tip", fmbd.position(body.surface("right")))
            yield tried(
                f"{kind}, E = {modulus:.0e} Pa",
                lambda scene=scene: fmbd.solve(scene, t_end=end, dt=2e-3),
                lambda run: abs(run["tip"][-1, 1] - exact),
                1e-3 * abs(exact),
            )


# ---------------------------------------------------------------------------------------------------- slivers


def slivers() -> Iterator[Row]:
    length, height, load, modulus = 1.0, 0.1, 10.0, 1e7
    bent = load * length**3 / (3 * modulus * height**3 / 12)
    exact = bent * (1 + 1.2 * (height / length) ** 2 / 2 * 1.3)  # Timoshenko's beam: shear too
    for flat in (1.0, 1e-2, 1e-4, 1e-6, 1e-8):
        mesh = fmbd.read_gmsh(MESHES / "block.py", size=(length, height), cells=20, origin=(0.0, -height / 2))
        x = mesh.dolfinx.geometry.x
        inner = np.flatnonzero(np.isclose(x[:, 0], 0.5))
        x[inner, 0] = 0.55 - 0.05 * flat  # a column of nodes moves on to the next one
        yield tried(
            f"cells of {0.05 * flat:.0e} m beside those of 0.05 m",
            lambda mesh=mesh: tip_under(mesh, fmbd.materials.plane_stress(modulus, 0.3), load, 2),
            lambda fall: abs(fall / exact - 1),
            0.02,
        )


def tip_under(mesh: Any, law: Any, load: float, degree: int) -> float:
    """Deflection (m) of the right end of a block clamped at the left, under ``load`` N/m at the right."""
    body = fmbd.FloatingBody("beam", mesh, density=1000.0, elastic=law, degree=degree)
    scene = fmbd.Scene("beam")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
    scene.add(fmbd.force("load", body.surface("right"), lambda t: (0.0, -load)))
    scene.sensor("tip", fmbd.position(body.surface("right")))
    return -float(fmbd.equilibrium(scene)["tip"][1])


# ---------------------------------------------------------------------------------------------------- nu -> 1/2


def nearly_incompressible() -> Iterator[Row]:
    modulus, load = 1e7, 10.0
    laws = {
        "quadratic displacements": (fmbd.materials.plane_strain, 2, 40),
        "linear displacements, fine": (fmbd.materials.plane_strain, 1, 80),
        "displacement and pressure": (fmbd.materials.nearly_incompressible, 2, 40),
    }
    for name, (law, degree, cells) in laws.items():
        mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, 0.1), cells=cells, origin=(0.0, -0.05))
        for nu in (0.3, 0.45, 0.49, 0.4999, 0.5):
            exact = load / (3 * modulus / (1 - nu**2) * 0.1**3 / 12)
            yield tried(
                f"{name}, nu = {nu:g}",
                lambda mesh=mesh, law=law, nu=nu, degree=degree: tip_under(mesh, law(modulus, nu), load, degree),
                lambda fall, exact=exact: abs(fall / exact - 1),
                0.03 if degree == 2 else 0.12,
            )


# ---------------------------------------------------------------------------------------------------- fast spin


def spin() -> Iterator[Row]:
    """A disk with a hinge spring so soft that it only counts: its torque is known when its angle is."""
    for scheme, rates in (
        (fmbd.GeneralizedAlpha(0.8), (1.0, 1e2, 1e4, 1e6)),
        (fmbd.Radau(3, rtol=1e-5), (1.0, 30.0, 300.0)),
    ):
        for rate in rates:
            disk = fmbd.RigidBody("disk", 1.0, (0.1, 0.1, 0.2), angular_velocity=(0.0, 0.0, rate))
            axle = fmbd.revolute("axle", fmbd.ground, disk, center=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0))
            scene = fmbd.Scene("disk")
            scene.add(disk, axle, fmbd.joint_spring("coil", fmbd.angle(axle), stiffness=0.2))
            scene.sensor("turn", fmbd.angle(axle))
            given = 0.01 if scheme.rtol is None else None  # s
            yield tried(
                f"{rate:.0e} rad/s, {scheme.name}",
                lambda scene=scene, given=given, scheme=scheme: fmbd.solve(scene, t_end=1.0, dt=given, scheme=scheme),
                lambda run, rate=rate: abs(run["turn"][-1, 0] / (rate * np.sin(1.0)) - 1.0),
                1e-3,
            )


# ---------------------------------------------------------------------------------------------------- singular positions


def singular_positions() -> Iterator[Row]:
    """Parallel four-bars through the position in which all bars lie on one line."""
    end, rate = 1.2, -1.0
    for n, steps in ((1, (1e-2, 2e-3)), (10, (1e-2, 2e-3)), (20, (1e-3, 2.5e-4))):
        pull = G * ((n + 1) / 2 + n) / ((n + 1) / 3 + n)
        turn = solve_ivp(
            lambda t, y, pull=pull: (y[1], -pull * np.cos(y[0])), (0, end), (np.pi / 2, rate), rtol=1e-10, atol=1e-12
        )
        exact = np.array([np.cos(turn.y[0, -1]), np.sin(turn.y[0, -1])])
        for dt in steps:
            yield tried(
                f"{n} loop{'s' * (n > 1)}, dt = {dt:g} s",
                lambda n=n, dt=dt: fmbd.solve(
                    parallelograms(n, rate), t_end=end, dt=dt, scheme=fmbd.GeneralizedAlpha(0.9)
                ),
                lambda run, exact=exact: np.abs(run["top"][-1] - exact).max(),
                40 * dt**2,
            )


# ---------------------------------------------------------------------------------------------------- redundant hinges


def nearly_redundant() -> Iterator[Row]:
    """A door on two hinges whose axes differ by an angle; that of the door after 1 s at 2 rad/s, were they one line."""
    for off in (0.0, 1e-14, 1e-12, 1e-10, 1e-8, 1e-7, 1e-6, 1e-3):
        start = {"velocity": (0.0, 0.8, 0.0), "angular_velocity": (0.0, 0.0, 2.0)}
        door = fmbd.RigidBody("door", 20.0, (6.67, 7.73, 1.07), position=(0.4, 0.0, 1.0), **start)
        scene = fmbd.Scene("door", gravity=(0.0, 0.0, -G))
        low = fmbd.revolute("low", fmbd.ground, door, center=(0.0, 0.0, 0.2), axis=(0.0, 0.0, 1.0))
        axis = (np.sin(off), 0.0, np.cos(off))
        scene.add(door, low, fmbd.revolute("high", fmbd.ground, door, center=(0.0, 0.0, 1.8), axis=axis))
        scene.sensor("turn", fmbd.angle(low))
        yield tried(
            f"axes apart by {off:.0e} rad",
            lambda scene=scene: fmbd.solve(scene, t_end=1.0, dt=0.01),
            lambda run: abs(run["turn"][-1, 0] - 2.0),
            1e-3,
        )


# ---------------------------------------------------------------------------------------------------- impacts


def many_impacts() -> Iterator[Row]:
    """Balls that hit the floor in the same step: each follows its two parabolas."""
    size, height, e, end = 0.1, 0.5, 0.6, 0.5
    fall = np.sqrt(2 * height / G)
    later = end - fall
    exact = size + e * G * fall * later - 0.5 * G * later**2
    for n in (1, 10, 100):
        scene = fmbd.Scene("balls", gravity=(0.0, -G))
        floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0)))
        for k in range(n):
            ball = fmbd.RigidBody(f"ball {k}", 10.0 ** (k % 9 - 4), 1.0, position=(k, size + height))
            scene.add(ball, fmbd.contact(f"floor {k}", fmbd.ball(ball, size), floor, restitution=e))
            scene.sensor(f"x {k}", fmbd.position(ball))
        yield tried(
            f"{n} ball{'s' * (n > 1)}, 1e-4 to 1e4 kg",
            lambda scene=scene: fmbd.solve(scene, t_end=end, dt=5e-3, scheme=fmbd.Moreau()),
            lambda run, n=n: max(abs(run[f"x {k}"][-1, 1] - exact) for k in range(n)),
            1e-3,
        )


# ---------------------------------------------------------------------------------------------------- snap-through


def snap_through() -> Iterator[Row]:
    """A shallow arch under a load that grows past its limit swings through, whatever the step; the first run is the reference."""
    rise, lowest = 0.05, []
    for dt in (0.005, 0.02, 0.1):
        mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, 0.01), origin=(0.0, -0.005), counts=(24, 1))
        x = mesh.dolfinx.geometry.x
        x[:, 1] += 4 * rise * x[:, 0] * (1 - x[:, 0])
        grows = fmbd.traction("top", (0.0, -80.0), time=lambda t: min(2 * t, 1.0) ** 2 * (3 - 2 * min(2 * t, 1.0)))
        law = fmbd.materials.sheet_saint_venant_kirchhoff(1e7, 0.3)
        arch = fmbd.AbsoluteBody("arch", mesh, density=1000.0, energy=law, loads=[grows])
        scene = fmbd.Scene("arch")
        scene.add(arch, *(fmbd.fixed(s, fmbd.ground, arch.surface(s)) for s in ("left", "right")))
        scene.sensor("top", fmbd.position(arch.surface("top")))

        def solve(scene: fmbd.Scene = scene, dt: float = dt) -> fmbd.Run:
            output = fmbd.Output(estimate_error=False)
            return fmbd.solve(scene, t_end=1.0, dt=dt, scheme=fmbd.GeneralizedAlpha(0.6), output=output)

        def apart(run: fmbd.Run) -> float:
            lowest.append(run["top"][:, 1].min())
            return abs(lowest[-1] / lowest[0] - 1.0)

        yield tried(f"dt = {dt:g} s", solve, apart, 0.15)


# ---------------------------------------------------------------------------------------------------- sudden loads


def sudden_loads() -> Iterator[Row]:
    """A mass on a spring gets a force between two steps: known exactly."""
    omega, at, end = 10.0, 0.3137, 1.0
    exact = (1 - np.cos(omega * (end - at))) / omega**2
    for said in (True, False):
        for scheme, dt, allowed in (
            (fmbd.GeneralizedAlpha(0.8), 1e-3, 1e-2),
            (fmbd.Radau(3, rtol=1e-6), None, 1e-3),
            (fmbd.BDF(rtol=1e-6), None, 5e-3),
        ):
            mass = fmbd.RigidBody("mass", 1.0, 0.1, position=(0.0, 0.0))
            scene = fmbd.Scene("mass", breakpoints=(at,) if said else ())
            scene.add(mass, fmbd.prismatic("guide", fmbd.ground, mass, axis=(1.0, 0.0), center=(0.0, 0.0)))
            ends = {"point_a": (-1.0, 0.0), "point_b": (0.0, 0.0), "length": 1.0}
            scene.add(fmbd.Spring("spring", fmbd.ground, mass, stiffness=omega**2, **ends))
            scene.add(fmbd.force("blow", mass, lambda t: (1.0 if t > at else 0.0, 0.0)))
            scene.sensor("x", fmbd.position(mass))
            yield tried(
                f"{scheme.name}, {'time of the blow given' if said else 'not given'}",
                lambda scene=scene, dt=dt, scheme=scheme: fmbd.solve(scene, t_end=end, dt=dt, scheme=scheme),
                lambda run: abs(run["x"][-1, 0] / exact - 1.0),
                allowed,
            )


# ---------------------------------------------------------------------------------------------------- the page

WHY = {
    "light": """A light body below a heavy one is harmless at any ratio. A light body *above* a heavy one carries reactions that
are the heavy body's weight and more: its own balance is the difference of large numbers, and scaled by its mass
the rows of its joints are the same to roundoff. Where that costs digits the matrix is factored in other scales, and
the ratio does no harm. Only a motion without any inertia, to roundoff of the inertia beside it, is refused by name.""",
    "stiff": """A rod that falls about its pin, as stiff as one likes. Its vibrations are far too fast for the step and are
damped by the scheme; the motion is that of a rigid rod. What ends it is roundoff: in a floating frame the
displacements are small and known to their own digits; in absolute coordinates they contain the motion itself,
and its roundoff times E is a force, so a body that is too stiff for the step is refused at the start. Linear
solves are accepted by their true residuals: at 1e18 Pa every step is made in
parts, which is said. For a body that
hardly deforms take modes or a rigid body.""",
    "slivers": """A column of nodes is moved onto the next one until cells are as thin as roundoff. The deflection does not
change: thin cells spoil the condition of the matrix, not the space, and a Cholesky factor has small residuals
all the same. Explicit schemes are another matter: their step is bounded by the thinnest cell.""",
    "nu": """Linear displacements on triangles cannot bend without changing their volume: at nu = 0.45 their error is twice
that at 0.3, at 0.49 eight times, and then all bending is gone. Quadratic displacements hold to 0.495 and lose
accuracy of stresses before that of places. Displacement and pressure do not care, 0.5 included. Bodies whose
measured ratio is above what their element bears are warned of.""",
    "spin": """A disk on a coil spring, up to 10 000 rad in a step. Angles of joints are coordinates with a rate, so turns
between two steps are not lost, and the spring's torque is right: with angles taken from attitudes it would see
a remainder of half a turn at most.""",
    "singular": """When all bars of a parallelogram lie on one line, the mechanism may go on as a parallelogram or as an
antiparallelogram; each further loop adds one more choice. Near this place rows depend on each other:
multipliers are the smallest that hold the balance, and the branch is that of the motion so far. Where a step
ends close to it, a warning names the joint; most of these runs pass between two steps. Gaps of roundoff are
left as they are there: they would stand for motions of any size.""",
    "redundant": """Two hinges on one line hold the same five directions twice; of all reactions with the same sum the smallest
are taken. When the axes differ by less than a step may leave joints open, they still count as one line. From 1e-6 rad on
they ask for different motions: the run says at its start that they hold nearly the same, and ends where a joint
opens; with more the door is locked, with a warning that nothing can move. A slightly bent real door turns because it is
elastic: replace one hinge by a `bushing`, or a `spherical` and a `cylindrical` joint.""",
    "impacts": """Impacts are found in the step and resolved together, each by its own law; masses from 1e-4 to 1e4 kg share one
problem whose rows are scaled by what each contact moves. Flights between impacts are exact.""",
    "snap": """Past the limit point no equilibrium is near, and the arch flies to the other side. The step's matrix is
indefinite on the way; Newton's iteration fails where a step would jump over it, and the step is made in parts.
The largest step is four times as long as the snap itself. Where the load is slow and inertia does not matter,
`fmbd.equilibrium(path=fmbd.ArcLength(...))` follows the branch.""",
    "sudden": """A force that begins between two steps. Generalized-alpha has no idea of it, and an error of the order of the
step. Schemes with error control find it by failing steps, at a price of accuracy; given as
`Scene(breakpoints=...)` all schemes end a step exactly there, constant steps too, and keep their order.""",
}

EDGES: dict[str, Edge] = {
    "light": Edge("Heavy on light", "masses", "place of the end, m", WHY["light"], heavy_on_light),
    "stiff": Edge("Stiff on soft", "stiffness", "fall of the tip, m", WHY["stiff"], stiff_on_soft),
    "slivers": Edge("Slivers", "cells", "deflection, share", WHY["slivers"], slivers),
    "nu": Edge("Nearly incompressible", "element", "deflection, share", WHY["nu"], nearly_incompressible),
    "spin": Edge("Fast spin", "rate", "angle, share", WHY["spin"], spin),
    "singular": Edge("Singular positions", "mechanism", "place of the top, m", WHY["singular"], singular_positions),
    "redundant": Edge("Nearly redundant hinges", "hinges", "angle, rad", WHY["redundant"], nearly_redundant),
    "impacts": Edge("Many impacts at once", "balls", "height, m", WHY["impacts"], many_impacts),
    "snap": Edge("Snap-through", "step", "deepest place, share", WHY["snap"], snap_through),
    "sudden": Edge("Sudden loads", "scheme", "place, share", WHY["sudden"], sudden_loads),
}


def shown(row: Row) -> str:
    """A row of the table."""
    error = "" if np.isnan(row.error) else f"{row.error:.1e} ({row.allowed:.0e})"
    words = row.words.replace("|", "/").replace("\n", " ")
    return f"| {row.setting} | {row.verdict} | {error} | {words if len(words) < 240 else words[:237] + '...'} |"


def section(edge: Edge) -> tuple[list[str], list[Row]]:
    """Its part of the page, and its rows."""
    rows = list(edge.rows())
    lines = [f"## {edge.title}", "", edge.why, ""]
    lines += [f"| {edge.setting} | ends | error: {edge.measure} (allowed) | what it says |", "|---|---|---|---|"]
    return [*lines, *map(shown, rows), ""], rows


HEAD = """# At the edge

Ten scenes, each turned up until it is refused or the numbers end: masses, stiffness, cells, speeds, steps. Written by
`tests/extremes.py`, which compares every run with an integration or formula of its own. A run ends *right* (within the error
allowed, given in brackets, and without a warning), *warned* (it ended and said what is doubtful; its error is given), or
*refused* (one error, and what to do). None may end wrong without a word.

Scenes that nobody chose are drawn by `tests/random_scenes.py` (chains, rods, bouncing balls; masses of 1e-8 to 1e8
kg, stiffness of 1e-3 to 1e18 N/m, steps of 1e-6 to 1 of the fastest period) and `tests/random_mechanisms.py` (trees
on all joints in the plane and in space, with gears, screws, loops, drives, controllers, friction, stops, tyres; all
schemes and forms; with restarts and tolerances). Of 5 000 of the first 4 935 ended right by an independent
integration or balance, 63 were refused and 2 warned; none hung or ended otherwise, in 665 s of processor time. Rods, lines,
wires, fields of all laws, rolling bodies, stops and contacts are drawn by `tests/random_flexible.py`, in lengths, times and
masses of 1e-3 to 1e3, and judged by closed solutions, balances of momentum and energy, and runs of other schemes: of
160, 154 ended right, 3 were refused and 3 warned.
"""


def main(names: list[str]) -> int:
    """The scenes named, or all of them on the page."""
    page, wrong = [HEAD], 0
    for name in names or EDGES:
        lines, rows = section(EDGES[name])
        page += lines
        print("\n".join(lines), flush=True)
        wrong += sum(row.verdict == WRONG for row in rows)
    if not names:
        (ROOT / "docs/extremes.md").write_text("\n".join(page).rstrip() + "\n")
    return wrong


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) > 0)
