"""Every scheme with every body, joint, force, tie and contact: small scenes, each run against a finer reference.

Run:  ./with-dolfinx python3 tests/combinations.py                    all of them (about ten minutes); writes docs/combinations.md
      ./with-dolfinx python3 tests/combinations.py Radau              the schemes with this word; prints only
      ./with-dolfinx python3 tests/combinations.py --cells FILE       keeps what is found in a file, and goes on from there
      ./with-dolfinx python3 tests/combinations.py --rest             only the cells that the page lacks or has as wrong
"""

from __future__ import annotations

import argparse
import itertools
import json
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
TABLE = ROOT / "docs/combinations.md"
DT, FINER = 1e-3, 4  # s; the reference takes steps of a quarter
T_END, UNTIL_CONTACT = 0.02, 0.04  # s; the floor is met after some 20 ms
YOUNG, DENSITY, HEIGHT = 1e8, 1000.0, 0.1  # a rod of 1 m: 5 Hz as a cantilever
TOLERANCE = 2e-2  # of the way that the reference moves; the schemes of first order need it
AT_IMPACTS = 0.15  # the same with contact: impacts are of first order, and waves of the step's size


@dataclass(frozen=True)
class Hung:
    """A body along x from the origin: what its left end and its tip are called by joints and forces."""

    body: Any
    left: Any
    tip: Any

    def at(self, x: float, y: float) -> tuple[float, ...]:
        """A point or vector of the plane, for bodies in space with a third number."""
        return (x, y) if self.body.dim == 2 else (x, y, 0.0)


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


def large_floating() -> Hung:
    """In a floating frame, large strains."""
    return elastic(fmbd.FloatingBody, energy=materials.sheet_saint_venant_kirchhoff(YOUNG, 0.3))


def beam() -> Hung:
    """A beam of elements that moves with the frame of its start."""
    law = {"youngs_modulus": YOUNG, "poisson_ratio": 0.3, "density": DENSITY}
    section = fmbd.Section.rectangle(**law, width=1.0, height=HEIGHT)
    body = fmbd.Beam("rod", (0, 0), (1, 0), section, elements=4)
    return Hung(body, body.surface("start"), body.surface("end"))


def rod() -> Hung:
    """A geometrically exact rod, in space."""
    law = {"youngs_modulus": YOUNG, "poisson_ratio": 0.3, "density": DENSITY}
    section = fmbd.RodSection.rectangle(**law, width=HEIGHT, height=1.0)
    body = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=4, degree=2, normal=(0, 1, 0))
    return Hung(body, body.surface("start"), body.surface("end"))


BODIES: dict[str, Callable[[], Hung]] = {
    "rigid": rigid,
    "floating": floating,
    "reduced": reduced,
    "absolute": absolute,
    "large strain": large,
    "pressure": with_pressure,
    "incompressible": incompressible,
    "large strain, floating": large_floating,
    "beam": beam,
    "rod": rod,
}
LIGHT = ("rigid", "reduced", "beam")  # no unknowns of a mesh


# -- what holds and moves them ------------------------------------------------------------------------------------
def pinned(scene: fmbd.Scene, rod: Hung) -> Any:
    """A hinge at the left end."""
    pin = fmbd.revolute("pin", fmbd.ground, rod.left, center=rod.at(0, 0))
    scene.add(pin)
    return pin


def hinge(scene: fmbd.Scene, rod: Hung) -> None:
    """A hinge alone."""
    pinned(scene, rod)


def clamp(scene: fmbd.Scene, rod: Hung) -> None:
    """The mean of the left end held."""
    scene.add(fmbd.fixed("clamp", fmbd.ground, rod.left, center=rod.at(0, 0)))


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
    anchor = {"point_a": rod.at(1, 0.5), "point_b": rod.at(1, 0)}
    scene.add(fmbd.Spring("spring", fmbd.ground, rod.tip, stiffness=1e4, damping=20.0, **anchor))


def bushing(scene: fmbd.Scene, rod: Hung) -> None:
    """An elastic mount in the place of a joint."""
    stiffness = np.full(3 if rod.body.dim == 2 else 6, 1e5)
    scene.add(fmbd.forces.bushing("mount", fmbd.ground, rod.left, stiffness=stiffness, center=rod.at(0, 0)))


def feedback(scene: fmbd.Scene, rod: Hung) -> None:
    """A motor in the hinge by a law of the user's own."""
    pin = pinned(scene, rod)
    scene.add(fmbd.joint_spring("motor", fmbd.angle(pin), law=lambda s, rate, t: 200.0 * np.sin(s) + 5.0 * rate))


def pushed(scene: fmbd.Scene, rod: Hung) -> None:
    """A force on the tip as a function of time."""
    pinned(scene, rod)
    scene.add(fmbd.force("push", rod.tip, lambda t: rod.at(0, 2e4 * t)))


def own_joint(scene: fmbd.Scene, rod: Hung) -> None:
    """A constraint of the user's own: the left end stays where it is."""
    law = lambda xa, Ra, xb, Rb, t: xb - xa
    scene.add(fmbd.own_joint("own", fmbd.ground, rod.left, law, center=rod.at(0, 0)))


def floor(scene: fmbd.Scene, rod: Hung, below: float, friction: float = 0.0) -> None:
    """A floor below the rod."""
    ground = fmbd.Obstacle("floor", fmbd.HalfSpace(rod.at(0, -HEIGHT / 2 - below), rod.at(0, 1)))
    if isinstance(rod.body, fmbd.RigidBody):
        touching = fmbd.contacts.corners(rod.body, [(x, -HEIGHT / 2) for x in (-0.5, 0.5)])
    elif isinstance(rod.body, fmbd.Rod):
        touching = fmbd.contacts.along(rod.body, radius=HEIGHT / 2)
    elif isinstance(rod.body, fmbd.Beam):
        touching = rod.tip
    else:
        touching = rod.body.surface("side")
    scene.add(fmbd.contact("floor", touching, ground, friction=friction))


def contact(scene: fmbd.Scene, rod: Hung, friction: float = 0.0) -> None:
    """A floor 1 mm below, on which the rod sinks in a stiff hinge."""
    pin = pinned(scene, rod)
    scene.add(fmbd.joint_spring("press", fmbd.angle(pin), damping=1e4))
    floor(scene, rod, 1e-3, friction)


def rubbing(scene: fmbd.Scene, rod: Hung) -> None:
    """The same floor, rough."""
    contact(scene, rod, friction=0.3)


FEATURES: dict[str, Callable[[fmbd.Scene, Hung], None]] = {
    "hinge": hinge,
    "clamp": clamp,
    "field tie": field_tie,
    "drive": drive,
    "spring": spring,
    "bushing": bushing,
    "feedback": feedback,
    "force": pushed,
    "own joint": own_joint,
    "contact": contact,
    "friction": rubbing,
}
TOUCHING = ("contact", "friction")

SCHEMES: dict[str, Callable[[], Any]] = {
    "generalized-alpha": lambda: fmbd.GeneralizedAlpha(0.8),
    "generalized-alpha, GGL": lambda: fmbd.GeneralizedAlpha(0.8, form=fmbd.GGL()),
    "generalized-alpha, steps chosen": lambda: fmbd.GeneralizedAlpha(0.8, rtol=1e-5),
    "Radau, index 2": lambda: fmbd.Radau(stages=2, form=fmbd.Index2(), rtol=None),
    "Radau, GGL": lambda: fmbd.Radau(stages=3, form=fmbd.GGL(), rtol=None),
    "BDF": lambda: fmbd.BDF(order=2, rtol=None),
    "RATTLE": lambda: fmbd.Rattle(),
    "half-explicit": lambda: fmbd.HalfExplicit(rtol=None),
    "energy-momentum": lambda: fmbd.EnergyMomentum(),
    "Moreau": lambda: fmbd.Moreau(),
    "contact midpoint": lambda: fmbd.ContactMidpoint(),
    "contact alpha": lambda: fmbd.ContactAlpha(0.8),
    "generalized-alpha, FieldSplit": lambda: fmbd.GeneralizedAlpha(0.8),
    "contact alpha, FieldSplit": lambda: fmbd.ContactAlpha(0.8),
}


# -- runs -----------------------------------------------------------------------------------------------------------
EXPLICIT = {"RATTLE": 2e-5, "half-explicit": 2e-5}  # s: a wave must not pass an element in a step
EXPLICIT_END = 0.005  # s, of those
CONTACT = ("Moreau", "contact")  # these want a scene with contact: a floor out of reach will do


def linear_of(scheme: str) -> Any:
    """How the steps' matrices are solved; None: directly."""
    return fmbd.solvers.FieldSplit(method="fgmres", rtol=1e-10) if "FieldSplit" in scheme else None


def scene_of(body: str, feature: str, scheme: str) -> fmbd.Scene:
    """A rod that falls, held as the feature says; the sensor is its tip."""
    rod = BODIES[body]()
    scene = fmbd.Scene(f"{body}, {feature}", gravity=rod.at(0, -9.81))
    scene.add(rod.body)
    FEATURES[feature](scene, rod)
    if scheme.startswith(CONTACT) and feature not in TOUCHING:
        floor(scene, rod, below=1.0)
    at = {"point": (1.0, 0.0)} if isinstance(rod.body, fmbd.RigidBody) else {}
    scene.sensor("tip", fmbd.position(rod.tip, **at))
    return scene


@cache
def reference(body: str, feature: str) -> fmbd.Run:
    """By a scheme made for the scene at a fine step; an error where it is refused."""
    scheme: Any = fmbd.GeneralizedAlpha(0.8)
    if feature in TOUCHING:
        impulses = body in (*LIGHT, "rod")
        scheme = fmbd.Moreau() if impulses else fmbd.ContactMidpoint()
        scheme = fmbd.ContactAlpha(0.8) if body == "incompressible" else scheme
    return fmbd.solve(scene_of(body, feature, ""), t_end=end_of(feature), dt=DT / FINER, scheme=scheme)


def end_of(feature: str) -> float:
    """End of the runs, s."""
    return UNTIL_CONTACT if feature in TOUCHING else T_END


def run(scheme: str, body: str, feature: str) -> fmbd.Run:
    """The run of one combination."""
    explicit = scheme in EXPLICIT and body not in ("rigid", "reduced")
    chosen = "steps chosen" in scheme
    return fmbd.solve(
        scene_of(body, feature, scheme),
        t_end=EXPLICIT_END if explicit else end_of(feature),
        dt=None if chosen else EXPLICIT[scheme] if explicit else DT,
        scheme=SCHEMES[scheme](),
        linear=linear_of(scheme),
    )


def cell(scheme: str, body: str, feature: str) -> tuple[str, str]:
    """("ok", error), ("refused", reason) or ("wrong", what was found) of one combination."""
    try:
        found = run(scheme, body, feature)
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
    miss = error_of(found, exact)
    allowed = AT_IMPACTS if feature in TOUCHING else TOLERANCE
    return ("ok" if miss <= allowed else "wrong"), f"{miss:.0e}"


def error_of(found: fmbd.Run, exact: fmbd.Run) -> float:
    """Error of the way of the tip, as a share of the reference's at the same time, and of 0.1 mm at least."""
    k = int(np.argmin(np.abs(exact.times - found.times[-1])))
    way, right = found["tip"][-1] - found["tip"][0], exact["tip"][k] - exact["tip"][0]
    return float(np.linalg.norm(way - right) / max(np.linalg.norm(right), 1e-4))


OPEN = "·"  # of a cell that was not run
PAGE = """# Combinations

Every scheme with every kind of body, hung by every kind of joint, force, tie or contact: a rod of 1 m (a mesh of 0.25 m, 5 Hz
as a cantilever) that falls for 20 ms in 20 steps, with contact for 40 ms in 40. A figure is the error of the way of its tip
against a reference with a quarter of the step, as a share of the way; of RATTLE and half-explicit with unknowns of a mesh, after
5 ms in 250 steps. A letter is a refusal, explained below the table. Contact schemes have a floor out of reach where the column is
not of contact. "FieldSplit" is the scheme with `linear=fmbd.solvers.FieldSplit(method="fgmres", rtol=1e-10)`.

Written by `tests/combinations.py`; `tests/test_combinations.py` runs a sample of the cells and all refusals, and all cells with
`-m slow`. A figure may be 0.02, with contact 0.15: impacts are of first order, and send waves of the step's length.
"""


def page(cells: dict[str, tuple[str, str]]) -> str:
    """The page of all cells: a table for each scheme, its refusals below."""
    names = [key(*c) for c in itertools.product(SCHEMES, BODIES, FEATURES)]
    verdicts = [cells[n][0] if n in cells else OPEN for n in names]
    text = [PAGE, f"Of {len(names)} cells {verdicts.count('ok')} run right, {verdicts.count('refused')} are refused."]
    if "wrong" in verdicts:
        text[-1] += f" {verdicts.count('wrong')} are wrong: letters in bold, what was found below the table."
    if OPEN in verdicts:
        text[-1] += f" {verdicts.count(OPEN)} cells, with {OPEN}, have not been run for this page."
    text.append("")

    for scheme in SCHEMES:
        reasons: list[str] = []
        text += [f"## {scheme}", "", "| body | " + " | ".join(FEATURES) + " |", "|---" * (len(FEATURES) + 1) + "|"]
        for body in BODIES:
            found = [cells.get(key(scheme, body, feature), ("ok", OPEN)) for feature in FEATURES]
            row = [written(*each, reasons) for each in found]
            text.append(f"| {body} | " + " | ".join(row) + " |")
        text += ["", *(f"- {chr(ord('a') + k)}: {reason}" for k, reason in enumerate(reasons)), ""]
    return "\n".join(text).rstrip() + "\n"


def key(scheme: str, body: str, feature: str) -> str:
    """Name of a cell."""
    return f"{scheme} / {body} / {feature}"


def written(verdict: str, found: str, reasons: list[str]) -> str:
    """A cell of a table; new refusals are added to the reasons."""
    if verdict == "ok":
        return found
    if found not in reasons:
        reasons.append(found)
    letter = chr(ord("a") + reasons.index(found))
    return letter if verdict == "refused" else f"**{letter}**"


def on_page(text: str) -> dict[tuple[str, str, str], tuple[str, str]]:
    """The cells of a page, back from its tables: (verdict, found) by scheme, body and feature, without those not run."""
    cells = {}
    for section in text.split("\n## ")[1:]:
        scheme, *lines = section.splitlines()
        reasons = dict(line[2:].split(": ", 1) for line in lines if line.startswith("- "))
        rows = [[x.strip() for x in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
        for body, *row in rows[1:]:
            for feature, found in zip(rows[0][1:], row, strict=True):
                if found in reasons:
                    cells[scheme, body, feature] = "refused", reasons[found]
                elif found != OPEN:
                    cells[scheme, body, feature] = ("wrong", "") if found.startswith("**") else ("ok", found)
    return cells


def main() -> None:
    """All cells, or those of the schemes named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*")
    parser.add_argument("--cells", type=Path)
    parser.add_argument("--rest", action="store_true")
    wanted = parser.parse_args()

    kept = wanted.cells is not None and wanted.cells.exists()
    cells = json.loads(wanted.cells.read_text()) if kept else {}
    if wanted.rest:
        cells |= {key(*name): found for name, found in on_page(TABLE.read_text()).items() if found[0] != "wrong"}
    for scheme in SCHEMES:
        if wanted.words and not any(word in scheme for word in wanted.words):
            continue
        for body in BODIES:
            for feature in FEATURES:
                name = key(scheme, body, feature)
                if name not in cells:
                    verdict, text = cells[name] = cell(scheme, body, feature)
                    print(f"{verdict:8s}{name:70s}{text[:150]}", flush=True)
            if wanted.cells is not None:
                wanted.cells.write_text(json.dumps(cells, indent=0))
    if not wanted.words:
        TABLE.write_text(page(cells))


if __name__ == "__main__":
    main()
