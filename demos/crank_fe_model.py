"""The slider crank of demos/crank_model.py with a connecting rod of finite elements, and the beam beside it.

Crank and slider are rigid with the masses of the test set; the rod is a sheet in plane stress or a solid with a bore at each end.
Revolute joints hold the bores, surfaces with their own mean position and rotation; the slider moves on a guide. The crank runs up
smoothly from rest to OMEGA within two turns, so that both models follow the smooth motion without an initial oscillation.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import crank_model as model
import numpy as np

import fmbd_fenicsx as fmbd

ROD = Path(__file__).resolve().parents[1] / "meshes/bored_rod.py"
TURN = 2 * np.pi / model.OMEGA  # s, of the running crank
RAMP, END = 2 * TURN, 3 * TURN  # the crank stands at a whole turn at both
BORES = ("bore a", "bore b")


def run_up(t: float) -> tuple[float, float, float]:
    """Crank angle and its rates: four continuous derivatives, one turn until RAMP."""
    if np.real(t) >= RAMP:
        return model.OMEGA * (t - 0.5 * RAMP), model.OMEGA, 0.0
    s, w = t / RAMP, model.OMEGA
    angle = w * RAMP * s**5 * (7 - 14 * s + 10 * s**2 - 2.5 * s**3)
    rate = w * s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
    return angle, rate, w / RAMP * s**3 * (140 - 420 * s + 420 * s**2 - 140 * s**3)


def beam(height: float, dt: float) -> fmbd.Run:
    """The crank with two sine modes of a rod of the given height; sensor "q" of its seven coordinates."""
    scene = fmbd.Scene("slider crank, beam")
    start = np.zeros(14)
    start[2] = model.L1 + model.L2
    crank = model.crank(model.Rod(height=height, consistent_mass=True), start, run_up)
    scene.add(crank)
    scene.sensor("q", fmbd.coordinates(crank))
    return fmbd.solve(scene, t_end=END, dt=dt, output=fmbd.Output(energy=False))


def rod(height: float, h: float, dim: int = 2, E: float = model.E) -> fmbd.FloatingBody:
    """The connecting rod with cells of size h; its frame follows the chord from bore to bore, as the beam's."""
    mesh = fmbd.read_gmsh(ROD, dim=dim, first=(model.L1, 0.0), length=model.L2, height=height, thickness=model.B, h=h)
    if dim == 2:
        density, elastic = model.RHO * model.B, fmbd.materials.plane_stress(E * model.B, model.NU)
    else:
        density, elastic = model.RHO, fmbd.materials.linear_elastic(E, model.NU)
    return fmbd.FloatingBody("rod", mesh, density=density, elastic=elastic, frame=fmbd.Chord(*BORES))


def reduced(body: fmbd.FloatingBody, modes: int) -> Any:
    """The rod by the static modes of its bores and ``modes`` more."""
    return body.reduced(basis=fmbd.CraigBampton(BORES, modes))


def scene(body: Any, motion: Any = run_up) -> fmbd.Scene:
    """Crank with its motion, rod (full or reduced) and slider; sensors: bores, the straight edges' mean position, slider, bearing
    force.
    """

    def at(x: float) -> tuple[float, ...]:
        return (x, 0.0, 0.0)[: body.dim]

    def inertia(J: float) -> Any:
        return J if body.dim == 2 else (J, J, J)  # only the third counts in this plane motion

    made = fmbd.Scene("slider crank, finite elements")
    crank = fmbd.RigidBody("crank", model.M1, inertia(model.J1 - model.M1 * model.L1**2 / 4), at(model.L1 / 2))
    slider = fmbd.RigidBody("slider", model.M3, inertia(1e-5), at(model.L1 + model.L2))
    main = fmbd.revolute("main bearing", fmbd.ground, crank, center=at(0.0))
    knee = fmbd.revolute("knee", crank, body.surface("bore a"), center=at(model.L1))
    wrist = fmbd.revolute("wrist", body.surface("bore b"), slider, center=at(model.L1 + model.L2))
    guide = fmbd.prismatic("guide", fmbd.ground, slider, axis=(1, 0, 0)[: body.dim], center=slider.position)
    made.add(crank, body, slider, main, knee, wrist, guide, fmbd.drive("drive", fmbd.angle(main), motion))
    for name in (*BORES, "side"):
        made.sensor(name, fmbd.position(body.surface(name)))
    made.sensor("slider", fmbd.position(slider))
    made.sensor("knee force", fmbd.reaction_force(knee))
    return made


def drive(body: Any, dt: float, snapshots: int = 0) -> fmbd.Run:
    """Three turns of the crank."""
    return fmbd.solve(scene(body), t_end=END, dt=dt, output=fmbd.Output(energy=False, snapshots=snapshots))


def deflection(run: fmbd.Run) -> np.ndarray:
    """Mean deflection of the rod's edges from the chord between the bores over the last turn, m; of the beam: 2 q1 / pi."""
    last = run.times >= RAMP
    if "q" in run.series:
        return 2 / np.pi * run["q"][last, 3]
    a, b, side = (run[name][last, :2] for name in (*BORES, "side"))
    e, d = b - a, side - 0.5 * (a + b)
    return (e[:, 0] * d[:, 1] - e[:, 1] * d[:, 0]) / np.linalg.norm(e, axis=1)


def difference(run: fmbd.Run, other: fmbd.Run) -> float:
    """By how much the first deflection is larger than the other, in the least-squares sense, relative."""
    w, v = deflection(run), deflection(other)
    return float(w @ v / (v @ v) - 1)


def expected_difference(slenderness: float) -> float:
    """What beam theory leaves out with two sine modes, for s = height / length, under a load that is linear along the rod.

    The third sine mode, 1 / 3^6; shear, 10 EI / (kappa G A L^2) = 2 (1 + nu) s^2 for kappa = 5/6; the mass of the rounded ends
    beyond the bores, whose moment rho b h^3 / 12 per acceleration bends the rod back, -(5/6) s^2; and shear where the bores halve
    the section, over h / 4 at each end, 3 (1 + nu) s^3.
    """
    s, shear = slenderness, 2 * (1 + model.NU)
    return 3.0**-6 + (shear - 5 / 6) * s**2 + 1.5 * shear * s**3
