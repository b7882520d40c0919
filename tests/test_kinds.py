"""Every kind that the package defines: rows, rates, second derivatives and tangents against differences; C against NumPy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fmbd_fenicsx.mechanics.kinds.derivation import KERNELS, Kind, c_source, derive, kinds, numpy_kernel
from fmbd_fenicsx.mechanics.kinds.expressions import (
    Program,
    atan2,
    exp,
    gradient,
    log,
    nearest_turn,
    passing,
    sin,
    sqrt,
    symbol,
    tanh,
)
from fmbd_fenicsx.mechanics.kinds.frames import FRAME, PLACES, AskedConstants, SymbolicFrame
from fmbd_fenicsx.mechanics.kinds.jets import Jet, jet
from fmbd_fenicsx.mechanics.kinds.library import kernel
from fmbd_fenicsx.mechanics.kinds.own import markers_of, own_term

FLOWS = tuple(name for name, kind in kinds(3).items() if kind.flow)
BOTH = pytest.mark.parametrize("dim", [2, 3])


def frame(dim: int, rng: np.random.Generator) -> np.ndarray:
    """A random frame with a random twist."""
    if dim == 2:
        phi = float(rng.uniform(-9, 9))
        c, s = np.cos(phi), np.sin(phi)
        return np.concatenate((rng.normal(size=2), [c, -s, s, c], rng.normal(size=3), [phi]))
    R = Rotation.random(random_state=int(rng.integers(1000))).as_matrix()
    return np.concatenate((rng.normal(size=3), R.ravel(), rng.normal(size=6)))


def moved(x: np.ndarray, dim: int, h: float, twist: np.ndarray | None = None) -> np.ndarray:
    """A frame after the time h at its own or another constant twist."""
    v = x[dim + dim * dim :][: 3 * dim - 3] if twist is None else twist
    y = x.copy()
    y[:dim] += h * v[:dim]
    if dim == 2:
        y[9] += h * v[2]
        c, s = np.cos(y[9]), np.sin(y[9])
        y[2:6] = c, -s, s, c
    else:
        y[3:12] = (Rotation.from_rotvec(h * v[3:]).as_matrix() @ x[3:12].reshape(3, 3)).ravel()
    return y


def item(kind: Kind, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two frames and constants."""
    rng = np.random.default_rng(seed)
    A, B = frame(kind.dim, rng), frame(kind.dim, rng)
    return A, B, rng.uniform(0.5, 1.5, kind.width)


def driven(kind: Kind, P: np.ndarray, h: float) -> np.ndarray:
    """Constants after the time h: the drive moves on by its rates."""
    out = P.copy()
    if kind.driven:
        s, s1, s2 = (kind.place(n).start for n in ("drive", "drive1", "drive2"))
        out[s] = P[s] + h * P[s1] + 0.5 * h * h * P[s2]
        out[s1] = P[s1] + h * P[s2]
    return out


def defects(kind: Kind, seed: int = 1) -> dict[str, float]:
    """What each kernel misses of differences of the one before it."""
    A, B, P = item(kind, seed)
    n, d, h = 3 * kind.dim - 3, kind.dim, 1e-4
    value, rates, tangent = (numpy_kernel(kind, which) for which in KERNELS)
    V = np.concatenate((A[d + d * d :][:n], B[d + d * d :][:n]))

    def row(A: np.ndarray, B: np.ndarray, P: np.ndarray) -> np.ndarray:
        out = np.zeros(2 * n)
        out[list(kind.entries)] = value(A, B, P)[1:]
        return out

    def level(k: float) -> tuple[float, float]:
        a, b, p = moved(A, d, k * h), moved(B, d, k * h), driven(kind, P, k * h)
        return float(value(a, b, p)[0]), float(row(a, b, p) @ V + rates(a, b, p)[0])

    at = {k: level(k) for k in (-2, -1, 1, 2)}
    slope = [(8 * (at[1][i] - at[-1][i]) - at[2][i] + at[-2][i]) / (12 * h) for i in (0, 1)]
    found = {"gamma": abs(float(rates(A, B, P)[1]) - slope[1])}
    if kind.name not in FLOWS:
        found["row"] = abs(level(0)[1] - slope[0])

    # geometric stiffness: differences of the row along unit twists, symmetric part
    H = np.zeros((2 * n, 2 * n))
    for j, unit in enumerate(np.eye(2 * n)):
        near, far = (
            [row(moved(A, d, s * h, unit[:n]), moved(B, d, s * h, unit[n:]), P) for s in (k, -k)] for k in (1, 2)
        )
        H[:, j] = (8 * (near[0] - near[1]) - far[0] + far[1]) / (12 * h)
    mine = np.zeros_like(H)
    for (i, j), y in zip(kind.pattern, tangent(A, B, P, 1.0), strict=True):
        mine[i, j] = mine[j, i] = y
    found["tangent"] = float(np.abs(mine - 0.5 * (H + H.T)).max())
    return found


@pytest.mark.parametrize(("dim", "name"), [(dim, name) for dim in (2, 3) for name in kinds(dim)])
def test_derivatives_are_those_of_differences(name: str, dim: int) -> None:
    for seed in (1, 2):
        for what, missed in defects(kinds(dim)[name], seed).items():
            assert missed < 3e-7, (what, missed)


@BOTH
def test_kernels_between_origins_leave_out_what_arms_add(dim: int) -> None:
    a, b = (SymbolicFrame(name, dim) for name in "AB")
    near, far = markers_of((a, b), AskedConstants(dim))
    own = own_term("own", (near.x @ near.x) * (far.R[0] @ near.x), dim).kind  # no difference of places
    for kind in (x for x in (*kinds(dim).values(), own) if not PLACES.keys().isdisjoint(x.constants)):
        plain = kind.between_origins
        assert plain.constants == kind.constants and set(plain.entries) <= set(kind.entries), kind.name
        A, B, P = item(kind, 3)
        for name in PLACES.keys() & kind.constants.keys():
            P[kind.place(name)] = 0.0
        for which, places in (("value", (None, *kind.entries)), ("rates", (0, 1)), ("tangent", kind.pattern)):
            some = {"value": (None, *plain.entries), "rates": (0, 1), "tangent": plain.pattern}[which]
            full = dict(zip(places, kind.run(which, A, B, P, 1.3), strict=True))
            found = dict(zip(some, plain.run(which, A, B, P, 1.3), strict=True))
            assert full.keys() >= found.keys()
            assert max(abs(full[x] - found.get(x, 0.0)) for x in full) < 1e-13 if full else True, (kind.name, which)


@BOTH
@pytest.mark.parametrize("name", ["along", "turned", "separation", "angle"])
def test_a_wrong_sign_is_seen(name: str, dim: int) -> None:
    """Each output negated by itself: the check above must fail."""
    kind = kinds(dim)[name]
    for which, seen, place in (("rates", "gamma", 1), ("value", "row", 1), ("tangent", "tangent", 0)):
        if len(kind.outputs[which]) <= place or (name, dim, which) in QUIET:
            continue
        outputs = dict(kind.outputs)
        outputs[which] = [-y if i == place else y for i, y in enumerate(outputs[which])]
        assert defects(dataclasses.replace(kind, outputs=outputs))[seen] > 1e-4, which


QUIET = {("angle", 2, "rates")}  # gamma of the angle in the plane is zero


@pytest.mark.compiled
@BOTH
def test_c_and_numpy_agree(dim: int) -> None:
    found = kinds(dim)
    n, size = 7, FRAME[dim]
    for kind in found.values():
        items = [item(kind, seed) for seed in range(n)]
        frames = np.array([x for A, B, _ in items for x in (A, B)])
        P, W = np.array([p for *_, p in items]), np.linspace(0.5, 2.0, n)
        pair = np.arange(2 * n, dtype=np.int32)
        for name in KERNELS:
            out = np.zeros((n, len(kind.outputs[name])))
            compiled = kernel(kind, name)
            compiled(n, *(x.ctypes.data for x in (pair, frames.reshape(-1, size), P, W, out)))
            wanted = numpy_kernel(kind, name)(frames[::2], frames[1::2], P, W)
            assert np.abs(out - wanted).max(initial=0) < 1e-13 * max(1.0, np.abs(wanted).max(initial=0)), (
                kind.name,
                name,
            )


@pytest.mark.parametrize("numbers", [False, True])
def test_gradient_of_every_operation(numbers: bool) -> None:
    x, y = symbol("x"), symbol("y")
    made = sin(x * y) / sqrt(x + 2) - exp(-y) * log(x) + tanh(x - y) * atan2(y, x) ** 2 + 3 - nearest_turn(x, y)
    made = made + np.arctan(x * y) + np.hypot(x, y)
    value, slope = (Program(z, numbers=numbers) for z in ([made], gradient(made, [x, y])))
    at, h = {"x": 1.3, "y": 0.4}, 1e-6
    for name, found in zip("xy", slope(at), strict=True):
        ends = [value(at | {name: at[name] + s * h})[0] for s in (1, -1)]
        assert found == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-8)


@pytest.mark.parametrize("name", "tan arctan arcsin arccos sinh cosh expm1 log10 deg2rad".split())
@pytest.mark.parametrize("place", [1e-9, 0.4, 1.0 - 1e-9])
def test_functions_that_are_made_of_others_are_as_accurate_as_those_of_numpy(name: str, place: float) -> None:
    """Inverse kinematics are written with them; each was asked for with numbers at every time."""
    function, x = getattr(np, name), symbol("x")
    value, slope = Program([function(x), *gradient(function(x), [x])], numbers=True)({"x": place})
    exact = jet(function(Jet(place, 1.0)))
    assert value == pytest.approx(exact.value, rel=1e-15)
    assert slope == pytest.approx(exact.first, rel=1e-9)


@pytest.mark.parametrize("power", [-2, -1.5, 0, 0.3, 0.5, 1, 2.5, 3])
def test_any_power_of_a_positive_number(power: float) -> None:
    x = symbol("x")
    value, slope = Program([x**power, *gradient(x**power, [x])])({"x": np.array(1.7)})
    assert value == pytest.approx(1.7**power, rel=1e-14)
    assert slope == pytest.approx(power * 1.7 ** (power - 1), rel=1e-14, abs=1e-14)


def test_arrays_take_expressions_entry_by_entry() -> None:
    x, y = symbol("x"), symbol("y")
    z = np.array([y, 2.0], dtype=object)
    for made, wanted in (
        (x * z, x * y),
        (x + z, x + y),
        (x - z, x - y),
        (z - x, y - x),
        (x / z, x / y),
        (z / x, y / x),
    ):
        assert made[0] is wanted


def test_what_is_made_in_passing_is_forgotten() -> None:
    with passing():
        made = symbol("only here") * 3.0
        program = Program([made], numbers=True)
    assert symbol("only here") is not made.arguments[1]
    assert program({"only here": 2.0}) == [6.0]


def test_equal_subexpressions_are_one_node() -> None:
    x, y = symbol("x"), symbol("y")
    assert x * y + 1 is y * x + 1
    assert (x - y) * 0 is (x - x)
    assert -1 * (-x) is x
    assert len(c_source({"one": derive("one", 2, lambda a, b, c: (b.x - a.x) @ (b.x - a.x))})) > 100


def test_definitions_tell_which_constants_are_fixed_in_a_frame() -> None:
    """Compiled code turns these from the axes of the markers, and no others: a load of a follower, not that of a dead force."""
    found = {name: kinds(3)[name].sides for name in ("turned", "follower", "dead", "distance")}
    assert found["turned"] == {"e": 0, "g": 0, "f": 1}
    assert found["follower"] == {"load": 1, "q": 1}
    assert found["dead"] == {"q": 1}
    assert found["distance"] == {"p": 0, "q": 1}
