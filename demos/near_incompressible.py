"""Bushing: a rubber ring, bonded point by point between a fixed tube and a pin that shakes; displacement forms lock,
displacement and pressure do not.

Run:  ./with-dolfinx python3 demos/near_incompressible.py            (--fast; --picture bushing.png)

The stiffness of the bushing, force over displacement of the pin, is compared on several meshes for nu = 0.49 and nu = 0.5.
P1 displacements lock near nu = 1/2. The mixed element does not: what changes with the mesh is the ring itself, a polygon that
differs from the circle by O(h^2); the stiffness converges with that order, and the limit h -> 0 is extrapolated with it.
"""

from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo

RING = Path(__file__).resolve().parents[1] / "meshes/ring.py"
E, RHO = 5e6, 1100.0  # Pa, kg/m^3
STROKE, T = 1e-4, 0.05  # m, s: so slow that inertia does not count


def push(t):
    """Displacement of the pin, its rate and acceleration: a smooth stroke."""
    s = min(t / T, 1.0)
    return (
        STROKE * s**3 * (10 - 15 * s + 6 * s**2),
        STROKE / T * 30 * s**2 * (1 - s) ** 2,
        STROKE / T**2 * 60 * s * (1 - s) * (1 - 2 * s),
    )


def stiffness(h, elastic, degree):
    """Force on the pin over its displacement, N/m, and the run."""
    mesh = fmbd.read_gmsh(RING, radius=0.03, width=0.02, h=h)
    rubber = fmbd.FloatingBody("rubber", mesh, density=RHO, elastic=elastic, degree=degree, stiffness_damping=2e-3)
    pin = fmbd.RigidBody("pin", mass=1.0, inertia=1e-3, position=(0.0, 0.0))
    scene = fmbd.Scene("bushing")
    scene.add(rubber, pin, fmbd.tie_surface("tube", rubber.surface("outer"), fmbd.ground))
    scene.add(fmbd.tie_surface("bond", rubber.surface("inner"), pin))
    scene.add(fmbd.prismatic("guide", fmbd.ground, pin, axis=(1, 0, 0), center=(0, 0)))
    scene.add(fmbd.drive_translation("shaker", fmbd.ground, pin, push, axis=(1, 0, 0), center=(0, 0)))
    scene.sensor("force", fmbd.reaction("shaker"))
    run = fmbd.solve(
        scene,
        t_end=2 * T,
        dt=T / 25,
        scheme=fmbd.GeneralizedAlpha(0.5),
        output=fmbd.Output(estimate_error=False),
    )
    return abs(float(run["force"][-1, 0])) / STROKE, run


def main():
    args = demo.arguments(__doc__)
    sizes = (0.01, 0.005) if args.fast else (0.01, 0.005, 0.0025)
    forms, found = fmbd.materials, {}
    cases = {
        "mixed, nu = 0.3": (forms.nearly_incompressible(E, 0.3), 2),
        "P2, nu = 0.3": (forms.linear_elastic(E, 0.3), 2),
        "P1, nu = 0.4999": (forms.linear_elastic(E, 0.4999), 1),
        "mixed, nu = 0.4999": (forms.nearly_incompressible(E, 0.4999), 2),
        "mixed, nu = 0.5": (forms.nearly_incompressible(E, 0.5), 2),
    }
    for name, (elastic, degree) in cases.items():
        results = [stiffness(h, elastic, degree) for h in sizes]
        found[name] = np.array([k for k, _ in results])
        demo.say(f"{name:<20}" + "  ".join(f"h = {h:g}: {k:.5g} N/m" for h, k in zip(sizes, found[name], strict=True)))
    mixed, nearly = found["mixed, nu = 0.5"], found["mixed, nu = 0.4999"]
    limit = mixed[-1] + (mixed[-1] - mixed[-2]) / 3  # second order: the error falls to a quarter
    softer = 1 - nearly / mixed  # by the compressibility that nu = 0.4999 leaves: physics, the same on every mesh
    locked = float(found["P1, nu = 0.4999"][0] / limit)
    checks = [
        demo.Check.relative(
            "mixed and displacement at nu = 0.3", found["mixed, nu = 0.3"][-1], found["P2, nu = 0.3"][-1], 1e-4
        ),
        demo.Check.relative("finest mesh against the limit, nu = 0.5", mixed[-1], limit, 1.5e-2 if args.fast else 5e-3),
        demo.Check("softer by nu = 0.4999, finest and coarsest mesh", softer[-1], softer[0], 5e-4),
        demo.Check("P1 is more than ten times too stiff", float(locked > 10), 1.0, 0.0),
    ]
    if not args.fast:
        order = np.log2((mixed[1] - mixed[0]) / (mixed[2] - mixed[1]))
        checks.append(demo.Check("order in h, nu = 0.5", float(order), 2.0, 0.2))
    if args.picture:
        from fmbd_fenicsx.faces.plot import plot_curves

        curves = {k: (np.array(sizes), v) for k, v in found.items()}
        plot_curves(curves, args.picture, ("cell size (m)", "stiffness (N/m)"), log=True)
    demo.finish(checks, results[-1][1], args)


if __name__ == "__main__":
    main()
