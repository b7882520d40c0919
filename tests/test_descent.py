"""Equilibria far from the start, of strings and chains whose masses differ by up to 1e9."""

import numpy as np
import pytest
from scipy.optimize import fsolve

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.analysis.small_motions.perturbation import Perturbation
from fmbd_fenicsx.system.compiled.choice import use_driver
from fmbd_fenicsx.system.layout import State

SPAN = 0.8  # between the anchors of a string of length 1, m


def zigzag(count: int, seed: int) -> np.ndarray:
    """Places (count + 1, 2) of the ends of so many links of equal length, from the origin."""
    angles = 0.6 * np.random.default_rng(seed).uniform(-1.0, 1.0, count)
    return np.concatenate(
        (np.zeros((1, 2)), np.cumsum(np.column_stack((np.cos(angles), np.sin(angles))), axis=0) / count)
    )


def string(masses: np.ndarray) -> fmbd.Scene:
    """Beads between two anchors on links of equal length, which together are 1 m long."""
    count = len(masses) + 1
    half = np.arccos(SPAN)
    up = np.minimum(np.arange(count + 1), count - np.arange(count + 1)) / count
    places = np.column_stack((np.linspace(0.0, SPAN, count + 1), up * np.sin(half)))  # an arch, upside down
    scene = fmbd.Scene("string", gravity=(0.0, -9.81))
    beads = [fmbd.PointMass(f"bead {i}", m, x) for i, (m, x) in enumerate(zip(masses, places[1:-1], strict=True))]
    scene.add(*beads, fmbd.distance("first", fmbd.ground, beads[0], point_a=(0.0, 0.0)))
    for i, (one, two) in enumerate(zip(beads, beads[1:], strict=False)):
        scene.add(fmbd.distance(f"link {i}", one, two))
    scene.add(fmbd.distance("last", beads[-1], fmbd.ground, point_b=(SPAN, 0.0)))
    for bead in beads:
        scene.sensor(bead.name, fmbd.position(bead))
    return scene


def hanging(masses: np.ndarray) -> np.ndarray:
    """Places of the beads: links along their tensions (T, V_i), two unknowns."""
    weights = 9.81 * np.concatenate(([0.0], np.cumsum(masses)))

    def links(x: np.ndarray) -> np.ndarray:
        tension = np.column_stack((np.full(len(weights), np.exp(x[0])), weights - weights[-1] * x[1]))
        return tension / np.linalg.norm(tension, axis=1)[:, None] / len(weights)

    scale = np.log(weights[-1])
    found = fsolve(lambda x: links(x).sum(0) - (SPAN, 0.0), (scale, 0.5), xtol=1e-13)
    assert np.abs(links(found).sum(0) - (SPAN, 0.0)).max() < 1e-10
    return np.cumsum(links(found), axis=0)[:-1]


@pytest.mark.parametrize("lowest, highest, count", [(0, 0, 5), (-2, 2, 7), (-6, 3, 5), (-6, 3, 11)])
def test_strings_of_light_and_heavy_beads(lowest: int, highest: int, count: int) -> None:
    """An arch of beads falls and hangs as its force polygon says."""
    masses = 10.0 ** np.random.default_rng(count).uniform(lowest, highest, count)
    found = fmbd.equilibrium(string(masses))
    places = np.array([found[f"bead {i}"] for i in range(count)])
    assert np.abs(places - hanging(masses)).max() < 1e-8
    assert found.counters["newton_iterations"] < 120


@pytest.mark.parametrize("kind", ["links", "beads"])
@pytest.mark.parametrize("lowest, count", [(0, 6), (-3, 12), (-6, 12)])
def test_chains_hang_straight_down(kind: str, lowest: int, count: int) -> None:
    """Whatever their masses: 1 m below the pin, which carries their weight."""
    masses = 10.0 ** np.random.default_rng(count).uniform(lowest, 3, count)
    scene, ends = fmbd.Scene("chain", gravity=(0.0, -9.81)), zigzag(count, count)
    before = fmbd.ground
    for i, m in enumerate(masses):
        if kind == "beads":
            body = fmbd.PointMass(f"{i}", m, ends[i + 1])
            start = {"point_a": (0.0, 0.0)} if i == 0 else {}
            scene.add(body, fmbd.distance(f"joint {i}", before, body, **start))
        else:
            body = fmbd.RigidBody(f"{i}", m, m / count**2 / 12, 0.5 * (ends[i] + ends[i + 1]))
            scene.add(body, fmbd.revolute(f"joint {i}", before, body, center=ends[i]))
        before = body
    scene.sensor("end", fmbd.position(before))
    scene.sensor("pin", fmbd.reaction_force("joint 0"))
    found = fmbd.equilibrium(scene)
    assert found["end"] == pytest.approx((0.0, -1.0 if kind == "beads" else -1.0 + 0.5 / count), abs=1e-8)
    assert found["pin"] == pytest.approx((0.0, -9.81 * masses.sum()), rel=1e-8, abs=1e-5 * masses.sum())


def pushed_rod(push: float, elements: int = 3) -> fmbd.Scene:
    """A clamped rod whose end is pushed across by a force that turns with it, growing in time."""
    section = fmbd.RodSection(stiffness=(1e6, 1e6, 1e6, 10.0, 10.0, 10.0), mass=1.0, inertia=(1e-4, 5e-5, 5e-5))
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=elements, degree=2)
    scene = fmbd.Scene("pushed", gravity=(0.0, 0.0, -1.0))
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start"), center=(0, 0, 0)))
    scene.add(fmbd.force("push", rod.surface("end"), lambda t: (0.0, push * t, 0.0), follower=True))
    scene.sensor("tip", fmbd.position(rod.surface("end")))
    return scene


@pytest.mark.parametrize("driven", [False, True])
def test_the_stiffness_of_all_coordinates_is_asked_for_at_once(driven: bool) -> None:
    """It is that of one after the other, by one call in place of four for each coordinate."""
    system, given, _ = pushed_rod(80.0).build()
    if driven:
        use_driver(system)
    rng, n = np.random.default_rng(0), system.n_v
    q = system.compose(given.q, 0.01 * rng.normal(size=n))
    about = Perturbation(system, State(1.0, q, np.zeros(n), np.zeros(n), rng.normal(size=system.n_lam)))
    columns = np.diag(1.0 / system.units)
    each = np.array([about.stiffness(y) for y in columns.T]).T
    np.testing.assert_allclose(about.stiffness_matrix(columns), each, rtol=0, atol=1e-12 * np.abs(each).max())


def test_loads_that_turn_are_found_in_one_go_as_step_by_step() -> None:
    """From the straight rod descent does not get there, a motion that comes to rest does."""
    at_once = fmbd.equilibrium(pushed_rod(80.0, elements=2), t=1.0)
    found = fmbd.equilibrium(pushed_rod(80.0, elements=2), path=fmbd.LoadSteps(tuple(np.linspace(0.1, 1.0, 10))))
    assert found["tip"][1] == pytest.approx(0.63, abs=0.05)
    np.testing.assert_allclose(at_once["tip"], found["tip"], rtol=0, atol=1e-8)
    assert repr(found).startswith('<Equilibrium of "pushed": t = 1 s, 11 points of a path, ')


@pytest.mark.parametrize("stiffness", [1e4, 1e8])
def test_ropes_that_only_pull_hang_as_a_catenary(stiffness: float) -> None:
    """Ten masses of 10 kg on eleven ropes of 1 m over 8 m, placed too deep: most increments make some rope slack. The tension at
    the ends carries half of the weight, and ropes are as long as theirs makes them.
    """
    count, span = 11, 8.0
    x = np.linspace(0.0, span, count + 1)
    y = -3.0 * np.sin(np.pi * x / span)
    scene = fmbd.Scene("ropes", gravity=(0.0, -9.81))
    beads = [fmbd.PointMass(f"bead {i}", 10.0, (x[i], y[i])) for i in range(1, count)]
    scene.add(*beads)
    ends = [fmbd.ground, *beads, fmbd.ground]
    for i in range(count):
        places = (x[i], y[i]), (x[i + 1], y[i + 1])
        scene.add(
            fmbd.Spring(
                f"rope {i}", *ends[i : i + 2], *places, law=lambda s, v, t: stiffness * np.maximum(s - 1.0, 0.0)
            )
        )
    for bead in beads:
        scene.sensor(bead.name, fmbd.position(bead))
    found = fmbd.equilibrium(scene)
    way = np.diff([(0.0, 0.0), *(found[bead.name] for bead in beads), (span, 0.0)], axis=0)
    length = np.linalg.norm(way, axis=1)
    pull = (stiffness * (length - 1.0) / length)[:, None] * way
    np.testing.assert_allclose(np.diff(pull, axis=0), [[0.0, 98.1]] * len(beads), rtol=0, atol=1e-4)
    # a descent among kinks that went on to its last: 271
    assert found.counters["newton_iterations"] < 150, found.counters


@pytest.mark.parametrize("push", [1e3, 1e6, 1e10])
def test_a_soft_spring_gives_way_by_many_lengths_of_the_model(push: float) -> None:
    """1 N/m along a slanted slider: pushes of more than some 1e5 m were refused, the body could "move freely"."""
    box = fmbd.RigidBody("box", 1.0, 1.0)
    slide = fmbd.prismatic("slide", fmbd.ground, box, center=(0.3, 0.1), axis=(0.6, 0.8))
    scene = fmbd.Scene("push")
    scene.add(box, slide, fmbd.joint_spring("spring", fmbd.displacement(slide), stiffness=1.0))
    scene.add(fmbd.force("push", box, (push, 0.0)))
    scene.sensor("way", fmbd.displacement("slide"))
    np.testing.assert_allclose(fmbd.equilibrium(scene)["way"], 0.6 * push, rtol=1e-9)


@pytest.mark.parametrize("push", [1e-9, 1.0])
def test_a_free_body_is_refused_however_small_the_push(push: float) -> None:
    """One of 1e-9 N was an equilibrium in silence: without any stiffness increments were forces taken for lengths."""
    box = fmbd.RigidBody("box", 1.0, 1.0)
    scene = fmbd.Scene("free")
    scene.add(box, fmbd.force("push", box, (push, 0.0)))
    with pytest.raises(fmbd.errors.ConvergenceError, match="can move freely"):
        fmbd.equilibrium(scene)
