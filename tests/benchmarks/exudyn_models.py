"""Planar chains and the slider crank in Exudyn, timed; run by chain_vs_exudyn.py with an interpreter that has exudyn.

python exudyn_models.py MODEL STEPS H  ->  one line of JSON: seconds per step, position at the end, iterations per step
"""

import json
import sys
import time

sys.exudynFast = True  # the build without range checks
import exudyn as exu  # noqa: E402
import exudyn.itemInterface as ii  # noqa: E402, N813
import numpy as np  # noqa: E402
from exudyn_side import settings  # noqa: E402


def rigid(mbs, mass, inertia, position, angle, velocity=(0, 0), omega=0.0):
    """A planar body; returns a function point (body axes) -> marker."""
    node = mbs.AddNode(
        ii.NodeRigidBody2D(
            referenceCoordinates=[*position, angle],
            initialCoordinates=[0, 0, 0],
            initialVelocities=[*velocity, omega],
        )
    )
    body = mbs.AddObject(ii.ObjectRigidBody2D(physicsMass=mass, physicsInertia=inertia, nodeNumber=node))
    load = mbs.AddMarker(ii.MarkerBodyPosition(bodyNumber=body, localPosition=[0, 0, 0]))
    if GRAVITY:
        mbs.AddLoad(ii.Force(markerNumber=load, loadVector=[0, -mass * GRAVITY, 0]))
    return body, lambda x, y=0.0: mbs.AddMarker(ii.MarkerBodyPosition(bodyNumber=body, localPosition=[x, y, 0]))


def chain(mbs, n):
    """n links from the origin along x."""
    length, mass = 0.1, 0.1
    ground = mbs.AddObject(ii.ObjectGround())
    last = mbs.AddMarker(ii.MarkerBodyPosition(bodyNumber=ground, localPosition=[0, 0, 0]))
    for i in range(n):
        body, at = rigid(mbs, mass, mass * length**2 / 12, [(i + 0.5) * length, 0], 0.0)
        mbs.AddObject(ii.RevoluteJoint2D(markerNumbers=[last, at(-length / 2)]))
        last = at(length / 2)
    return body, [length / 2, 0, 0]


def crank(mbs):
    """Slider crank of the IVP test set, rigid, coasting from 150 rad/s."""
    r, arm, w = 0.15, 0.3, 150.0
    ground = mbs.AddObject(ii.ObjectGround())
    zero = mbs.AddMarker(ii.MarkerBodyPosition(bodyNumber=ground, localPosition=[0, 0, 0]))
    _, one = rigid(mbs, 0.36, 0.002727 - 0.36 * r**2 / 4, [r / 2, 0], 0.0, (0, w * r / 2), w)
    _, two = rigid(mbs, 0.151104, 0.0045339259 - 0.151104 * 0.15**2, [r + arm / 2, 0], 0.0, (0, w * r / 2), -w / 2)
    body, three = rigid(mbs, 0.075552, 1e-4, [r + arm, 0], 0.0)
    mbs.AddObject(ii.RevoluteJoint2D(markerNumbers=[zero, one(-r / 2)]))
    mbs.AddObject(ii.RevoluteJoint2D(markerNumbers=[one(r / 2), two(-arm / 2)]))
    mbs.AddObject(ii.RevoluteJoint2D(markerNumbers=[two(arm / 2), three(0.0)]))
    guide = mbs.AddMarker(ii.MarkerBodyRigid(bodyNumber=ground, localPosition=[0, 0, 0]))
    block = mbs.AddMarker(ii.MarkerBodyRigid(bodyNumber=body, localPosition=[0, 0, 0]))
    mbs.AddObject(ii.PrismaticJoint2D(markerNumbers=[guide, block], axisMarker0=[1, 0, 0], normalMarker1=[0, 1, 0]))
    return body, [0, 0, 0]


def main():
    """Time one model in its fastest setting of two (full or modified Newton)."""
    global GRAVITY
    model, steps, h = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    GRAVITY = 0.0 if model == "crank" else 9.81
    best = None
    for modified in (False, True):
        system = exu.SystemContainer()
        mbs = system.AddSystem()
        body, point = crank(mbs) if model == "crank" else chain(mbs, int(model))
        mbs.Assemble()
        large = model != "crank" and int(model) > 10
        s = settings(exu, steps, h, modified=modified, sparse=large, records=1)
        solver = exu.MainSolverImplicitSecondOrder()
        solver.InitializeSolver(mbs, s)
        begin = time.process_time()
        solver.SolveSteps(mbs, s)
        seconds = (time.process_time() - begin) / steps
        iterations = solver.it.newtonStepsCount / steps
        solver.FinalizeSolver(mbs, s)
        end = mbs.GetObjectOutputBody(body, exu.OutputVariableType.Position, localPosition=point)
        if best is None or seconds < best["seconds"]:
            best = {
                "seconds": seconds,
                "iterations": iterations,
                "end": list(np.array(end)[:2]),
                "modified": modified,
            }
    print(json.dumps(best))


main()
