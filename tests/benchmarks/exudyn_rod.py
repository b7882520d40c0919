"""An elastic bar on a spherical joint in Exudyn, timed; run by rod_vs_exudyn.py with an interpreter that has exudyn.

python exudyn_rod.py full|reduced|modes FILE STEPS H  ->  one line of JSON

FILE (npz) holds mass and stiffness matrix, nodes, the averaging weights of the surfaces and the modes. Per-step times of
``full`` are those between two steps, without the first, whose Jacobian by differences alone takes minutes.
"""

import json
import sys
import time

sys.exudynFast = True  # the build without range checks
import exudyn as exu  # noqa: E402
import exudyn.itemInterface as ii  # noqa: E402, N813
import numpy as np  # noqa: E402
import scipy.sparse as sp  # noqa: E402
from exudyn.FEM import FEMinterface, ObjectFFRFinterface, ObjectFFRFreducedOrderInterface  # noqa: E402
from exudyn_side import settings  # noqa: E402


def interface(data):
    """Exudyn's view of the finite element model."""
    n = 3 * len(data["nodes"])
    fem = FEMinterface()
    fem.nodes = {"Position": data["nodes"]}
    fem.massMatrix, fem.stiffnessMatrix = (
        sp.csr_matrix((data[f"{k}_data"], data[f"{k}_cols"], data[f"{k}_start"]), shape=(n, n)) for k in "MK"
    )
    fem.modeBasis = {"matrix": data["modes"], "type": "NormalModes"}
    fem.eigenValues = data["eigenvalues"]
    return fem


def body_of(mbs, kind, data):
    """The bar as ObjectFFRF or ObjectFFRFreducedOrder, under gravity."""
    gravity, fem = data["gravity"], interface(data)
    if kind == "full":
        found = ObjectFFRFinterface(fem).AddObjectFFRF(exu, mbs, positionRef=list(data["centre"]))
        weight = fem.massMatrix @ np.tile(gravity, len(data["nodes"]))
        total = weight.reshape(-1, 3).sum(0)
        # mass-proportional loads of 1.13.6 leave out the elastic coordinates; the force vector does not
        mbs.SetObjectParameter(found["oFFRF"], "forceVector", np.concatenate((total, np.zeros(4), weight)))
        return found["oFFRF"]
    cms = ObjectFFRFreducedOrderInterface(fem)
    return cms.AddObjectFFRFreducedOrder(mbs, positionRef=list(data["centre"]), gravity=list(gravity))[
        "oFFRFreducedOrder"
    ]


def model(kind, data):
    """The pendulum; returns it and the marker of the tip."""
    mbs = exu.SystemContainer().AddSystem()
    body = body_of(mbs, kind, data)
    markers = []
    for name in ("pin", "tip"):
        nodes, weights = data[f"{name}_nodes"], data[f"{name}_weights"]
        used = np.abs(weights) > 1e-12
        markers.append(
            mbs.AddMarker(
                ii.MarkerSuperElementPosition(
                    bodyNumber=body, meshNodeNumbers=nodes[used], weightingFactors=weights[used]
                )
            )
        )
    ground = mbs.AddObject(ii.ObjectGround())
    at = mbs.AddMarker(ii.MarkerBodyPosition(bodyNumber=ground, localPosition=list(data["pin_at"])))
    mbs.AddObject(ii.SphericalJoint(markerNumbers=[at, markers[0]]))
    mbs.Assemble()
    return mbs, markers[1]


def run(kind, data, steps, h, modified):
    """Seconds of the steps, the tip at the end, iterations per step."""
    mbs, tip = model(kind, data)
    s = settings(exu, steps, h, modified=modified, sparse=kind == "full", records=1)
    stamps = []
    if kind == "full":
        mbs.SetPreStepUserFunction(lambda mbs, t: stamps.append(time.process_time()) or True)
    solver = exu.MainSolverImplicitSecondOrder()
    solver.InitializeSolver(mbs, s)
    begin = time.process_time()
    solver.SolveSteps(mbs, s)
    end = time.process_time()
    iterations = solver.it.newtonStepsCount / steps
    solver.FinalizeSolver(mbs, s)
    stamps.append(end)
    seconds = float(np.median(np.diff(stamps[1:]))) if kind == "full" else (end - begin) / steps
    where = mbs.GetMarkerOutput(tip, exu.OutputVariableType.Position)
    first = stamps[1] - begin if kind == "full" else 0.0
    return {"seconds": seconds, "first": first, "end": list(where), "iterations": iterations, "modified": modified}


def modes(data):
    """Seconds for the modes and for the reduced object's constants."""
    fem, begin = interface(data), time.process_time()
    fem.ComputeEigenmodes(data["modes"].shape[1], excludeRigidBodyModes=6)
    middle = time.process_time()
    ObjectFFRFreducedOrderInterface(fem)
    return {"modes": middle - begin, "constants": time.process_time() - middle}


def main():
    """Time one model; the reduced one in its fastest setting of two (full or modified Newton)."""
    kind, file, steps, h = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
    data = np.load(file)
    if kind == "modes":
        print(json.dumps(modes(data)))
        return
    if kind == "full":
        print(json.dumps(run(kind, data, steps, h, True)))
        return
    runs = [run(kind, data, steps, h, modified) for modified in (False, True)]
    print(json.dumps(min(runs, key=lambda r: r["seconds"])))


if __name__ == "__main__":
    main()
