"""Elastic ring: it spins, flies and vibrates, with steps far longer than its vibrations; three schemes, one check: energy.

Run:  ./with-dolfinx python3 demos/elastic_ring.py            (--fast; --picture ring.png)

A soft ring of radius 1 m turns at 1 rad/s. The energy-momentum scheme keeps energy and momenta for every step; schemes that
are stable for linear problems gain or lose energy once the step turns the body far (h = 0.5 s is 29 degrees).
"""

from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo

RING = Path(__file__).resolve().parents[1] / "meshes/ring.py"
STEPS = ((1e4, 0.05), (1e4, 0.2), (1e4, 0.5), (1e6, 0.1), (1e6, 0.5))  # Young's modulus (Pa), step (s)


def scene_of(mesh, modulus, material):
    """A free ring with a rigid motion and an oval vibration."""
    ring = fmbd.AbsoluteBody(
        "ring", mesh, density=1.0, energy=material(modulus, 0.3), quadrature=4, velocity=(0.2, 0.1), angular_velocity=1.0,
        displacement_rate=lambda X: 0.1 * np.array([X[0], -X[1]]),
    )  # fmt: skip
    scene = fmbd.Scene("elastic ring")
    scene.add(ring)
    return scene


def gain(run):
    """Largest change of energy over the energy at the start."""
    energy = run.total_energy
    return float(np.abs(energy / energy[0] - 1).max())


def main():
    args = demo.arguments(__doc__)
    mesh = fmbd.read_gmsh(RING, h=0.3 if args.fast else 0.2)
    quiet, fresh = fmbd.Output(estimate_error=False), fmbd.Newton(patience=0.0, max_iterations=40)
    t_end, checks, curves = (5.0 if args.fast else 200.0), [], {}
    for material in (fmbd.materials.saint_venant_kirchhoff, fmbd.materials.neo_hookean):
        for modulus, h in STEPS:
            scene = scene_of(mesh, modulus, material)
            run = fmbd.solve(scene, t_end=t_end, dt=h, scheme=fmbd.EnergyMomentum(), output=quiet)
            checks.append(demo.Check(f"{material.__name__}, E = {modulus:g}, h = {h:g}: energy", gain(run), 0.0, 1e-9))
    scene = scene_of(mesh, 1e4, fmbd.materials.neo_hookean)
    for scheme in (fmbd.EnergyMomentum(), fmbd.GeneralizedAlpha(0.9), fmbd.GeneralizedAlpha(0.5)):
        try:
            other = fmbd.solve(scene, t_end=min(t_end, 20.0), dt=0.05, scheme=scheme, newton=fresh, output=quiet)
        except fmbd.errors.ConvergenceError as error:
            demo.say(f"{scheme.name}, h = 0.05 s: {error}")
            continue
        curves[scheme.name] = other.times, sum(other.energy.values())
        demo.say(f"{scheme.name}, h = 0.05 s: energy changes by {gain(other):.1e} of itself")
    if args.picture:
        from fmbd_fenicsx.faces.plot import plot_curves

        plot_curves(curves, args.picture, ("time (s)", "energy (J)"))
    demo.finish(checks, run, args)


if __name__ == "__main__":
    main()
