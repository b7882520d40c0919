"""Models of the observatory in Exudyn 1.13.6; run by observatory_peers.py with an interpreter that has exudyn.

python observatory_exudyn.py MODEL STEPS T_END  ->  one line of JSON: position at the end, CPU seconds of assembly and steps.
Mechanisms that are made of a list of bodies (see mechanisms_of_bodies.py) end with the coordinates of all of their bodies; the
list comes by standard input.
"""

import json
import sys
import time

sys.exudynFast = True  # the build without range checks
import exudyn as exu  # noqa: E402
import exudyn.itemInterface as ii  # noqa: E402, N813
import numpy as np  # noqa: E402

G = 9.81


class Plane:
    """Rigid bodies of the plane, their markers by points in world axes at the start."""

    def __init__(self, mbs, gravity=G):
        self.mbs, self.gravity = mbs, gravity
        self.ground = mbs.AddObject(ii.ObjectGround())

    def body(self, mass, inertia, place, velocity=(0, 0), omega=0.0):
        """(object, its place); no turn at the start."""
        node = self.mbs.AddNode(
            ii.NodeRigidBody2D(
                referenceCoordinates=[*place, 0.0], initialCoordinates=[0, 0, 0], initialVelocities=[*velocity, omega]
            )
        )
        made = self.mbs.AddObject(ii.ObjectRigidBody2D(physicsMass=mass, physicsInertia=inertia, nodeNumber=node))
        if self.gravity:
            marker = self.mbs.AddMarker(ii.MarkerBodyPosition(bodyNumber=made, localPosition=[0, 0, 0]))
            self.mbs.AddLoad(ii.Force(markerNumber=marker, loadVector=[0, -mass * self.gravity, 0]))
        return made, np.array([*place, 0.0])

    def at(self, body, x, y=0.0):
        """Marker of a point of a body or, None, of the ground."""
        number, place = (self.ground, np.zeros(3)) if body is None else body
        local = list(np.array([x, y, 0.0]) - place)
        return self.mbs.AddMarker(ii.MarkerBodyPosition(bodyNumber=number, localPosition=local))

    def pin(self, a, b, x, y=0.0):
        """A hinge at a point."""
        self.mbs.AddObject(ii.RevoluteJoint2D(markerNumbers=[self.at(a, x, y), self.at(b, x, y)]))

    def guide(self, body, axis):
        """The body slides along an axis through the origin and does not turn."""
        number, place = body
        zero = self.mbs.AddMarker(ii.MarkerBodyRigid(bodyNumber=self.ground, localPosition=[0, 0, 0]))
        one = self.mbs.AddMarker(ii.MarkerBodyRigid(bodyNumber=number, localPosition=[0, 0, 0]))
        normal = [-axis[1], axis[0], 0]
        self.mbs.AddObject(ii.PrismaticJoint2D(markerNumbers=[zero, one], axisMarker0=[*axis, 0], normalMarker1=normal))

    def spring(self, a, b, stiffness, length=1.0):
        """Between two markers."""
        self.mbs.AddObject(ii.SpringDamper(markerNumbers=[a, b], stiffness=stiffness, referenceLength=length))


def mass_on_spring(mbs):
    p = Plane(mbs)
    body = p.body(2.0, 0.1, (0.0, -1.0))
    p.guide(body, (0, 1))
    p.spring(p.at(None, 0, 0), p.at(body, 0, -1), 50.0)
    return body[0], [0, 0, 0]


def compound(mbs):
    p = Plane(mbs)
    bar = p.body(1.0, 1 / 12, (0.5, 0.0))
    p.pin(None, bar, 0.0)
    return bar[0], [0, 0, 0]


def double(mbs):
    p = Plane(mbs)
    one, two = (p.body(1.0, 1 / 12, (k + 0.5, 0.0)) for k in range(2))
    p.pin(None, one, 0.0)
    p.pin(one, two, 1.0)
    return two[0], [0, 0, 0]


def spring_pendulum(stiffness):
    def model(mbs):
        p = Plane(mbs)
        body = p.body(1.0, 1.0, (1.0, 0.0))
        p.spring(p.at(None, 0, 0), p.at(body, 1, 0), stiffness)
        return body[0], [0, 0, 0]

    return model


def two_masses(mbs):
    p = Plane(mbs, gravity=0.0)
    left, right = p.body(1.0, 1.0, (1.0, 0.0), (1.0, 0.0)), p.body(1.0, 1.0, (2.0, 0.0))
    for body in (left, right):
        p.guide(body, (1, 0))
    p.spring(p.at(None, 0), p.at(left, 1), 100.0)
    p.spring(p.at(left, 1), p.at(right, 2), 100.0)
    p.spring(p.at(right, 2), p.at(None, 3), 100.0)
    return right[0], [0, 0, 0]


def top(spin, inertia, mass, held=True):
    """A body with its centre at (0, 1, 0), on a ball at the origin or free."""

    def model(mbs):
        velocity = np.cross(spin, [0.0, 1.0, 0.0]) if held else np.zeros(3)
        made = mbs.CreateRigidBody(
            inertia=exu.rigidBodyUtilities.RigidBodyInertia(mass, np.diag(inertia)),
            referencePosition=[0, 1, 0],
            initialVelocity=list(velocity),
            initialAngularVelocity=list(spin),
            gravity=[0, 0, -G] if held else [0, 0, 0],
        )
        if held:
            ground = mbs.CreateGround()
            mbs.CreateSphericalJoint(bodyNumbers=[ground, made], position=[0, 0, 0])
        return made, [0, 0, 0] if held else [0, 1, 0]

    return model


def mechanism(mbs):
    """Bodies, hinges, springs, guides and a torque as lists of numbers, all bodies' coordinates at the end."""
    told, p = json.load(sys.stdin), Plane(mbs, gravity=0.0)
    bodies = []
    for mass, inertia, x, y, turn, vx, vy, omega in told["bodies"]:
        node = mbs.AddNode(ii.NodeRigidBody2D(referenceCoordinates=[x, y, turn], initialVelocities=[vx, vy, omega]))
        bodies.append(mbs.AddObject(ii.ObjectRigidBody2D(physicsMass=mass, physicsInertia=inertia, nodeNumber=node)))

    def marker(number, x, y):
        """Of a point of the world at the start on a body, or on the ground."""
        if number < 0:
            return mbs.AddMarker(ii.MarkerBodyPosition(bodyNumber=p.ground, localPosition=[x, y, 0]))
        place = told["bodies"][number]
        c, s, dx, dy = np.cos(place[4]), np.sin(place[4]), x - place[2], y - place[3]
        local = [c * dx + s * dy, -s * dx + c * dy, 0]
        return mbs.AddMarker(ii.MarkerBodyPosition(bodyNumber=bodies[number], localPosition=local))

    for a, b, x, y in told["hinges"]:
        mbs.AddObject(ii.RevoluteJoint2D(markerNumbers=[marker(int(a), x, y), marker(int(b), x, y)]))
    for a, xa, ya, b, xb, yb, stiffness, length in told["springs"]:
        ends = [marker(int(a), xa, ya), marker(int(b), xb, yb)]
        mbs.AddObject(ii.SpringDamper(markerNumbers=ends, stiffness=stiffness, referenceLength=length))
    for number in told["guided"]:
        p.guide((bodies[number], None), (1, 0))
    for number, moment in told["torques"]:
        turning = mbs.AddMarker(ii.MarkerBodyRigid(bodyNumber=bodies[number], localPosition=[0, 0, 0]))
        mbs.AddLoad(ii.Torque(markerNumber=turning, loadVector=[0, 0, moment]))

    def read():
        found = [mbs.GetNodeOutput(k, exu.OutputVariableType.Coordinates) for k in range(len(bodies))]
        start = np.array([place[2:5] for place in told["bodies"]])
        return (np.array(found) + start).ravel()

    return read, None


HEAVY, FAST = ((0.0, 150.0, -4.61538), (0.234375, 0.46875, 0.234375), 15.0), ((0.5, 1.0, 6.0), (0.1, 0.2, 0.25), 2.0)
MODELS = {
    "mass on spring": mass_on_spring,
    "compound pendulum": compound,
    "double pendulum": double,
    "spring pendulum": spring_pendulum(200.0),
    "stiff spring pendulum": spring_pendulum(1e5),
    "two masses": two_masses,
    "heavy top": top(*HEAVY),
    "fast top": top(*FAST),
    "free body": top(*FAST, held=False),
    "steady precession": top((0.0, G / 0.2, 1.0), (0.1, 0.2, 0.1), 1.0),
    "mechanism": mechanism,
    "spherical pendulum": top((-1.0, 0.0, 2.0), (0.02, 0.01, 0.02), 1.0),
}


def main():
    """One model with its number of steps."""
    name, steps, t_end = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    mbs = exu.SystemContainer().AddSystem()
    begun = time.process_time()
    body, point = MODELS[name](mbs)
    mbs.Assemble()
    s = exu.SimulationSettings()
    s.timeIntegration.numberOfSteps, s.timeIntegration.endTime = steps, t_end
    s.timeIntegration.generalizedAlpha.spectralRadius = 0.8
    s.timeIntegration.newton.useModifiedNewton = False
    s.parallel.numberOfThreads = 1
    s.timeIntegration.verboseMode = 0
    s.solutionSettings.writeSolutionToFile = False
    s.linearSolverType = exu.LinearSolverType.EXUdense
    solver = exu.MainSolverImplicitSecondOrder()
    solver.InitializeSolver(mbs, s)
    solver.SolveSteps(mbs, s)
    seconds = time.process_time() - begun
    solver.FinalizeSolver(mbs, s)
    position = exu.OutputVariableType.Position
    end = body() if callable(body) else mbs.GetObjectOutputBody(body, position, localPosition=point)
    print(json.dumps({"end": list(np.array(end)), "seconds": seconds}))


main()
