r"""Campbell's diagrams: a turning blade, a shaft with a disc, a spinning top, a free disc; forward and backward whirl apart.

Run:  ./with-dolfinx python3 demos/campbell.py --picture campbell.png

      |=========   blade on a hub that turns with mu sqrt(EI / rho A L^4): stiffened by centrifugal force, flapwise
    __|_________    reference of Euler and Bernoulli's beam for mu = 2 ... 50
                   shaft: tube of 6 m, disc of 70 kg, ends held against tilting; critical speed 56.853 rad/s
      \ | /        top, upright: A w^2 - C s w + m g l = 0 for precession and nutation
       \|/         disc, free: breathes and twists as Bessel's functions with Coriolis and centrifugal terms say
"""

import numpy as np
from campbell_model import FLAPWISE, MU, UNIT, blade, disc, picture, shaft, symmetric, top

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check


def main():
    """Blade to 1 % up to mu = 50, shaft to 0.1 %, top to 1e-6, disc to what a rim of 50 edges and static stretch leave."""
    args = demo.arguments(__doc__)
    n = 6 if args.fast else 12
    speeds_of_blade, known_of_blade = (x[:: 5 if args.fast else 1] for x in (MU, FLAPWISE))
    blades = fmbd.campbell(lambda _: blade(n), speeds_of_blade * UNIT, 2)
    flap = blades.omega[:, 1] / UNIT  # the first is chordwise

    about = fmbd.Spin(0.0, axis=(1.0, 0.0, 0.0))
    speeds = np.array([0.0, 30.0, 55.0, 60.0, 80.0])
    turned = fmbd.campbell(lambda _: shaft(4 if args.fast else 8), speeds, 2, spin=about)

    scene, exact = top(60.0)
    found = np.sort(fmbd.modes(scene, 4).omega)[-2:]

    plates = (0.2,) if args.fast else (0.1, 0.2, 0.3)
    every = fmbd.campbell(lambda _: disc(0.125), plates, 16).omega
    bessel = np.array([symmetric(w) for w in plates])
    nearest = np.array([[w[np.abs(w - x).argmin()] for x in row] for w, row in zip(every, bessel, strict=True)])
    checks = [
        *(
            Check.relative(f"flapwise at mu = {m:g}", w, r, 1e-2)
            for m, w, r in zip(speeds_of_blade, flap, known_of_blade, strict=True)
        ),
        Check("critical speeds of the shaft", len(turned.critical_speeds), 1),
        Check.relative("critical speed (rad/s)", turned.critical_speeds[0], 56.853, 1e-3),
        Check.relative("backward whirl at 30 rad/s (rad/s)", turned.fixed[1].min(), -56.853, 1e-3),
        *(
            Check.relative(f"{name} of the {body} (rad/s)", w, r, tolerance)
            for names, body, values, known, tolerance in (
                (("precession", "nutation"), "top", found, exact, 1e-6),
                (("breathing", "twisting"), "disc", nearest[-1], bessel[-1], 2e-3),
            )
            for name, w, r in zip(names, values, known, strict=True)
        ),
    ]
    if args.picture:
        picture(args, blades, speeds, turned, plates, nearest)
    demo.finish(checks, None, args)


if __name__ == "__main__":
    main()
