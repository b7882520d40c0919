"""Flying beam: a free flexible beam is thrown by a force and a couple at its end, and tumbles freely; two floating frames.

Run:  ./with-dolfinx python3 demos/flying_beam.py            (--fast; --picture flying_beam.png)

   (couple, force until t = 2.5 s)  start o==================== end     10 m, at atan(4/3) to the ground

The loads are those of the flying spaghetti (Simo and Vu-Quoc, doi:10.1115/1.3171871) on a beam twenty times stiffer, so that the
strains stay small enough for linear elasticity in a floating frame. Momenta must follow the impulse exactly, in any frame.
"""

from math import atan2, cos, sin

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo

L, RHO_A, RHO_I = 10.0, 1.0, 0.1  # m, kg/m, kg m
ANGLE, END = atan2(4.0, 3.0), 2.5  # rad, s


def envelope(t):
    """1 for a while, smoothly from and to 0."""
    return sin(np.pi * t / END) ** 2 if t < END else 0.0


def fly(attached, modes, dt, t_end, elements=20):
    """The run; sensors of both ends."""
    section = fmbd.Section(EA=2e5, EI=2e3, rhoA=RHO_A, rhoI=RHO_I)
    end = (L * cos(ANGLE), -L * sin(ANGLE))
    beam = fmbd.Beam("beam", (0.0, 0.0), end, section, elements=elements, modes=modes, attached=attached)
    scene = fmbd.Scene("flying beam")
    scene.add(beam)
    scene.add(fmbd.force("throw", beam.surface("end"), lambda t: (8.0 * envelope(t), 0.0)))
    scene.add(fmbd.torque("couple", beam.surface("end"), lambda t: -80.0 * envelope(t)))
    for name in ("start", "end"):
        scene.sensor(name, fmbd.position(beam.surface(name)))
    return fmbd.solve(
        scene, t_end=t_end, dt=dt, scheme=fmbd.GeneralizedAlpha(0.9), output=fmbd.Output(estimate_error=False)
    )


def main():
    args = demo.arguments(__doc__)
    dt, t_end = (1e-2, 4.0) if args.fast else (5e-3, 7.5)
    mean = fly(False, 12, dt, t_end)
    root = fly(True, 24, dt, t_end)
    momentum, _ = mean.system.at(mean.state.t, mean.state.q, mean.state.v).momenta()
    energy = sum(mean.energy.values())[mean.times > END + 0.01]
    frames = float(np.abs(mean["end"] - root["end"]).max())
    demo.say(
        f"elastic energy up to {mean.energy['elastic'].max():.3g} J of {energy.mean():.4g} J; frames differ by {frames:.3g} m"
    )
    checks = [
        demo.Check.relative("momentum is the impulse of the force", momentum[0], 8.0 * END / 2, 1e-4),
        demo.Check("momentum across it", momentum[1], 0.0, 1e-8),
        demo.Check("energy in free flight, relative", float(np.ptp(energy) / energy.mean()), 0.0, 1e-3),
        demo.Check("mean axes against attached frame (m)", frames, 0.0, 5e-3 * L),
    ]
    if args.picture:
        from fmbd_fenicsx.faces.plot import plot_curves

        curves = {name: (mean[name][:, 0], mean[name][:, 1]) for name in ("start", "end")}
        plot_curves(curves, args.picture, ("x (m)", "y (m)"))
    demo.finish(checks, mean, args)


if __name__ == "__main__":
    main()
