"""Bushing: a rubber ring between a fixed tube and a pin that shakes; displacement forms lock, mixed ones do not.

Run:  ./with-dolfinx python3 demos/near_incompressible.py            (--fast; --picture bushing.png)

The stiffness of the bushing, force over displacement of the pin, is compared on several meshes for nu = 0.49 and nu = 0.5.
P1 displacements lock near nu = 1/2. The mixed element does not: what changes with the mesh is the ring itself, a polygon that
differs from the circle by O(h^2); the stiffness converges with that order, and the limit h -> 0 is extrapolated with it.
"""

import numpy as np
from ufl import grad, sqrt, sym

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import Check, demo, plot
from fmbd_fenicsx.materials import linear_elastic, nearly_incompressible

E, RHO, STROKE, T = 5e6, 1100.0, 1e-4, 0.05  # Pa, kg/m^3, m, s: so slow that inertia does not count
CASES = {  # form, degree of the displacements
    "mixed, nu = 0.3": (nearly_incompressible(E, 0.3), 2),
    "P2, nu = 0.3": (linear_elastic(E, 0.3), 2),
    "P1, nu = 0.4999": (linear_elastic(E, 0.4999), 1),
    "mixed, nu = 0.4999": (nearly_incompressible(E, 0.4999), 2),
    "mixed, nu = 0.5": (nearly_incompressible(E, 0.5), 2),
}


def push(t):
    """Displacement of the pin, its rate and acceleration: a smooth stroke."""
    s = min(t / T, 1.0)
    rates = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)
    return tuple(STROKE * rate / T**k for k, rate in enumerate(rates))


def shake(h, elastic, degree):
    """The run, and the force on the pin over its displacement, N/m."""
    mesh = fmbd.read_gmsh("meshes/ring.py", radius=0.03, width=0.02, h=h)
    rubber = fmbd.FloatingBody("rubber", mesh, density=RHO, elastic=elastic, degree=degree, stiffness_damping=2e-3)
    pin = fmbd.RigidBody("pin", mass=1.0, inertia=1e-3, position=(0.0, 0.0))
    scene = fmbd.Scene("bushing")
    scene.add(rubber, pin, fmbd.tie_surface("tube", rubber.surface("outer"), fmbd.ground))
    scene.add(fmbd.tie_surface("bond", rubber.surface("inner"), pin))
    scene.add(fmbd.prismatic("guide", fmbd.ground, pin, axis=(1, 0, 0), center=(0, 0)))
    scene.add(fmbd.drive_translation("shaker", fmbd.ground, pin, push, axis=(1, 0, 0), center=(0, 0)))
    scene.sensor("force", fmbd.reaction("shaker"))
    output = fmbd.Output(estimate_error=False, snapshots=2)
    run = fmbd.solve(scene, t_end=2 * T, dt=T / STEPS, scheme=fmbd.GeneralizedAlpha(0.5), output=output)
    return run, abs(run["force"][-1, 0]) / STROKE


args = demo.arguments(__doc__)
STEPS = 10 if args.fast else 25  # of a stroke
sizes = (0.01, 0.005) if args.fast else (0.01, 0.005, 0.0025)
found = {}
for name, case in CASES.items():
    runs, found[name] = zip(*(shake(h, *case) for h in sizes), strict=True)
    found[name] = np.array(found[name])
    demo.say(f"{name:<20}" + "  ".join(f"h = {h:g}: {k:.5g} N/m" for h, k in zip(sizes, found[name], strict=True)))
mixed, nearly = found["mixed, nu = 0.5"], found["mixed, nu = 0.4999"]
limit = mixed[-1] + (mixed[-1] - mixed[-2]) / 3  # second order: the error falls to a quarter
softer = 1 - nearly / mixed  # by the compressibility that nu = 0.4999 leaves: physics, the same on every mesh
first, second = found["mixed, nu = 0.3"][-1], found["P2, nu = 0.3"][-1]
checks = [
    Check.relative("mixed and displacement at nu = 0.3", first, second, 1e-4),
    Check.relative("finest mesh against the limit, nu = 0.5", mixed[-1], limit, 1.5e-2 if args.fast else 5e-3),
    Check("softer by nu = 0.4999, finest and coarsest mesh", softer[-1], softer[0], 5e-4),
    Check.at_least("P1 is too stiff by a factor of", found["P1, nu = 0.4999"][0] / limit, 10),
]
if not args.fast:
    checks.append(Check("order in h, nu = 0.5", np.log2((mixed[1] - mixed[0]) / (mixed[2] - mixed[1])), 2.0, 0.2))
if args.picture:
    with plot.figure(args.picture, 1, 2, title=args.title) as (left, right):
        strain = lambda u: sym(grad(u))
        shear = lambda u: 100 * sqrt((strain(u)[0, 0] - strain(u)[1, 1]) ** 2 + 4 * strain(u)[0, 1] ** 2)
        plot.shapes(left, runs[-1], paint=(runs[-1].scene.bodies["rubber"], shear, "largest shear (%)"))
        right.axhline(1e-6 * limit, **plot.REFERENCE, label="limit, nu = 0.5")
        for (name, stiffness), mark in zip(found.items(), "s.^od", strict=True):
            right.semilogy(1e3 * np.array(sizes), 1e-6 * stiffness, f"{mark}-", mfc="none", label=name)
        right.set(xlabel="cell size (mm)", ylabel="stiffness (kN/mm)", xlim=(0, None))
demo.finish(checks, runs[-1], args)
