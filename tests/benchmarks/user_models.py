"""Mechanisms described once and built on both sides: in fmbd_fenicsx and in Exudyn. All bodies begin in world axes."""

from dataclasses import dataclass, field

import numpy as np
from exudyn_side import Exudyn, G

import fmbd_fenicsx as fmbd


@dataclass
class Model:
    """A mechanism: bodies (mass, inertia, place, velocity, spin), hinges and connectors between them; None is the ground.

    ``end``: the body whose centre of mass is compared.
    """

    dim: int
    bodies: dict = field(default_factory=dict)
    hinges: list = field(default_factory=list)  # (a, b, point, axis, spring of the hinge or None)
    guides: list = field(default_factory=list)  # (a, b, point): b slides along x on a without turning
    springs: list = field(default_factory=list)  # (a, b, point of a, point of b, stiffness, damping, length)
    mounts: list = field(default_factory=list)  # (a, b, point, diagonal of K, of C)
    pushes: list = field(default_factory=list)  # (body, law of time)
    torques: list = field(default_factory=list)  # (body, number)
    wheels: list = field(default_factory=list)  # (body, force law(x, v))
    dependent: set = field(default_factory=set)  # numbers of hinges with a row too many: Exudyn must not have it
    end: str = ""

    def body(self, name, mass, inertia, place, velocity=None, spin=None):
        """Add a body; the last one added is compared."""
        zero = np.zeros(self.dim)
        self.bodies[name] = (mass, inertia, np.array(place, dtype=float), zero if velocity is None else velocity, spin)
        self.end = name

    def ours(self):
        """Scene, body, point from its centre of mass."""
        scene, at = fmbd.Scene("model", gravity=DOWN[self.dim]), {None: fmbd.ground}
        for name, (mass, inertia, place, velocity, spin) in self.bodies.items():
            spin = (0.0 if self.dim == 2 else np.zeros(3)) if spin is None else spin
            at[name] = fmbd.RigidBody(name, mass, inertia, place, velocity=velocity, angular_velocity=spin)
            scene.add(at[name])
        for i, (a, b, point, axis, spring) in enumerate(self.hinges):
            turn = {} if self.dim == 2 else {"axis": axis}
            hinge = fmbd.revolute(f"hinge {i}", at[a], at[b], center=point, **turn)
            scene.add(hinge)
            if callable(spring):
                scene.add(fmbd.joint_spring(f"law {i}", fmbd.angle(hinge), law=spring))
            elif spring:
                scene.add(fmbd.joint_spring(f"spring {i}", fmbd.angle(hinge), stiffness=spring[0], damping=spring[1]))
        for i, (a, b, point) in enumerate(self.guides):
            scene.add(fmbd.prismatic(f"guide {i}", at[a], at[b], axis=np.eye(self.dim)[0], center=point))
        for i, (a, b, pa, pb, k, c, length) in enumerate(self.springs):
            scene.add(fmbd.Spring(f"line {i}", at[a], at[b], pa, pb, stiffness=k, damping=c, length=length))
        for i, (a, b, point, k, c) in enumerate(self.mounts):
            scene.add(fmbd.bushing(f"mount {i}", at[a], at[b], stiffness=k, damping=c, center=point))
        for i, (b, law) in enumerate(self.pushes):
            scene.add(fmbd.force(f"push {i}", at[b], law, point=self.bodies[b][2]))
        for i, (b, number) in enumerate(self.torques):
            scene.add(fmbd.torque(f"torque {i}", at[b], lambda t, number=number: number))
        for i, (b, law) in enumerate(self.wheels):
            of = lambda t, a, law=law: (law(a.x, a.v), 0.0)  # noqa: E731
            scene.add(fmbd.own_force(f"wheel {i}", at[b], None, of, points=(self.bodies[b][2], None)))
        return scene, at[self.end], np.zeros(self.dim)

    def theirs(self):
        """Exudyn, body, point from its centre of mass."""
        e = Exudyn()
        items, at = e.items, {None: (e.ground, np.zeros(3))}
        for name, (mass, inertia, place, velocity, spin) in self.bodies.items():
            at[name] = e.body(self.dim, mass, inertia, place, velocity, spin), np.array([*place, 0.0][:3])

        def marker(name, point, rigid=True):
            number, place = at[name]
            return e.marker(number, np.array([*point, 0.0][:3]) - place, rigid)

        for i, (a, b, point, axis, spring) in enumerate(self.hinges):
            ends = [marker(a, point), marker(b, point)]
            turned = {} if self.dim == 2 else dict.fromkeys(("rotationMarker0", "rotationMarker1"), along(axis))
            if i in self.dependent:
                e.mbs.AddObject(items.GenericJoint(markerNumbers=ends, constrainedAxes=[1, 1, 1, 1, 0, 0], **turned))
            else:
                kind = items.RevoluteJoint2D if self.dim == 2 else items.ObjectJointRevoluteZ
                e.mbs.AddObject(kind(markerNumbers=ends, **turned))
            if callable(spring):
                user = lambda mbs, t, i, x, v, k, c, o, law=spring: law(x, v, t)  # noqa: E731
                e.mbs.AddObject(
                    items.TorsionalSpringDamper(markerNumbers=ends, springTorqueUserFunction=user, **turned)
                )
            elif spring:
                e.mbs.AddObject(
                    items.TorsionalSpringDamper(markerNumbers=ends, stiffness=spring[0], damping=spring[1], **turned)
                )
        for a, b, point in self.guides:
            ends = [marker(a, point), marker(b, point)]
            if self.dim == 2:
                e.mbs.AddObject(
                    items.PrismaticJoint2D(markerNumbers=ends, axisMarker0=[1, 0, 0], normalMarker1=[0, 1, 0])
                )
            else:
                e.mbs.AddObject(items.ObjectJointPrismaticX(markerNumbers=ends))
        for a, b, pa, pb, k, c, length in self.springs:
            ends = [marker(a, pa, False), marker(b, pb, False)]
            e.mbs.AddObject(items.SpringDamper(markerNumbers=ends, stiffness=k, damping=c, referenceLength=length))
        for a, b, point, k, c in self.mounts:
            ends = [marker(a, point), marker(b, point)]
            K, C = (np.diag(x if self.dim == 3 else [x[0], x[1], 0.0, 0.0, 0.0, x[2]]) for x in (k, c))
            e.mbs.AddObject(items.RigidBodySpringDamper(markerNumbers=ends, stiffness=K, damping=C))
        for b, law in self.pushes:
            user = lambda mbs, t, load, law=law: [*law(t), 0.0][:3]  # noqa: E731
            at_centre = marker(b, self.bodies[b][2], False)
            e.mbs.AddLoad(items.Force(markerNumber=at_centre, loadVector=[0, 0, 0], loadVectorUserFunction=user))
        for b, number in self.torques:
            e.mbs.AddLoad(items.Torque(markerNumber=marker(b, self.bodies[b][2]), loadVector=[0, 0, number]))
        for b, law in self.wheels:
            place = self.bodies[b][2]
            ends = [marker(None, place, False), marker(b, place, False)]
            user = lambda mbs, t, i, u, v, k, c, o, law=law, x=place: [  # noqa: E731
                *(-law(x + np.array(u)[:2], np.array(v)[:2])), 0.0
            ]  # fmt: skip
            e.mbs.AddObject(items.CartesianSpringDamper(markerNumbers=ends, springForceUserFunction=user))
        return e, at[self.end][0], [0.0, 0.0, 0.0]


DOWN = {2: (0, -G), 3: (0, 0, -G)}


def along(axis):
    """A rotation whose third column is the axis."""
    z = np.array(axis, dtype=float)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack((x, np.cross(z, x), z), axis=1)


# ---- mechanisms ----------------------------------------------------------------------------------


def chain(dim, n, spring=None):
    """n links of 0.1 m along x; in space with hinges in turn about y and a skew axis."""
    model, before = Model(dim), None
    for i in range(n):
        inertia = 1e-3 / 12 if dim == 2 else np.diag([2e-6, 1e-3 / 12, 1e-3 / 12])
        place = [(i + 0.5) * 0.1, 0.0, 0.0][:dim]
        model.body(f"{i}", 0.1, inertia, place)
        axis = (0.0, 1.0, 0.0) if i % 2 == 0 else (0.0, 0.8, 0.6)
        model.hinges.append((before, f"{i}", [i * 0.1, 0.0, 0.0][:dim], axis, spring))
        before = f"{i}"
    return model


def mounted():
    """A body of 4 kg in space on four bushings."""
    model = Model(3)
    model.body("body", 4.0, np.diag([0.017, 0.017, 0.027]), (0.0, 0.0, 0.0), velocity=np.array([0.3, 0.1, 0.0]))
    for x, y in ((-0.1, -0.1), (-0.1, 0.1), (0.1, -0.1), (0.1, 0.1)):
        model.mounts.append((None, "body", (x, y, -0.05), [3e3, 3e3, 8e3, 5.0, 5.0, 5.0], [6, 6, 16, 0.01, 0.01, 0.01]))
    return model


def pd_arm():
    """Two links, each with a position controller written as a Python law."""
    model = chain(2, 2)
    for i, (a, b, point, axis, _) in enumerate(model.hinges):
        law = lambda s, v, t, i=i: 20.0 * (s - 0.5 * (i + 1) * np.sin(4.0 * t)) + 0.2 * v  # noqa: E731
        model.hinges[i] = (a, b, point, axis, law)
    return model


def crank():
    """Rigid slider crank, driven by a torque against a damper in its bearing."""
    model = Model(2)
    model.body("crank", 0.36, 1e-3, (0.075, 0.0))
    model.body("rod", 0.15, 1.2e-3, (0.3, 0.0))
    model.body("slider", 0.08, 1e-4, (0.45, 0.0))
    joints = ((None, "crank", 0.0), ("crank", "rod", 0.15), ("rod", "slider", 0.45))
    model.hinges = [(a, b, (x, 0.0), None, None if a else (0.0, 0.05)) for a, b, x in joints]
    model.guides.append((None, "slider", (0.45, 0.0)))
    model.torques.append(("crank", 0.8))
    return model


def suspension():
    """Double wishbone of the plane with a spring-damper between chassis and lower arm, shaken by a force of time."""
    model = Model(2)
    model.body("lower", 3.0, 0.04, (0.4, 0.0))
    model.body("upper", 2.0, 0.02, (0.45, 0.3))
    model.body("hub", 20.0, 0.6, (0.65, 0.15))
    model.hinges = [
        (None, "lower", (0.2, 0.0), None, None), ("lower", "hub", (0.6, 0.0), None, None),
        (None, "upper", (0.3, 0.3), None, None), ("upper", "hub", (0.6, 0.3), None, None),
    ]  # fmt: skip
    model.springs.append((None, "lower", (0.35, 0.5), (0.45, 0.0), 4e4, 2e3, 0.52))
    model.pushes.append(("hub", lambda t: (0.0, 1000.0 + 600.0 * np.sin(30.0 * t))))
    return model


def truck():
    """A chassis on two axles with springs and dampers, tyres as a Python law over a wavy road."""

    def tyre(x, v):
        depth = 0.5 + 0.02 * np.sin(2.0 * x[0]) - x[1]
        return np.array([0.0, max(4e5 * depth - 2e3 * v[1], 0.0) if depth > 0 else 0.0])

    model, speed = Model(2), np.array([15.0, 0.0])
    for i, x in enumerate((-1.5, 1.5)):
        model.body(f"axle {i}", 300.0, 20.0, (x, 0.48), velocity=speed)
        model.wheels.append((f"axle {i}", tyre))
    model.body("chassis", 4000.0, 6000.0, (0.0, 1.4), velocity=speed)
    for i, x in enumerate((-1.5, 1.5)):
        model.mounts.append(("chassis", f"axle {i}", (x, 0.9), [2e6, 3e5, 1e5], [2e4, 2e4, 1e3]))
    return model


def governor():
    """Flyball governor: two rods with balls, hinged to a shaft, tied by springs and dampers to a slider on it."""
    model, w = Model(3), 2 * np.pi
    spin = np.array([w, 0.0, 0.0])  # the shaft stands along x, so that the slider's guide does

    def body(name, mass, inertia, place):
        model.body(name, mass, inertia, place, np.cross(spin, place), spin)

    body("shaft", 0.3, np.diag([1e-4, 0.025, 0.025]), np.array([0.5, 0.0, 0.0]))
    for name, side in (("right", 1.0), ("left", -1.0)):
        d = np.array([-0.5, 0.75**0.5 * side, 0.0])
        hinge = np.array([1.0, 0.05 * side, 0.0])
        inertia = 0.2 * (np.eye(3) - 0.98 * np.outer(d, d))
        body(name, 5.3, inertia, hinge + 0.97 * d)
        model.hinges.append(("shaft", name, hinge, (0.0, 0.0, 1.0), None))
    body("slider", 3.0, np.eye(3) * 5e-3, np.array([0.5, 0.0, 0.0]))
    model.guides.append(("shaft", "slider", np.array([0.5, 0.0, 0.0])))
    model.hinges.append((None, "shaft", np.zeros(3), (1.0, 0.0, 0.0), None))
    for name, side in (("right", 1.0), ("left", -1.0)):
        middle = np.array([1.0, 0.05 * side, 0.0]) + 0.5 * np.array([-0.5, 0.75**0.5 * side, 0.0])
        model.springs.append((name, "slider", middle, np.array([0.5, 0.05 * side, 0.0]), 8e3, 4e2, 0.5))
    return model


def bricard():
    """Six hinges and five rods along the edges of a unit cube: one degree of freedom, one constraint too many."""
    model = Model(3)
    corners = np.array([(0, 0, 0), (0, 1, 0), (0, 1, -1), (1, 1, -1), (1, 0, -1), (1, 0, 0)], dtype=float)
    for i, (p, q) in enumerate(zip(corners[:-1], corners[1:], strict=True)):
        inertia = np.where(np.abs(q - p) > 0.5, 0.1**2 / 6, (1 + 0.1**2) / 12)
        model.body(f"{i}", 1.0, np.diag(inertia), (p + q) / 2)
    names = [None, *model.bodies, None]
    for i, (a, b) in enumerate(zip(names[:-1], names[1:], strict=True)):
        model.hinges.append((a, b, corners[i], np.eye(3)[[2, 0, 1][i % 3]], None))
    model.dependent, model.end = {5}, "2"
    return model
