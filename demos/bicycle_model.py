"""The benchmark bicycle: its scene, its modes about riding straight on, its figure; data of the demo bicycle.

Source: Meijaard, Papadopoulos, Ruina and Schwab, doi:10.1098/rspa.2007.1857.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import plot

WEAVE, CAPSIZE = 4.29238253634111, 6.02426201538837  # critical speeds, m/s
TILT, UP, ACROSS = np.pi / 10, (0, 0, 1), (0, 1, 0)


def build(speed, lean_rate=0.0):
    """The bicycle at a speed (m/s) and a rate of lean (rad/s); x ahead, y to the left, z up."""
    scene = fmbd.Scene("bicycle", gravity=(0.0, 0.0, -9.81))

    def body(name, mass, x, z, inertia, spin=0.0, shape=None):
        xx, yy, zz, xz = inertia
        J = np.array([[xx, 0, xz], [0, yy, 0], [xz, 0, zz]])
        motion = {"velocity": (speed, -lean_rate * z, 0), "angular_velocity": (lean_rate, spin, 0)}
        return fmbd.RigidBody(name, mass, J, position=(x, 0, z), shape=shape, **motion)

    def wheel(radius):
        return {"spin": speed / radius, "shape": fmbd.contacts.Cylinder(radius, ACROSS, length=0.03)}

    rear = body("rear wheel", 2.0, 0.0, 0.3, (0.0603, 0.12, 0.0603, 0.0), **wheel(0.3))
    front = body("front wheel", 3.0, 1.02, 0.35, (0.1405, 0.28, 0.1405, 0.0), **wheel(0.35))
    frame = body("frame", 85.0, 0.3, 0.9, (9.2, 11.0, 2.8, -2.4))
    fork = body("fork", 4.0, 0.9, 0.7, (0.05892, 0.06, 0.00708, 0.00756))
    steering = fmbd.revolute("steering", frame, fork, center=(1.1, 0, 0), axis=(-np.sin(TILT), 0, np.cos(TILT)))
    scene.add(rear, frame, fork, front, steering)
    scene.add(fmbd.revolute("rear axle", frame, rear, center=(0, 0, 0.3), axis=ACROSS))
    scene.add(fmbd.revolute("front axle", fork, front, center=(1.02, 0, 0.35), axis=ACROSS))
    for name, wheel, radius in (("rear contact", rear, 0.3), ("front contact", front, 0.35)):
        scene.add(fmbd.rolling(name, fmbd.ground, wheel, shape=fmbd.Wheel(radius, axis=ACROSS), normal=UP))
    scene.sensor("steer", fmbd.angle(steering))
    return scene


def lateral(speed):
    """Eigenvalues (1/s) of weave (one of the pair), capsize and castering at a speed above 1 m/s."""
    found = fmbd.modes(build(speed), 9).eigenvalues
    real = np.sort(found[found.imag == 0].real)  # place, heading and speed are zero
    return found[found.imag > 0][0], real[1:][np.argmax(np.abs(real[1:]))], real[0]


def missed(speed, t, y):
    """Share of a ride that the modes at its speed, in any mixture, do not explain."""
    weave, capsize, castering = lateral(speed)
    wave = np.exp(weave * t)
    motions = np.column_stack((wave.real, wave.imag, np.exp(capsize * t), np.exp(castering * t)))
    mixture = np.linalg.lstsq(motions, y, rcond=None)[0]
    return np.linalg.norm(motions @ mixture - y) / np.linalg.norm(y)


def picture(args, rides):
    """Real and imaginary parts over the speed, and the three rides."""
    speeds = np.linspace(1.5, 9.0, 16 if args.fast else 76)
    weave, capsize, _ = np.array([lateral(v) for v in speeds]).T
    with plot.figure(args.picture, 1, 2, title=args.title) as (left, right):
        left.plot(speeds, weave.real, label="weave, growth (1/s)")
        left.plot(speeds, weave.imag, "--", label="weave, frequency (rad/s)")
        left.plot(speeds, capsize.real, label="capsize, growth (1/s)")
        left.axvspan(WEAVE, CAPSIZE, alpha=0.15, label="stable, by the reference")
        left.axhline(0.0, color="k", lw=0.6)
        left.set(xlabel="speed (m/s)", ylabel="eigenvalues (1/s, rad/s)", ylim=(-6, 10))
        for v, (t, y, _) in rides.items():
            right.plot(t, y / np.abs(y[t < 2.0]).max(), label=f"{v:g} m/s")
        right.set(xlabel="time (s)", ylabel="steering angle over its first peak")
