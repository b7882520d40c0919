"""A model in Exudyn, and the CPU time of its steps."""

import sys
import time
import warnings

import numpy as np

sys.exudynFast = True  # the build without range checks
warnings.filterwarnings("ignore", category=DeprecationWarning)
H = 1e-3
G = 9.81


class Exudyn:
    """A model being built in Exudyn."""

    def __init__(self):
        import exudyn as exu
        import exudyn.itemInterface as items  # noqa: N813
        import exudyn.utilities as utilities

        self.exu, self.items, self.utilities = exu, items, utilities
        self.mbs = exu.SystemContainer().AddSystem()
        self.ground = self.mbs.AddObject(items.ObjectGround())

    def marker(self, body, place, rigid=False):
        kind = self.items.MarkerBodyRigid if rigid else self.items.MarkerBodyPosition
        return self.mbs.AddMarker(kind(bodyNumber=body, localPosition=[*place, 0, 0][:3]))

    def link(self, place, mass, inertia):
        """A body of the plane with its weight."""
        items, mbs = self.items, self.mbs
        node = mbs.AddNode(items.NodeRigidBody2D(referenceCoordinates=[*place, 0.0]))
        body = mbs.AddObject(items.ObjectRigidBody2D(physicsMass=mass, physicsInertia=inertia, nodeNumber=node))
        load = items.Force(markerNumber=self.marker(body, [0, 0]), loadVector=[0, -mass * G, 0])
        mbs.AddLoad(load)
        return body

    def body(self, dim, mass, inertia, place, velocity, spin):
        """A body in world axes with its weight, of the plane or of space (along z there)."""
        items, mbs = self.items, self.mbs
        if dim == 3:
            moments = self.utilities.RigidBodyInertia(mass, np.asarray(inertia))
            rates = {
                "initialVelocity": list(velocity),
                "initialAngularVelocity": [0.0] * 3 if spin is None else list(spin),
            }
            return mbs.CreateRigidBody(
                inertia=moments, referencePosition=list(place), gravity=[0, 0, -G], returnDict=True, **rates
            )["bodyNumber"]
        node = mbs.AddNode(
            items.NodeRigidBody2D(
                referenceCoordinates=[*place, 0.0],
                initialCoordinates=[0.0] * 3,
                initialVelocities=[*velocity, spin or 0.0],
            )
        )
        body = mbs.AddObject(items.ObjectRigidBody2D(physicsMass=mass, physicsInertia=inertia, nodeNumber=node))
        mbs.AddLoad(items.Force(markerNumber=self.marker(body, [0, 0]), loadVector=[0, -mass * G, 0]))
        return body

    def run(self, steps, body, point, modified, sparse):
        """CPU time of the steps and the place of a point at the end."""
        self.mbs.Assemble()
        spent = exudyn_steps((self.exu, self.mbs), steps, H, modified=modified, sparse=sparse)
        end = self.mbs.GetObjectOutputBody(body, self.exu.OutputVariableType.Position, localPosition=[*point, 0, 0][:3])
        return spent, np.array(end)


def settings(exu, steps, h, *, modified, sparse, records=10):
    """Exudyn's settings of so many steps: generalized-alpha with rho_inf = 0.8, one thread, nothing written but some records."""
    s = exu.SimulationSettings()
    s.timeIntegration.numberOfSteps, s.timeIntegration.endTime = steps, steps * h
    s.timeIntegration.generalizedAlpha.spectralRadius = 0.8
    s.timeIntegration.newton.useModifiedNewton = modified
    s.timeIntegration.verboseMode = 0
    s.parallel.numberOfThreads = 1
    s.solutionSettings.writeSolutionToFile = False
    s.solutionSettings.sensorsWritePeriod = steps * h / records
    s.linearSolverType = exu.LinearSolverType.EigenSparse if sparse else exu.LinearSolverType.EXUdense
    return s


def exudyn_steps(model, steps, h, *, modified, sparse):
    """CPU time of so many steps of an assembled model (exudyn, system), with ten records."""
    exu, mbs = model
    s = settings(exu, steps, h, modified=modified, sparse=sparse)
    begin = time.process_time()
    mbs.SolveDynamic(s)
    return time.process_time() - begin
