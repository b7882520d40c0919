"""Every scheme with every body, joint, force, tie and contact: small scenes, each run against a finer reference.

Run:  ./with-dolfinx python3 tests/combinations.py            all of them (about ten minutes); writes docs/combinations.md
      ./with-dolfinx python3 tests/combinations.py Radau      some schemes; prints only
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import materials
from fmbd_fenicsx.errors import CallbackError, ConvergenceError, FmbdError, InputError

ROOT = Path(__file__).resolve().parents[1]
T_END, DT, FINER = 0.04, 1e-3, 4
YOUNG, DENSITY, HEIGHT = 1e8, 1000.0, 0.1  # a rod of 1 m: 5 Hz as a cantilever
TOLERANCE = 2e-2  # of the way that the reference moves; the schemes of first order need it
AT_IMPACTS = 0.15  # the same with contact: impacts are of first order, and waves of the step's size


@dataclass(frozen=True)
class Hung:
    """A body along x from the origin: what its left end and its tip are called by joints and forces."""

    body: Any
    left: Any
    tip: Any


# -- bodies -----------------------------------------------------------------------------------------------------
@cache
def rod_mesh() -> Any:
    """The rod of meshes/rod.py, coarse."""
    return fmbd.read_gmsh(ROOT / "meshes/rod.py", dim=2, h=0.25, length=1.0, height=HEIGHT)


def rigid() -> Hung:
    """A rigid rod in the plane."""
    body = fmbd.RigidBody("rod", DENSITY * HEIGHT, DENSITY * HEIGHT / 12, position=(0.5, 0.0))
    return Hung(body, body, body)


def elastic(kind: type, **law: Any) -> Hung:
    """A rod of finite elements."""
    body = kind("rod", rod_mesh(), density=DENSITY, **law)
    return Hung(body, body.surface("pin"), body.surface("tip"))


def floating() -> Hung:
    """In a floating frame."""
    return elastic(fmbd.FloatingBody, elastic=materials.plane_stress(YOUNG, 0.3))


def reduced() -> Hung:
    """By four modes."""
    body = floating().body.reduced(modes=4)
    return Hung(body, body.surface("pin"), body.surface("tip"))


def absolute() -> Hung:
    """In absolute coordinates, small strains."""
    return elastic(fmbd.AbsoluteBody, elastic=materials.plane_stress(YOUNG, 0.3))


def large() -> Hung:
    """In absolute coordinates, large strains."""
    return elastic(fmbd.AbsoluteBody, energy=materials.sheet_saint_venant_kirchhoff(YOUNG, 0.3))


def with_pressure() -> Hung:
    """Nearly incompressible: displacement and pressure."""
    return elastic(fmbd.AbsoluteBody, elastic=materials.nearly_incompressible(YOUNG, 0.4999))


def incompressible() -> Hung:
    """Incompressible: the pressure is an unknown."""
    return elastic(fmbd.AbsoluteBody, energy=materials.neo_hookean_incompressible(YOUNG))


def beam() -> Hung:
    """A beam in its own frame."""
    section = fmbd.Section.rectangle(0.1, HEIGHT, youngs_modulus=YOUNG, density=DENSITY)
    body = fmbd.Beam("rod", (0, 0), (1, 0), section)
    return Hung(body, body.surface("start"), body.surface("end"))


BODIES: dict[str, Callable[[], Hung]] = {
    "rigid": rigid,
    "floating": floating,
    "reduced": reduced,
    "absolute": absolute,
    "large strain": large,
    "pressure": with_pressure,
    "incompressible": incompressible,
}


# -- what holds and moves them ------------------------------------------------------------------------------------
def pinned(scene: fmbd.Scene, rod: Hung) -> Any:
    """A hinge at the left end."""
    pin = fmbd.revolute("pin", fmbd.ground, rod.left, center=(0, 0))
    scene.add(pin)
    return pin


def hinge(scene: fmbd.Scene, rod: Hung) -> None:
    """A hinge alone."""
    pinned(scene, rod)


def clamp(scene: fmbd.Scene, rod: Hung) -> None:
    """The mean of the left end held."""
    scene.add(fmbd.fixed("clamp", fmbd.ground, rod.left, center=(0, 0)))


def field_tie(scene: fmbd.Scene, rod: Hung) -> None:
    """Every point of the left end held, by a field of multipliers."""
    scene.add(fmbd.tie_surface("tie", rod.left, fmbd.ground))


def drive(scene: fmbd.Scene, rod: Hung) -> None:
    """A prescribed angle."""
    pin = pinned(scene, rod)
    scene.add(fmbd.drive("motor", fmbd.angle(pin), lambda t: 50.0 * t**3))


def spring(scene: fmbd.Scene, rod: Hung) -> None:
    """A spring with a damper at the tip."""
    pinned(scene, rod)
    anchor = {"point_a": (1, 0.5), "point_b": (1, 0)}
    scene.add(fmbd.Spring("spring", fmbd.ground, rod.tip, stiffness=1e4, damping=20.0, **anchor))


def feedback(scene: fmbd.Scene, rod: Hung) -> None:
    """A motor in the hinge by a law of the user's own."""
    pin = pinned(scene, rod)
    scene.add(fmbd.joint_spring("motor", fmbd.angle(pin), law=lambda s, rate, t: 200.0 * np.sin(s) + 5.0 * rate))


def pushed(scene: fmbd.Scene, rod: Hung) -> None:
    """A force on the tip as a function of time."""
    pinned(scene, rod)
    scene.add(fmbd.force("push", rod.tip, lambda t: (0.0, 2e4 * t)))


def own(scene: fmbd.Scene, rod: Hung) -> None:
    """A constraint of the user's own: the left end stays where it is."""
    scene.add(fmbd.own_joint("own", fmbd.ground, rod.left, lambda xa, Ra, xb, Rb, t: xb - xa, center=(0, 0)))


def floor(scene: fmbd.Scene, rod: Hung, below: float) -> None:
    """A floor below the rod."""
    ground = fmbd.Obstacle("floor", fmbd.HalfSpace((0, -HEIGHT / 2 - below), (0, 1)))
    if isinstance(rod.body, fmbd.RigidBody):
        touching = fmbd.contacts.corners(rod.body, [(x, -HEIGHT / 2) for x in (-0.5, 0.5)])
    else:
        touching = rod.body.surface("side")
    scene.add(fmbd.contact("floor", touching, ground))


def contact(scene: fmbd.Scene, rod: Hung) -> None:
    """A floor 1 mm below, on which the rod sinks in a stiff hinge."""
    pin = pinned(scene, rod)
    scene.add(fmbd.joint_spring("press", fmbd.angle(pin), damping=1e4))
    floor(scene, rod, below=1e-3)


FEATURES: dict[str, Callable[[fmbd.Scene, Hung], None]] = {
    "hinge": hinge,
    "clamp": clamp,
    "field tie": field_tie,
    "drive": drive,
    "spring": spring,
    "feedback": feedback,
    "force": pushed,
    "own joint": own,
    "contact": contact,
}

SCHEMES: dict[str, Callable[[], Any]] = {
    "generalized-alpha": lambda: fmbd.GeneralizedAlpha(0.8),
    "generalized-alpha, GGL": lambda: fmbd.GeneralizedAlpha(0.8, form=fmbd.GGL()),
    "Radau, index 2": lambda: fmbd.Radau(stages=2, form=fmbd.Index2(), rtol=None),
    "Radau, GGL": lambda: fmbd.Radau(stages=3, form=fmbd.GGL(), rtol=None),
    "BDF": lambda: fmbd.BDF(order=2, rtol=None),
    "RATTLE": lambda: fmbd.Rattle(),
    "half-explicit": lambda: fmbd.HalfExplicit(rtol=None),
    "energy-momentum": lambda: fmbd.EnergyMomentum(),
    "Moreau": lambda: fmbd.Moreau(),
    "contact midpoint": lambda: fmbd.ContactMidpoint(),
    "contact alpha": lambda: fmbd.ContactAlpha(0.8),
}


# -- runs -----------------------------------------------------------------------------------------------------------
EXPLICIT = {"RATTLE": 2e-5, "half-explicit": 2e-5}  # s: a wave must not pass an element in a step
CONTACT = (
    "Moreau",
    "contact midpoint",
    "contact alpha",
)  # these want a scene with contact: a floor out of reach will do


def scene_of(body: str, feature: str, scheme: str) -> fmbd.Scene:
    """A rod that falls, held as the feature says; the sensor is its tip."""
    rod = BODIES[body]()
    scene = fmbd.Scene(f"{body}, {feature}", gravity=(0, -9.81))
    scene.add(rod.body)
    FEATURES[feature](scene, rod)
    if scheme in CONTACT and feature != "contact":
        floor(scene, rod, below=1.0)
    at = {"point": (1.0, 0.0)} if isinstance(rod.body, fmbd.RigidBody) else {}
    scene.sensor("tip", fmbd.position(rod.tip, **at))
    return scene


@cache
def reference(body: str, feature: str) -> Any:
    """The way of the tip by a scheme made for the scene at a fine step, (d,); an error where it is refused."""
    if feature != "contact":
        scheme = fmbd.GeneralizedAlpha(0.8)
    else:
        scheme = fmbd.Moreau() if body in ("rigid", "reduced") else fmbd.ContactMidpoint()
        scheme = fmbd.ContactAlpha(0.8) if body == "incompressible" else scheme
    return way(scene_of(body, feature, ""), scheme, DT / FINER)


def way(scene: fmbd.Scene, scheme: Any, dt: float) -> np.ndarray:
    """How far the tip moves, (d,) m."""
    tip = fmbd.solve(scene, t_end=T_END, dt=dt, scheme=scheme)["tip"]
    return np.asarray(tip[-1] - tip[0])


def cell(scheme: str, body: str, feature: str) -> tuple[str, str]:
    """("ok", error), ("refused", reason) or ("wrong", what was found) of one combination."""
    try:
        found = way(
            scene_of(body, feature, scheme),
            SCHEMES[scheme](),
            DT if body in ("rigid", "reduced") else EXPLICIT.get(scheme, DT),
        )
    except InputError as error:
        return ("wrong" if isinstance(error, CallbackError) else "refused"), str(error)
    except ConvergenceError as error:
        explicit = scheme in EXPLICIT and body in ("pressure", "incompressible")  # waves of pressure: some 1e-7 s
        return ("refused" if explicit else "wrong"), f"ConvergenceError: {error}"
    except Exception as error:
        return "wrong", f"{type(error).__name__}: {error}"
    try:
        exact = reference(body, feature)
    except FmbdError as error:
        return "wrong", f"no reference: {error}"
    miss = float(np.linalg.norm(found - exact) / max(np.linalg.norm(exact), 1e-4))
    allowed = AT_IMPACTS if feature == "contact" else TOLERANCE
    return ("ok" if miss <= allowed else "wrong"), f"{miss:.0e}"


PAGE = """# Combinations

Every scheme with every kind of body, hung by every kind of joint, force, tie or contact: a rod of 1 m (a mesh of 0.25 m, 5 Hz
as a cantilever) that falls for 0.04 s in 40 steps. A figure is the error of the way of its tip against a reference with a
quarter of the step; a letter is a refusal, explained below the table. Written by `tests/combinations.py`;
`tests/test_combinations.py` runs a part of the cells, and all of them with `-m slow`.
"""


def page(cells: dict[tuple[str, str, str], tuple[str, str]]) -> str:
    """The page of all cells: a table for each scheme, its refusals below."""
    text = [PAGE]
    for scheme in SCHEMES:
        reasons: list[str] = []
        text += [f"## {scheme}", "", "| body | " + " | ".join(FEATURES) + " |", "|---" * (len(FEATURES) + 1) + "|"]
        for body in BODIES:
            row = []
            for feature in FEATURES:
                verdict, found = cells[scheme, body, feature]
                if verdict == "refused" and found not in reasons:
                    reasons.append(found)
                row.append(chr(ord("a") + reasons.index(found)) if verdict == "refused" else found)
            text.append(f"| {body} | " + " | ".join(row) + " |")
        text += ["", *(f"- {chr(ord('a') + k)}: {reason}" for k, reason in enumerate(reasons)), ""]
    return "\n".join(text)


def main() -> None:
    """All cells, or those of the schemes named."""
    cells = {}
    for scheme in SCHEMES:
        if len(sys.argv) > 1 and not any(word in scheme for word in sys.argv[1:]):
            continue
        for body in BODIES:
            for feature in FEATURES:
                verdict, text = cells[scheme, body, feature] = cell(scheme, body, feature)
                print(f"{verdict:8s}{scheme:24s}{body:16s}{feature:12s}{text[:150]}", flush=True)
    if len(sys.argv) == 1:
        (ROOT / "docs/combinations.md").write_text(page(cells))


if __name__ == "__main__":
    main()
