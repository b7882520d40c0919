r"""Frequency responses: two masses against their transfer function, an elastic arm from its drive to the motion of its tip.

Run:  ./with-dolfinx python3 demos/frequency_response.py --picture bode.png

   |--/\/\--[ 1 kg ]--/\/\--[ 2 kg ]      3 N/m with 0.1 N s/m, 5 N/m; force on the first, position of the second
   |   wall          middle

The arm, 1 m long, turns on a pin with a spring and a damper, and is driven there by a torque; the response of its tip's
acceleration in the linear model is compared with what a run under a sinusoidal torque shows after its transient.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

DRIVE = 60.0  # rad/s


def two_masses():
    """Two masses in a row."""
    scene = fmbd.Scene("two masses")
    a, b = (fmbd.RigidBody(n, m, 1.0, position=(x, 0.0)) for n, m, x in (("a", 1.0, 1.0), ("b", 2.0, 2.0)))
    guides = [fmbd.prismatic(f"guide {x.name}", fmbd.ground, x, axis=(1.0, 0.0)) for x in (a, b)]
    scene.add(a, b, *guides, fmbd.Spring("middle", a, b, (1.0, 0.0), (2.0, 0.0), stiffness=5.0, length=1.0))
    scene.add(fmbd.joint_spring("wall", fmbd.displacement(guides[0]), stiffness=3.0, damping=0.1))
    scene.add(fmbd.force("push", a, lambda t: (0.0, 0.0)))
    scene.sensor("b", fmbd.position(b))
    return scene


def arm(size):
    """A damped elastic arm under a torque of ``size`` N m in its pin."""
    mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.1)
    how = {"elastic": fmbd.materials.plane_stress(5e8, 0.3), "stiffness_damping": 2e-3}
    rod = fmbd.FloatingBody("rod", mesh, density=1000.0, **how).reduced(basis=fmbd.CraigBampton(("pin", "tip"), 6))
    scene = fmbd.Scene("arm")
    pin = fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0.0, 0.0))
    scene.add(rod, pin, fmbd.joint_spring("spring", fmbd.angle(pin), stiffness=5e4, damping=500.0))
    scene.add(fmbd.effort("drive", fmbd.angle(pin), lambda t: size * np.sin(DRIVE * t)))
    scene.sensor("tip", fmbd.acceleration(rod.surface("tip")))
    return scene


def main():
    """Both responses against their references."""
    args = demo.arguments(__doc__)
    omega = np.geomspace(0.1, 20.0, 300)
    s = 1j * omega
    exact = 5.0 / ((s * s + 0.1 * s + 8.0) * (2.0 * s * s + 5.0) - 25.0)
    found = fmbd.frequency_response(two_masses(), ["push x"], ["b x"], omega)[:, 0, 0]

    model = fmbd.linearise(arm(0.0), ["drive"], ["tip y"])
    answer = model.frequency_response([DRIVE])[0, 0, 0]
    turn = 2 * np.pi / DRIVE
    run = fmbd.solve(arm(1.0), t_end=22 * turn, dt=turn / (200 if args.fast else 400))
    late = run.times > 19.99 * turn
    waves = np.stack((np.sin(DRIVE * run.times[late]), np.cos(DRIVE * run.times[late])), axis=1)
    fitted = np.linalg.lstsq(waves, run["tip"][late, 1], rcond=None)[0]
    checks = [
        Check(
            "two masses, error over the largest response", np.abs(found - exact).max() / np.abs(exact).max(), 0.0, 1e-10
        ),
        Check("run against linear model, relative", abs(complex(*fitted) - answer) / abs(answer), 0.0, 1e-3),
    ]
    if args.picture:
        wide = np.geomspace(5.0, 2000.0, 400)
        rod = model.frequency_response(wide)[:, 0, 0]
        names = "b of two masses over a force (m/N)", "acceleration of the tip over the torque (m/s$^2$/N m)"
        with plot.figure(args.picture, 2, 2, title=args.title) as axes:
            for k, (x, H, name) in enumerate(((omega, found, names[0]), (wide, rod, names[1]))):
                axes[0, k].loglog(x, np.abs(H))
                axes[0, k].set_title(name, fontsize=9)
                axes[1, k].semilogx(x, np.degrees(np.unwrap(np.angle(H))))
                axes[1, k].set_xlabel("angular frequency (rad/s)")
            axes[0, 1].plot(DRIVE, abs(answer), "o", color="C3", label="a run at this frequency")
            axes[0, 1].legend(fontsize=8)
            axes[0, 0].set_ylabel("amplitude")
            axes[1, 0].set_ylabel("phase (degrees)")
    demo.finish(checks, None, args)


if __name__ == "__main__":
    main()
