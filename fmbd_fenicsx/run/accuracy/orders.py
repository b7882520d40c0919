"""Orders in the step: which one a scheme has in a sensor, which one was seen, and which one errors are extrapolated with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ...rotations import Array
from ...schemes.dae import Index3, OfForm
from ...schemes.declared import Declared
from ...system.element_memory import collocated
from ...system.scene.scene import Scene
from ...system.system import System

SEEN = 0.75  # share of the expected order above which runs with larger steps follow the same motion
REGULAR = 0.9  # the same above which an order is what it seems
LEAST_ORDER = 0.5
# the trapezoidal rule of laws with a memory, arms of rods that relax; friction that knows ends of steps alone
OF_MEMORIES = 2
BETWEEN, MOST_BETWEEN = 0.4, 0.5  # of the way from an order seen to the expected one; and the most that this may be
TOO_HIGH = 1.0  # what an order is beyond that of the scheme that belongs to another motion
LARGE = 0.02  # error of time over the range of a sensor below which such an order does not matter
# order that a jump of a force (1) or of its slope (2) leaves, at least and at most: others are impacts, or smooth motion
LEAST_LEFT, MOST_LEFT = 0.5, 2.5
CLEARLY = 0.05  # lower than the order of the scheme: what is left counts
ALONE = 0.05  # of the largest difference, that half of all stay below beside a kink: those of vibrations do not
SHARPER = 1.3  # growth of differences with each one more about a kink, at least; of motion that steps follow they fall
AS_ROUGH = 0.2  # of the largest difference: other kinks
SEEN_KINK = 1e-6  # error by a kink over the range of a sensor below which differences tell of Newton's iteration, too
FALLING = 0.5  # order below which differences do not fall with the step: a tenth of such an error matters


def expected_orders(scheme: Any, scene: Scene, system: System) -> dict[str, int]:
    """The order that a scheme has in each sensor: multipliers, and motion that constraints take part in, may have a lower one
    than positions (:attr:`.Declared.orders`), and none is above that of memories of continuous elements that the scheme does not
    find as it finds the motion. Volumes that bodies keep are constraints on positions alone.
    """
    keeps_volumes = any(part.field.keeps_volume for _, part in system.fields)
    of_index_3 = keeps_volumes and isinstance(scheme, OfForm)
    said = Declared.by(scheme)
    of_volumes = Declared.by(replace(scheme, form=Index3())) if of_index_3 else said
    orders = of_volumes.orders if system.blocks or system.contacts is not None or keeps_volumes else None
    known = (scheme.order,) * 3 if orders is None else orders
    if said.corrects and not system.fields:
        known = (*known[:2], known[1])

    found = collocated(system) if said.finds_memories else []
    left = [keeper for keeper in system.keepers if keeper not in found]
    remembers = any(len(keeper.memory_values()) for keeper in left) or seen_by_ends(system)
    highest = min(OF_MEMORIES if remembers else max(known), highest_order(scheme, system))
    return {name: min(known[sensor.derivative], highest) for name, sensor in scene.sensors.items()}


def highest_order(scheme: Any, system: System) -> int:
    """The order of a scheme in positions, with what rubs in a system."""
    lowered = Declared.by(scheme).of_friction
    rubs = seen_by_ends(system) or (system.contacts is not None and system.contacts.frictional)
    return int(lowered if rubs and lowered is not None else scheme.order)


def seen_by_ends(system: System) -> bool:
    """Whether elements are moved by the ends of steps alone: the error that chooses steps does not know what they miss between,
    as a rod that slides on, stops and slides back within one.
    """
    return any(f.by_ends for f in system.forces)


def resolved(seen: Mapping[str, float], expected: Mapping[str, float], share: float = SEEN) -> bool:
    """Whether all orders that were seen are a share of the expected ones at least."""
    return all(p >= share * expected[name] for name, p in seen.items())


def irregular(orders: tuple[int, int], seen: float, share: float) -> bool:
    """Whether the order that was ``seen`` belongs to another motion than what converges with the ``orders`` of the scheme in the
    sensor and in positions, and the error, as a ``share`` of the range, is large enough to matter.
    """
    return not of_the_scheme(orders, seen) and share > (LARGE if seen >= FALLING else 0.1 * LARGE)


def of_the_scheme(orders: tuple[int, int], seen: float) -> bool:
    """Whether the order that was ``seen`` may be that of the scheme in the sensor, and in positions; so may one that was not."""
    expected, highest = orders
    return bool(np.isnan(seen) or SEEN * expected <= seen <= highest + TOO_HIGH)


def usable_order(p: float, order: float) -> float:
    """The order that differences are extrapolated with, from the one that was seen, nan where none was.

    Below that of the scheme p is a mixture: slow motion has the order of the scheme, fast motion is off by about its own size
    with the larger steps, so that its differences do not grow with them. Errors by p and by the order of the scheme differ by a
    factor of up to seven, with the truth between them; an order between them is not far from either. Above it motion may converge
    faster than the scheme has to (with friction, off slips), or larger steps do not follow it yet: what is more than a half
    above counts, up to a half.
    """
    if np.isnan(p):
        return order
    low = max(p, LEAST_ORDER)
    if low < order:
        return low + min(BETWEEN * (order - low), MOST_BETWEEN)
    return order + max(min(low - order, 1.0) - 0.5, 0.0)


def kink(t: Array, x: Array, order: float, derivative: int) -> tuple[float, float]:
    """The error that jumps of forces and of their slopes within steps may leave in a series x (n, size) at equally
    spaced t (s), and the order that they leave a scheme of an ``order``; (0, inf) where the series is smooth enough.
    ``derivative``: 0 of places, 1 of velocities, 2 of accelerations. Runs with h, 2 h and 4 h do not tell it: where
    jumps fall in their steps is chance.

    What jumps in the k-th derivative of a place has differences like h^k, however many are taken, smooth motion like h^m:

        k = log2(|D_2h^m x| / |D_h^m x|) + derivative,     the order is k - 1                                        (1)

    in the root of the sum of squares about the largest one, which depends on where in a step a kink falls less than that one
    alone does. Few differences are taken, as many of a motion that steps follow coarsely fall as slowly; those about a kink
    stand alone and grow with each one more, those of a vibration within few steps are large throughout. A force that jumps by
    J (k = 2) moves v by up to J h / 2, and v goes on for about s = max|x| / max|x'| as it is: of places, velocities and
    accelerations that is about 0.6 s D / h, D / 4, 0.16 h D / s, with D = |D_h^m x| in this sense: by the scheme,
    half of the most that may be left, or a little more than all of it.
    """
    m = _differences(derivative)
    if len(t) < 4 * (m + 1) or np.ptp(np.diff(t)) > 1e-6 * (t[1] - t[0]):
        return 0.0, np.inf

    heights = np.abs(np.diff(x, m, axis=0)).max(axis=1)
    at, about = int(heights.argmax()), m + 2
    if at < m or np.median(heights) > ALONE * heights[at]:
        return 0.0, np.inf

    fine = _about(x, m, at, about)
    wide = float(np.sqrt(0.5 * sum(_about(x[k::2], m, (at - k) // 2, about) ** 2 for k in (0, 1))))
    left = float(np.log2(wide / fine)) + derivative - 1 if min(wide, fine) > 0 else np.inf
    if not LEAST_LEFT <= left < min(order - CLEARLY, MOST_LEFT) or _about(x, m + 1, at, about) < SHARPER * fine:
        return 0.0, np.inf

    span, step = float(np.ptp(x, axis=0).max()), float(np.quantile(np.abs(np.diff(x, axis=0)).max(axis=1), 0.9))
    lasts = min(0.5 * span / step, float(len(t))) if step > 0 else float(len(t))  # s / h
    error = fine * (0.6 * lasts, 0.25, 0.16 / lasts)[derivative]
    return (error, left) if error > SEEN_KINK * span else (0.0, np.inf)


def rough(t: Array, x: Array, derivative: int) -> list[Array]:
    """The times about all that differences of a series, as :func:`kink` takes them, show as much as its largest kink."""
    m = _differences(derivative)
    if len(t) < m + 1:
        return []
    heights = np.abs(np.diff(x, m, axis=0)).max(axis=1)

    # each difference is made of m + 1 values, and what jumps after the last of them moves it little
    about = np.zeros(len(t), dtype=bool)
    for k in np.flatnonzero(heights > AS_ROUGH * heights.max()):
        about[max(k - 1, 0) : k + m + 2] = True
    ends = np.flatnonzero(np.diff(about)) + 1
    return [times for times, kept in zip(np.split(t, ends), np.split(about, ends), strict=True) if kept[0]]


def _differences(derivative: int) -> int:
    """How many differences are taken of a series: 0 of places, 1 of velocities, 2 of accelerations."""
    return max(5 - derivative, 3)


def _about(x: Array, m: int, at: int, wide: int) -> float:
    """The root of the sum of squares of the m-th differences of a series (n, size) about one of them."""
    near = np.diff(x, m, axis=0)[max(at - wide, 0) : at + wide + 1]
    return float(np.sqrt((near**2).sum()))


def order_seen(first: int, second: int, third: int, ratio: float) -> float:
    """The order p for which errors like n^-p of runs with so many steps n, rising, give differences of this ratio:

    (first^-p - second^-p) / (second^-p - third^-p) = ratio,     0 where it is too small for any p > 0           (1)
    """
    if second**2 == first * third:
        return float(np.log(ratio) / np.log(second / first)) if ratio > 0 else 0.0
    below, above = 0.0, 64.0
    for _ in range(60):
        p = 0.5 * (below + above)
        near, far = (first / second) ** p, (first / third) ** p
        below, above = (p, above) if 1 - near < ratio * (near - far) else (below, p)
    return below
