"""Elastic ring: it spins, flies and vibrates, with steps far longer than its vibrations; three schemes, one check: energy.

Run:  ./with-dolfinx python3 demos/elastic_ring.py            (--fast; --picture ring.png)

A soft ring of radius 1 m turns at 1 rad/s. The energy-momentum scheme keeps energy and momenta for every step; schemes that
are stable for linear problems gain or lose energy once the step turns the body far (h = 0.5 s is 29 degrees).
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot

STEPS = ((1e4, 0.05), (1e4, 0.2), (1e4, 0.5), (1e6, 0.1), (1e6, 0.5))  # Young's modulus (Pa), step (s)
MATERIALS = (fmbd.materials.saint_venant_kirchhoff, fmbd.materials.neo_hookean)
FRESH = fmbd.Newton(patience=0.0, max_iterations=40)  # a tangent of its own for each iteration

args = demo.arguments(__doc__)
mesh = fmbd.read_gmsh("meshes/ring.py", h=0.3 if args.fast else 0.2)
t_end = 2.0 if args.fast else 200.0


def fly(energy, h, t_end, scheme, newton=None, snapshots=0):
    """A free ring with a rigid motion and an oval vibration."""
    ring = fmbd.AbsoluteBody(
        "ring", mesh, density=1.0, energy=energy, quadrature=4, velocity=(0.2, 0.1), angular_velocity=1.0,
        displacement_rate=lambda X: 0.1 * np.array([X[0], -X[1]]),
    )  # fmt: skip
    scene = fmbd.Scene("elastic ring")
    scene.add(ring)
    output = fmbd.Output(estimate_error=False, snapshots=snapshots)
    return fmbd.solve(scene, t_end=t_end, dt=h, scheme=scheme, newton=newton, output=output)


def gain(run):
    """Largest change of energy over the energy at the start."""
    return np.abs(run.total_energy / run.total_energy[0] - 1).max()


checks = []
for material in MATERIALS:
    for modulus, h in STEPS:
        run = fly(material(modulus, 0.3), h, t_end, fmbd.EnergyMomentum())
        checks.append(demo.Check(f"{material.__name__}, E = {modulus:g}, h = {h:g}: energy", gain(run), 0.0, 1e-9))

soft, curves = fmbd.materials.neo_hookean(1e4, 0.3), {}
for scheme in (fmbd.EnergyMomentum(), fmbd.GeneralizedAlpha(0.9), fmbd.GeneralizedAlpha(0.5)):
    try:
        curves[scheme.name] = fly(soft, 0.05, min(t_end, 20.0), scheme, FRESH, 6)
        demo.say(f"{scheme.name}, h = 0.05 s: energy changes by {gain(curves[scheme.name]):.1e} of itself")
    except fmbd.errors.ConvergenceError as error:
        demo.say(f"{scheme.name}, h = 0.05 s: {error}")
if args.picture:
    with plot.figure(args.picture, 1, 2, title=args.title) as (left, right):
        plot.shapes(left, curves["energy-momentum"])
        for name, other in curves.items():
            right.plot(other.times, other.total_energy, label=name)
        right.set(xlabel="time (s)", ylabel="energy (J)")
if args.animate:
    demo.film(fly(soft, 0.05, 5.0, fmbd.EnergyMomentum(), FRESH, 100), args)
demo.finish(checks, run, args)
