"""A reduced body exported to a file and run in Exudyn: the same motion as here, to what the steps allow.

Run:  PYTHONPATH=... ./with-dolfinx python3 tests/benchmarks/exported_exudyn.py [--picture FILE] [--json FILE]

Needs exudyn (1.13.6 was used) beside this package. A bar with ten free modes hangs on a spherical joint and is thrown with
an angular velocity about all three axes. Here: Radau IIA with five stages (order 9), constant steps. There: generalized-alpha,
rho_inf = 0.9, at five steps, and the limit of its steps by extrapolation in h^2, h^3 and h^4. The tip is compared at eleven
instants over 0.5 s.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

import fmbd_fenicsx as fmbd

HERE = Path(__file__).parent
GRAVITY = (0.0, 0.0, -9.81)
SPIN = np.array((0.4, 0.8, 1.5))  # rad/s, about the pin at the origin
PUSH = np.cross(SPIN, (0.5, 0.0, 0.0))  # m/s of the centre
T_END, COUNT = 0.5, 10
STEPS = (5e-4, 2.5e-4, 1.25e-4, 6.25e-5, 3.125e-5)


def arm(mass_damping=0.0, stiffness_damping=0.0):
    """The bar by ten free modes, 5 to 50 Hz."""
    mesh = fmbd.read_gmsh(HERE / "bar_mesh.py", along=10, across=1)
    body = fmbd.FloatingBody(
        "bar",
        mesh,
        density=1000.0,
        elastic=fmbd.materials.linear_elastic(1e7, 0.3),
        velocity=tuple(PUSH),
        angular_velocity=tuple(SPIN),
        mass_damping=mass_damping,
        stiffness_damping=stiffness_damping,
    )
    return body.reduced(modes=10)


def ours(body, h=1e-3):
    """The tip at the instants, (11, 3)."""
    scene = fmbd.Scene("exported bar", gravity=GRAVITY)
    scene.add(body, fmbd.spherical("pin", fmbd.ground, body.surface("pin")))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    run = fmbd.solve(scene, t_end=T_END, dt=h, scheme=fmbd.Radau(5, rtol=None))
    return run["tip"][:: round(T_END / COUNT / h)]


def settings(h):
    """Generalized-alpha of Exudyn with tight Newton iterations."""
    import exudyn as exu

    found = exu.SimulationSettings()
    steps = found.timeIntegration
    steps.numberOfSteps, steps.endTime, steps.verboseMode = round(T_END / h), T_END, 0
    steps.generalizedAlpha.spectralRadius = 0.9
    steps.newton.useModifiedNewton = True
    steps.newton.relativeTolerance, steps.newton.absoluteTolerance = 1e-11, 1e-13
    found.linearSolverType = exu.LinearSolverType.EXUdense
    found.solutionSettings.writeSolutionToFile = False
    found.solutionSettings.sensorsWritePeriod = T_END / COUNT
    return found


def theirs(file, at, h, **damping):
    """The tip in Exudyn from the file, the centre of the body and the centre of its pin, (11, 3)."""
    import exudyn as exu
    import exudyn.itemInterface as ii  # noqa: N813
    from exudyn.FEM import ObjectFFRFreducedOrderInterface

    mbs, body = exu.SystemContainer().AddSystem(), ObjectFFRFreducedOrderInterface()
    body.LoadFromFile(str(file))
    found = body.AddObjectFFRFreducedOrder(
        mbs,
        positionRef=list(at[0]),
        initialVelocity=list(PUSH),
        initialAngularVelocity=list(SPIN),
        gravity=list(GRAVITY),
        **damping,
    )["oFFRFreducedOrder"]

    # interface k: node 7 k is its centre
    pin, tip = (
        mbs.AddMarker(ii.MarkerSuperElementPosition(bodyNumber=found, meshNodeNumbers=[7 * k], weightingFactors=[1.0]))
        for k in (0, 1)
    )
    ground = mbs.AddObject(ii.ObjectGround())
    hook = mbs.AddMarker(ii.MarkerBodyPosition(bodyNumber=ground, localPosition=list(at[1])))
    mbs.AddObject(ii.SphericalJoint(markerNumbers=[hook, pin]))
    kind = exu.OutputVariableType.Position
    sensor = mbs.AddSensor(
        ii.SensorMarker(markerNumber=tip, outputVariableType=kind, storeInternal=True, writeToFile=False)
    )
    mbs.Assemble()
    mbs.SolveDynamic(settings(h))
    return mbs.GetSensorStoredData(sensor)[:, 1:]


def limit(runs):
    """Runs at halved steps extrapolated: the terms in h^2, h^3 and h^4 removed one after another."""
    for power in (2, 3, 4)[: len(runs) - 1]:
        runs = [(2**power * b - a) / (2**power - 1) for a, b in zip(runs, runs[1:], strict=False)]
    return runs[-1]


def compare(sizes=STEPS, **damping):
    """Rows (h, largest difference of the tip, m), and the difference of the limit of steps."""
    body = arm(**damping)
    model = fmbd.interface_model(body, ("pin", "tip"))
    factors = {
        "massProportionalDamping": damping.get("mass_damping", 0.0),
        "stiffnessProportionalDamping": damping.get("stiffness_damping", 0.0),
    }
    with tempfile.TemporaryDirectory() as folder:
        file = model.save_exudyn(Path(folder) / "arm.npz")
        runs = [theirs(file, (model.center, model.origins[0]), h, **factors) for h in sizes]
    here = ours(body)
    rows = [(h, float(np.abs(run - here).max())) for h, run in zip(sizes, runs, strict=True)]
    return rows, float(np.abs(limit(runs) - here).max()), float(np.abs(here - ours(body, 5e-4)).max())


def draw(rows, rest, file):
    """Differences over the step of Exudyn, and that of the limit."""
    import matplotlib.pyplot as plt

    h, error = np.array(rows).T
    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    axes.loglog(h, error, "o-", label="generalized-alpha in Exudyn at step $h$")
    axes.loglog(h, error[0] * (h / h[0]) ** 2, "k:", label="slope 2")
    axes.axhline(rest, color="C1", label=f"its limit $h$ to 0: {rest:.1e} m")
    axes.set(
        title="A reduced body exported to Exudyn: ten modes, thrown on a spherical joint",
        xlabel="step $h$ of Exudyn (s)",
        ylabel="largest difference of the tip over 0.5 s (m)",
    )
    axes.title.set_fontsize("medium")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(file, dpi=120)


def main():
    """Compare, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture")
    parser.add_argument("--json")
    given = parser.parse_args()
    rows, rest, own = compare()
    for h, difference in rows:
        print(f"h = {h:.3e} s: largest difference of the tip {difference:.2e} m")
    print(f"limit of steps: {rest:.2e} m; ours with half the step: {own:.2e} m")
    if given.picture:
        draw(rows, rest, given.picture)
    if given.json:
        Path(given.json).write_text(json.dumps({"rows": rows, "limit": rest, "own": own}))


if __name__ == "__main__":
    main()
