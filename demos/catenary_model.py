"""The reference catenary and pantograph of EN 50318:2002: data, the hung catenary, the scene, and the standard's figures.

Ten spans of 60 m; contact wire and messenger wire as tensioned beams, nine droppers a span, a steady arm at each support. The
data leave the droppers' lengths open: see SAG. The pantograph is two lumped masses; the standard's contact spring of 50 kN/m
carries a light strip, and the strip slides along the wire under a multiplier: the contact force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import fmbd_fenicsx as fmbd

SPAN, DROPPERS = 60.0, (5.0, 10.5, 17.0, 23.5, 30.0, 36.5, 43.0, 49.5, 55.0)
CONTACT, MESSENGER = fmbd.Wire(1.35, 20e3, 195.0), fmbd.Wire(1.07, 16e3, 131.7)
HEAD, FRAME = (7.2, 4200.0, 10.0), (15.0, 50.0, 90.0)  # mass, stiffness and damping below it
CONTACT_STIFFNESS, STRIP = 5e4, 0.01  # N/m, kg: the strip that slides on the wire, on the standard's contact spring
STATIC_FORCE, G = 120.0, 9.81
DAMPING = (0.0125, 1e-4)  # 1/s and s; the data give none: proportional damping, small
SAG = 0.018  # m; level (0) and 0.03 each miss some of the standard's ranges, see docs/pantograph_catenary.md
RAMP = 1.0  # s, smooth start of the drive


def catenary(spans: int = 10, h: float = 0.5) -> fmbd.Wires:
    """The hung wires: number 0 the contact wire, 1 the messenger; h (m) must divide 0.5 m."""
    supports = []
    for x in SPAN * np.arange(1, spans):
        supports += [fmbd.PointSupport(0, x, 300.0), fmbd.PointSupport(1, x, 5e4)]
    droppers = [fmbd.Dropper(1, 0, k * SPAN + x, 1e5) for k in range(spans) for x in DROPPERS]
    wires = fmbd.Wires(
        "catenary",
        spans * SPAN,
        round(spans * SPAN / h),
        (CONTACT, MESSENGER),
        tuple(supports),
        tuple(droppers),
        *DAMPING,
    )
    return wires.hung(sag, gravity=G)


def sag(x: float) -> float:
    """How far below its supports the contact wire hangs at the dropper at x: a parabola from first to last dropper."""
    s, first, last = x % SPAN, DROPPERS[0], DROPPERS[-1]
    return SAG * max(4 * (s - first) * (last - s) / (last - first) ** 2, 0.0)


def pantograph() -> fmbd.CoordinateBody:
    """Heights of strip, head and frame above their place at rest, and an idle coordinate for the time without contact."""
    (m1, k1, c1), (m2, k2, c2) = HEAD, FRAME

    def chain(top: float, middle: float, low: float) -> np.ndarray:
        out = np.zeros((4, 4))
        for i, j, k in ((0, 1, top), (1, 2, middle)):
            out[[i, j], [i, j]] += k
            out[[i, j], [j, i]] -= k
        out[2, 2] += low
        return out

    K, C, push = chain(CONTACT_STIFFNESS, k1, k2), chain(0.0, c1, c2), np.array([0.0, 0.0, STATIC_FORCE, 0.0])
    mass = np.diag([STRIP, m1 - STRIP, m2, 1.0])
    return fmbd.CoordinateBody("pantograph", mass, lambda q, v, t: push - K @ q - C @ v, np.zeros(4))


def scene(speed: float, *, spans: int = 10, h: float = 0.5, start: float = 10.0) -> fmbd.Scene:
    """Pantograph under the catenary at ``speed`` (m/s), at rest with the wires at the start."""
    made = fmbd.Scene("pantograph and catenary", gravity=(0.0, -G), settle=True)
    wires, pan = catenary(spans, h), pantograph()
    made.add(wires, pan, fmbd.SlidingContact("contact", wires, pan, start=start, speed=speed, ramp=RAMP, idle=3))
    made.sensor("contact", fmbd.reaction("contact"))
    made.sensor("pantograph", fmbd.coordinates(pan))
    made.sensor("supports", fmbd.wire_height(wires, 0, SPAN * np.arange(1, spans)))
    made.sensor("droppers", fmbd.dropper_forces(wires))
    return made


@dataclass(frozen=True)
class Figures:
    """The standard's figures of the contact force over the analysis section, filtered to 20 Hz; N and mm."""

    mean: float
    deviation: float
    largest: float
    smallest: float
    uplift: float
    loss: float  # per cent of the time without contact

    @property
    def statistical(self) -> tuple[float, float]:
        """Mean plus and minus three standard deviations."""
        return self.mean + 3 * self.deviation, self.mean - 3 * self.deviation


def low_pass(t: np.ndarray, x: np.ndarray, cut: float = 20.0) -> np.ndarray:
    """Butterworth filter of order 6, forwards and backwards (no phase), Hz."""
    from scipy.signal import butter, sosfiltfilt

    return np.asarray(sosfiltfilt(butter(6, cut, fs=(len(t) - 1) / (t[-1] - t[0]), output="sos"), x))


def figures(
    run: fmbd.Run, speed: float, *, start: float = 10.0, section: tuple[float, float] = (240.0, 360.0)
) -> Figures:
    """Figures over the spans 5 and 6 of the standard (or another section, m)."""
    t, force = run.times, run["contact"][:, 0]
    x = start + speed * (t - 0.5 * RAMP)  # after the smooth start
    inside = (x >= section[0]) & (x <= section[1])
    F = low_pass(t, force)[inside]
    at = round(section[0] / SPAN) - 1  # supports at both ends and in the middle of the section
    rise = run["supports"] - run["supports"][0]
    uplift = 1e3 * rise[:, at : at + 3].max()
    lost = 100.0 * float((force[inside] <= 0).mean())
    return Figures(F.mean(), F.std(), F.max(), F.min(), float(uplift), lost)
