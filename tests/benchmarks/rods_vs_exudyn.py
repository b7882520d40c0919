"""Rods against Exudyn 1.13.6: right-angle frame (geometrically exact beams) and hanging cable (ANCF cable), at equal error.

Run:  ./with-dolfinx python3 tests/benchmarks/rods_vs_exudyn.py [--repeat 3] [--json FILE]

Both sides run in one interpreter, which must have exudyn, in turn. CPU time of a step from the difference of runs of N and 2 N
steps, times the steps of the run. Errors: root mean square of the tip's place at ten instants, against a run with finer elements
and a quarter of the step. Each side takes the coarsest of its meshes that reaches the error asked for.
"""

import argparse
import itertools
import json
import time
from pathlib import Path

import numpy as np
from exudyn_side import exudyn_steps

import fmbd_fenicsx as fmbd

G, RHO = 9.81, 0.8


# -- right-angle frame: Simo and Vu-Quoc, doi:10.1016/0045-7825(88)90073-4 ------------------------------------------
LEG = {"stiffness": (1e6, 1e6, 1e6, 1e3, 1e3, 1e3), "mass": 1.0, "inertia": (20.0, 10.0, 10.0)}


def kick(t):
    """N, across the plane."""
    return max(50.0 * min(t, 2.0 - t), 0.0)


def frame(elements, degree):
    """Scene with the sensor "tip"."""
    section = fmbd.RodSection(LEG["stiffness"], mass=LEG["mass"], inertia=LEG["inertia"])
    inner = fmbd.Rod("inner", [(0, 0, 0), (10, 0, 0)], section, elements=elements, degree=degree)
    outer = fmbd.Rod("outer", [(10, 0, 0), (10, 10, 0)], section, elements=elements, degree=degree)
    scene = fmbd.Scene("right-angle frame")
    scene.add(inner, outer, fmbd.fixed("clamp", fmbd.ground, inner.surface("start")))
    scene.add(fmbd.fixed("elbow", inner.surface("end"), outer.surface("start")))
    scene.add(fmbd.forces.force("kick", inner.surface("end"), lambda t: (0.0, 0.0, kick(t))))
    scene.sensor("tip", fmbd.sensors.position(outer.surface("end")))
    return scene


def frame_exudyn(elements):
    """System and its sensor of the tip."""
    import exudyn as exu
    import exudyn.itemInterface as items  # noqa: N813

    mbs = exu.SystemContainer().AddSystem()
    section = exu.BeamSection()
    section.stiffnessMatrix = np.diag(LEG["stiffness"])
    section.inertia, section.massPerLength = np.diag(LEG["inertia"]), LEG["mass"]

    def leg(start, direction, first):
        """Nodes along a leg, beams between them."""
        along = np.array(direction)
        R = np.column_stack((along, np.cross([0, 0, 1], along), [0, 0, 1]))
        angle = float(np.arctan2(along[1], along[0]))
        nodes = [] if first is None else [first]
        size = 10.0 / elements
        for i in range(len(nodes), elements + 1):
            place = np.array(start) + along * i * size
            turn = [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
            nodes.append(mbs.AddNode(items.NodeRigidBodyEP(referenceCoordinates=[*place, *turn])))
        assert np.allclose(R.T @ R, np.eye(3))
        for a, b in zip(nodes, nodes[1:], strict=False):
            mbs.AddObject(items.ObjectBeamGeometricallyExact(nodeNumbers=[a, b], length=size, sectionData=section))
        return nodes

    def rigid(node):
        return mbs.AddMarker(items.MarkerNodeRigid(nodeNumber=node))

    inner = leg((0, 0, 0), (1, 0, 0), None)
    outer = leg((10, 0, 0), (0, 1, 0), None)
    ground = mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=mbs.AddObject(items.ObjectGround())))
    mbs.AddObject(items.GenericJoint(markerNumbers=[ground, rigid(inner[0])]))
    c, s = np.cos(np.pi / 2), np.sin(np.pi / 2)
    joint = items.GenericJoint(
        markerNumbers=[rigid(inner[-1]), rigid(outer[0])], rotationMarker1=[[c, s, 0], [-s, c, 0], [0, 0, 1]]
    )
    mbs.AddObject(joint)
    load = items.Force(markerNumber=rigid(inner[-1]), loadVector=[0, 0, 1])
    load.loadVectorUserFunction = lambda mbs, t, load: [0, 0, kick(t)]
    mbs.AddLoad(load)
    tip = mbs.AddSensor(
        items.SensorNode(nodeNumber=outer[-1], outputVariableType=exu.OutputVariableType.Position, storeInternal=True)
    )
    return exu, mbs, tip


# -- hanging cable: pinned at one end, let go from the horizontal ------------------------------------------------------
CABLE = {"EA": 1e4, "EI": 0.05, "mass": 0.5}


def cable(elements, degree):
    """Scene with the sensor "tip"; the cable is stiff against shear and has little rotary inertia, as the other side has none."""
    EA, EI, mass = CABLE["EA"], CABLE["EI"], CABLE["mass"]
    section = fmbd.RodSection((EA, EA, EA, EI, EI, EI), mass=mass, inertia=(2e-6, 1e-6, 1e-6))
    rod = fmbd.Rod("cable", [(0, 0, 0), (2, 0, 0)], section, elements=elements, degree=degree)
    scene = fmbd.Scene("cable", gravity=(0, 0, -G))
    scene.add(rod, fmbd.spherical("pin", fmbd.ground, rod.surface("start"), center=(0, 0, 0)))
    scene.sensor("tip", fmbd.sensors.position(rod.surface("end")))
    return scene


def cable_exudyn(elements):
    """The same of ANCF cables in space."""
    import exudyn as exu
    import exudyn.itemInterface as items  # noqa: N813

    mbs = exu.SystemContainer().AddSystem()
    size = 2.0 / elements
    nodes = [
        mbs.AddNode(items.NodePointSlope1(referenceCoordinates=[i * size, 0, 0, 1, 0, 0])) for i in range(elements + 1)
    ]
    for a, b in zip(nodes, nodes[1:], strict=False):
        given = {"physicsMassPerLength": CABLE["mass"], "physicsBendingStiffness": CABLE["EI"]}
        part = mbs.AddObject(
            items.Cable(nodeNumbers=[a, b], physicsLength=size, physicsAxialStiffness=CABLE["EA"], **given)
        )
        weight = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=part))
        mbs.AddLoad(items.LoadMassProportional(markerNumber=weight, loadVector=[0, 0, -G]))
    ground = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=mbs.AddObject(items.ObjectGround())))
    pin = mbs.AddMarker(items.MarkerNodePosition(nodeNumber=nodes[0]))
    mbs.AddObject(items.SphericalJoint(markerNumbers=[ground, pin]))
    tip = mbs.AddSensor(
        items.SensorNode(nodeNumber=nodes[-1], outputVariableType=exu.OutputVariableType.Position, storeInternal=True)
    )
    return exu, mbs, tip


# -- runs ---------------------------------------------------------------------------------------------------------------
def ours(make, mesh, h, steps):
    """CPU time of a run and its tip at ten instants, (10, 3)."""
    scene = make(*mesh)
    begin = time.process_time()
    output = fmbd.Output(every=steps // 10)
    run = fmbd.solve(scene, t_end=steps * h, dt=h, scheme=fmbd.GeneralizedAlpha(RHO), output=output)
    return time.process_time() - begin, run["tip"][1:]


def theirs(make, elements, h, steps, modified, sparse):
    """The same by Exudyn."""
    exu, mbs, tip = make(elements)
    mbs.Assemble()
    spent = exudyn_steps((exu, mbs), steps, h, modified=modified, sparse=sparse)
    return spent, np.array(mbs.GetSensorStoredData(tip))[-10:, 1:4]


SCENES = {
    # scene: ours, theirs, finest mesh, meshes of both (coarse to fine), step, steps, error asked for (m)
    "right-angle frame": (
        frame, frame_exudyn, (4, 3), [(1, 2), (1, 3), (2, 2), (2, 3), (3, 3)], [4, 8, 16, 32], 0.02, 200, 0.012,
    ),
    "hanging cable": (
        cable, cable_exudyn, (40, 3), [(6, 3), (8, 3), (12, 3), (16, 3), (24, 3)], [16, 24, 32, 50], 1e-3, 400, 6.5e-6,
    ),
}  # fmt: skip


def compare(name, repeat):
    """One row of the table."""
    make, make_exudyn, finest, meshes, counts, h, steps, asked = SCENES[name]
    exact = ours(make, finest, h / 4, 4 * steps)[1]

    def rms(found):
        return float(np.sqrt(np.mean(np.sum((found - exact) ** 2, axis=1))))

    row = {"scene": name, "asked, m": asked, "ours": {}, "Exudyn": {}}
    for side, choices in (("ours", meshes), ("Exudyn", counts)):
        for mesh in choices:
            if side == "ours":
                runs = [lambda k, mesh=mesh: ours(make, mesh, h, k * steps)]
            else:
                ways = itertools.product((False, True), (False, True))  # modified or full Newton, dense or sparse
                runs = [lambda k, m=mesh, way=way: theirs(make_exudyn, m, h, k * steps, *way) for way in ways]
            best, error, why = np.inf, np.inf, ""
            for run in runs:
                try:
                    times = [(run(1), run(2)[0]) for _ in range(repeat)]
                except Exception as failure:  # of the peer: its fastest way that works counts
                    why = str(failure)
                    continue
                error = rms(times[0][0][1])
                best = min(best, float(np.median([b - a[0] for a, b in times])))
            row[side][str(mesh)] = {"error, m": error, "seconds": best} if best < np.inf else {"failed": why}
    for side in ("ours", "Exudyn"):
        reached = [x["seconds"] for x in row[side].values() if x.get("error, m", np.inf) <= asked]
        row[f"{side}, s"] = min(reached, default=float("nan"))
    row["ratio"] = row["ours, s"] / row["Exudyn, s"]
    return row


def main():
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="*", default=list(SCENES))
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rows = [compare(name, given.repeat) for name in given.scene or SCENES]
    print(json.dumps(rows, indent=1))
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
