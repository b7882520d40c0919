"""Scenes of users against Exudyn 1.13.6: CPU time of a step from the difference of runs of N and 2 N steps, whole runs.

Run:  ./with-dolfinx python3 tests/benchmarks/user_scenes.py [SCENE ...] [--repeat 3] [--json FILE]

Both sides run in one interpreter, which must have exudyn, in turn: set-up cancels in the difference, the load of the machine in
the median of the ratios. Same scheme (generalized-alpha, rho_inf = 0.8), same step, ten records a run, one thread; of Exudyn's
two Newton iterations the faster one counts. Ends must agree to the error of the scheme.
"""

import argparse
import gc
import json
import time
from functools import cache
from pathlib import Path

import numpy as np
from exudyn_side import Exudyn, G, H
from user_models import bricard, chain, crank, governor, mounted, pd_arm, suspension, truck

import fmbd_fenicsx as fmbd

# ---- scenes: ours -> scene, body, point in body axes; theirs -> Exudyn, body, point -----


def planar(n, spring):
    """n links of 0.1 m from the origin along x, with or without a spring-damper on each hinge."""
    scene, before = fmbd.Scene("links", gravity=(0, -G)), fmbd.ground
    for i in range(n):
        link = fmbd.RigidBody(f"{i}", 0.1, 1e-3 / 12, ((i + 0.5) * 0.1, 0.0))
        hinge = fmbd.revolute(f"hinge {i}", before, link, center=(i * 0.1, 0))
        scene.add(link, hinge)
        if spring:
            scene.add(fmbd.joint_spring(f"spring {i}", fmbd.angle(hinge), stiffness=1.0, damping=0.01))
        before = link
    return scene, before, (0.05, 0.0)


def planar_exudyn(n, spring):
    e = Exudyn()
    last, place = e.ground, [0, 0]
    for i in range(n):
        body = e.link([(i + 0.5) * 0.1, 0], 0.1, 1e-3 / 12)
        ends = [e.marker(last, place, True), e.marker(body, [-0.05, 0], True)]
        e.mbs.AddObject(e.items.RevoluteJoint2D(markerNumbers=ends))
        if spring:
            e.mbs.AddObject(e.items.TorsionalSpringDamper(markerNumbers=ends, stiffness=1.0, damping=0.01))
        last, place = body, [0.05, 0]
    return e, last, [0.05, 0, 0]


def on_springs():
    """One body in space on four spring-dampers."""
    body = fmbd.RigidBody("body", 4.0, (0.05 / 3, 0.05 / 3, 0.08 / 3), (0, 0, 0))
    scene = fmbd.Scene("on springs", gravity=(0, 0, -G))
    scene.add(body)
    for i, (x, y) in enumerate(CORNERS):
        ends = (2 * x, 2 * y, 0.5), (x, y, 0.05)
        scene.add(fmbd.Spring(f"{i}", fmbd.ground, body, *ends, stiffness=2000.0, damping=5.0, length=0.4))
    return scene, body, (0.1, 0.1, 0.05)


def on_springs_exudyn():
    e = Exudyn()
    inertia = e.utilities.RigidBodyInertia(4.0, np.diag([0.05 / 3, 0.05 / 3, 0.08 / 3]))
    body = e.mbs.CreateRigidBody(inertia=inertia, gravity=[0, 0, -G])
    for x, y in CORNERS:
        e.mbs.AddObject(
            e.items.SpringDamper(
                markerNumbers=[e.marker(e.ground, [2 * x, 2 * y, 0.5]), e.marker(body, [x, y, 0.05])],
                referenceLength=0.4,
                stiffness=2000.0,
                damping=5.0,
            )
        )
    return e, body, [0.1, 0.1, 0.05]


CORNERS = [(-0.1, -0.1), (-0.1, 0.1), (0.1, -0.1), (0.1, 0.1)]


def pushed():
    """A pendulum with a force that is a Python function of time."""
    scene, link, point = planar(1, False)
    scene.add(fmbd.force("push", link, lambda t: (0.1 * np.sin(20 * t), 0.0), point=(0.05, 0)))
    return scene, link, point


def pushed_exudyn():
    e, body, point = planar_exudyn(1, False)

    def push(mbs, t, load):
        return [0.1 * np.sin(20 * t), 0.0, 0.0]

    e.mbs.AddLoad(e.items.Force(markerNumber=e.marker(body, [0, 0]), loadVector=[0, 0, 0], loadVectorUserFunction=push))
    return e, body, point


def sphere():
    """A sphere thrown on a plane, without loss."""
    body = fmbd.RigidBody("sphere", 1.0, (0.004,) * 3, (0, 0, 5.1), velocity=(0.2, 0, 0))
    scene = fmbd.Scene("sphere", gravity=(0, 0, -G))
    plane = fmbd.Obstacle("plane", fmbd.HalfSpace((0, 0, 0), (0, 0, 1)))
    scene.add(body, fmbd.contact("bounce", fmbd.ball(body, 0.1), plane, restitution=1.0))
    return scene, body, (0.0, 0.0, 0.0)


def sphere_exudyn():
    """Its plane is a sphere of 1e5 m with a penalty."""
    e = Exudyn()
    body = e.body(3, 1.0, 0.004 * np.eye(3), (0, 0, 5.1), (0.2, 0, 0), None)
    ends = [e.marker(body, [0, 0, 0], True), e.marker(e.ground, [0, 0, -1e5], True)]
    data = e.mbs.AddNode(e.items.NodeGenericData(initialCoordinates=[0.0, 0.0, 0.0, 0.0], numberOfDataCoordinates=4))
    e.mbs.AddObject(
        e.items.ObjectContactSphereSphere(
            markerNumbers=ends, nodeNumber=data, spheresRadii=[0.1, 1e5], contactStiffness=1e6
        )
    )
    return e, body, [0.0, 0.0, 0.0]


def modes():
    """A bar by 16 modes on a spherical joint, its tip on a spring-damper."""
    from rod_vs_exudyn import pendulum

    body = bar_and_modes()[1]
    scene, tip = pendulum(body), body.surface("tip")
    scene.add(fmbd.Spring("spring", fmbd.ground, tip, ABOVE, stiffness=50.0, damping=0.5, length=0.4))
    return scene, tip, None


class ModesExudyn:
    """The same by ObjectFFRFreducedOrder, from the matrices, modes and weights of ours."""

    def __init__(self):
        from io import BytesIO

        from rod_vs_exudyn import export

        file = BytesIO()
        export(*bar_and_modes(), file)
        file.seek(0)
        self.data = dict(np.load(file))

    def run(self, steps, body, point, modified, sparse):  # noqa: ARG002, as of other models
        import exudyn as exu
        import exudyn.itemInterface as items  # noqa: N813
        from exudyn_rod import model
        from exudyn_side import exudyn_steps

        mbs, tip = model("reduced", self.data)
        ground = mbs.AddMarker(
            items.MarkerBodyPosition(bodyNumber=mbs.AddObject(items.ObjectGround()), localPosition=ABOVE)
        )
        mbs.AddObject(items.SpringDamper(markerNumbers=[ground, tip], stiffness=50.0, damping=0.5, referenceLength=0.4))
        mbs.Assemble()
        spent = exudyn_steps((exu, mbs), steps, H, modified=modified, sparse=sparse)
        return spent, np.array(mbs.GetMarkerOutput(tip, exu.OutputVariableType.Position))


CORNERS_OF_LINKAGE = ((0.0, 0.0, 0.0), (0.0, 0.6, -0.8), (0.9, 1.0, -0.7), (1.1, 0.2, 0.0))  # m


@cache
def linkage():
    """Three bars by ten modes each, between the corners of a four-bar linkage in space."""
    turned = []
    for i, (a, b) in enumerate(zip(CORNERS_OF_LINKAGE, CORNERS_OF_LINKAGE[1:], strict=False)):
        way = np.subtract(b, a)
        mesh = fmbd.read_gmsh(HERE / "bar_mesh.py", along=10, across=1)
        across = np.linalg.svd(way[None])[2][1:]
        x = mesh.dolfinx.geometry.x
        x[:] = np.array(a) + x @ np.stack((way, *across))  # the bar of 1 m lies along x from the origin
        elastic = fmbd.materials.linear_elastic(1e8, 0.3)
        turned.append(fmbd.FloatingBody(f"bar {i}", mesh, density=1000.0, elastic=elastic).reduced(modes=10))
    return turned


def four_bar():
    """An elastic four-bar linkage with ball joints that falls from rest."""
    scene, bars = fmbd.Scene("four-bar", gravity=(0, 0, -G)), linkage()
    ends = [fmbd.ground, *bars, fmbd.ground]
    scene.add(*bars)
    for i, place in enumerate(CORNERS_OF_LINKAGE):
        a = ends[i] if i == 0 else ends[i].surface("tip")
        b = ends[i + 1] if i == 3 else ends[i + 1].surface("pin")
        scene.add(fmbd.spherical(f"ball {i}", a, b, center=place))
    return scene, bars[1].surface("tip"), None


class FourBarExudyn:
    """The same from exported files: :meth:`InterfaceModel.save_exudyn`."""

    def __init__(self):
        self.models = [fmbd.interface_model(bar, ("pin", "tip")) for bar in linkage()]

    def run(self, steps, body, point, modified, sparse):  # noqa: ARG002, as of other models
        import tempfile

        from exudyn.FEM import ObjectFFRFreducedOrderInterface
        from exudyn_side import exudyn_steps

        e, ends = Exudyn(), []
        for model in self.models:
            with tempfile.TemporaryDirectory() as folder:
                made = ObjectFFRFreducedOrderInterface()
                made.LoadFromFile(str(model.save_exudyn(Path(folder) / "bar.npz")))
            placed = made.AddObjectFFRFreducedOrder(e.mbs, positionRef=list(model.center), gravity=[0, 0, -G])
            number = placed["oFFRFreducedOrder"]
            of = e.items.MarkerSuperElementPosition
            ends += [
                e.mbs.AddMarker(of(bodyNumber=number, meshNodeNumbers=[node], weightingFactors=[1.0]))
                for node in (0, 7)
            ]
        places = [e.marker(e.ground, CORNERS_OF_LINKAGE[i]) for i in (0, 3)]
        for pair in ((places[0], ends[0]), ends[1:3], ends[3:5], (ends[5], places[1])):
            e.mbs.AddObject(e.items.SphericalJoint(markerNumbers=list(pair)))
        e.mbs.Assemble()
        spent = exudyn_steps((e.exu, e.mbs), steps, H, modified=modified, sparse=sparse)
        return spent, np.array(e.mbs.GetMarkerOutput(ends[3], e.exu.OutputVariableType.Position))


NET = (500.0, 0.5, 0.05)  # N/m, N s/m, kg


def net(shape):
    """Places of masses 0.1 m apart, and the pairs of neighbours; those of the first row are held."""
    numbers = np.arange(np.prod(shape)).reshape(shape)
    places = 0.1 * np.array([(*i, 0, 0)[:3] for i in np.ndindex(*shape)])
    axes = range(len(shape))
    pairs = [(np.delete(numbers, -1, k).ravel(), np.delete(numbers, 0, k).ravel()) for k in axes]
    held = set(np.take(numbers, 0, axis=0).ravel().tolist())
    both = np.concatenate([np.stack(x, axis=1) for x in pairs]).tolist()
    return places, [(a, b) for a, b in both if not {a, b} <= held], held


def masses(shape, law=False):
    """Point masses on springs and dampers, which may be laws in Python."""
    k, c, m = NET
    places, pairs, held = net(shape)
    scene, at = fmbd.Scene("net", gravity=(0, 0, -G)), {}
    for i, place in enumerate(places):
        at[i] = fmbd.ground if i in held else fmbd.PointMass(f"{i}", m, tuple(place))
        if i not in held:
            scene.add(at[i])
    of = {"law": lambda s, rate, t: k * s + c * rate} if law else {"stiffness": k, "damping": c}
    for a, b in pairs:
        scene.add(fmbd.Spring(f"{a} {b}", at[a], at[b], places[a], places[b], length=0.1, **of))
    return scene, at[len(places) - 1], np.zeros(3)


def masses_exudyn(shape, law=False):
    k, c, m = NET
    places, pairs, held = net(shape)
    e, marks = Exudyn(), []
    for i, place in enumerate(places):
        if i in held:
            marks.append(e.marker(e.ground, place))
            continue
        node = e.mbs.AddNode(e.items.NodePoint(referenceCoordinates=list(place)))
        body = e.mbs.AddObject(e.items.MassPoint(physicsMass=m, nodeNumber=node))
        marks.append(e.marker(body, [0, 0, 0]))
        e.mbs.AddLoad(e.items.Force(markerNumber=marks[-1], loadVector=[0, 0, -m * G]))

    def effort(mbs, t, i, u, v, stiffness, damping, force):
        return k * u + c * v

    of = {"springForceUserFunction": effort} if law else {}
    for a, b in pairs:
        ends = [marks[a], marks[b]]
        e.mbs.AddObject(e.items.SpringDamper(markerNumbers=ends, referenceLength=0.1, stiffness=k, damping=c, **of))
    return e, body, [0.0, 0.0, 0.0]


HERE = Path(__file__).parent
ABOVE = (1.0, 0.0, 0.5)  # m, where the spring of the bar hangs


@cache
def bar_and_modes():
    """The bar and its reduced body, made once."""
    from rod_vs_exudyn import bar

    body = bar("3075")
    return body, body.reduced(modes=16)


def model(make, *data):
    """Both sides of a mechanism that is described once."""
    return (lambda: make(*data).ours()), (lambda: make(*data).theirs())


ENOUGH = 0.1  # s of CPU time of steps that a difference of two runs needs
SPRING = (0.5, 0.005)  # N m/rad, N m s
SCENES = {  # name: ours, theirs, steps, goal of the ratio, sparse solver there
    "links 10": (lambda: planar(10, False), lambda: planar_exudyn(10, False), 1000, 0.5, False),
    "links 100": (lambda: planar(100, False), lambda: planar_exudyn(100, False), 400, 0.5, True),
    "links 1000": (lambda: planar(1000, False), lambda: planar_exudyn(1000, False), 40, 0.5, True),
    "hinge springs 10": (lambda: planar(10, True), lambda: planar_exudyn(10, True), 1000, 0.5, False),
    "hinge springs 100": (lambda: planar(100, True), lambda: planar_exudyn(100, True), 400, 0.5, True),
    "hinge springs 1000": (lambda: planar(1000, True), lambda: planar_exudyn(1000, True), 40, 0.5, True),
    "space links 10": (*model(chain, 3, 10), 300, 0.5, False),
    "space links 40": (*model(chain, 3, 40), 100, 0.5, True),
    "space links 200": (*model(chain, 3, 200), 30, 0.5, True),
    "space hinge springs 10": (*model(chain, 3, 10, SPRING), 300, 0.5, False),
    "space hinge springs 40": (*model(chain, 3, 40, SPRING), 100, 0.5, True),
    "space hinge springs 200": (*model(chain, 3, 200, SPRING), 30, 0.5, True),
    "body on springs": (on_springs, on_springs_exudyn, 3000, 0.5, False),
    "body on bushings": (*model(mounted), 2000, 0.5, False),
    "Python force": (pushed, pushed_exudyn, 3000, 1.5, False),
    "PD arm, Python laws": (*model(pd_arm), 2000, 1.5, False),
    "driven slider crank": (*model(crank), 2000, 0.5, False),
    "wheel suspension": (*model(suspension), 2000, 0.5, False),
    "truck over a road, Python tyres": (*model(truck), 1000, 1.5, False),
    "flyball governor": (*model(governor), 1000, 0.5, False),
    "Bricard": (*model(bricard), 1000, 0.5, False),
    "16 modes, spring and damper": (modes, lambda: (ModesExudyn(), None, None), 500, 0.5, False),
    "elastic four-bar": (four_bar, lambda: (FourBarExudyn(), None, None), 500, 0.5, False),
    "string of 10 masses": (lambda: masses((11,)), lambda: masses_exudyn((11,)), 1000, 0.5, False),
    "string of 10 masses, Python laws": (
        lambda: masses((11,), True),
        lambda: masses_exudyn((11,), True),
        500,
        1.5,
        False,
    ),
    "cloth of 90 masses": (lambda: masses((10, 10)), lambda: masses_exudyn((10, 10)), 200, 0.5, True),
    "lattice of 100 masses": (lambda: masses((5, 5, 5)), lambda: masses_exudyn((5, 5, 5)), 100, 0.5, True),
    "sphere bouncing on a plane": (sphere, sphere_exudyn, 1000, 0.5, False),
}
# m, where it is not 1e-4: a penalty takes its time to turn a sphere around
AGREE = {"sphere bouncing on a plane": 0.05}


def ours(made, steps):
    """CPU time of a whole run, and the place of a point at its end."""
    scene, body, point = made()
    start = None if point is None else np.asarray(body.start_pose()[: scene.dim], dtype=float) + np.asarray(point)
    scene.sensor("end", fmbd.sensors.position(body, point=start))
    scheme = {"scheme": fmbd.Moreau()} if scene.contacts else {}
    output = fmbd.Output(every=max(steps // 10, 1), progress=False)
    gc.collect()  # a whole collection within a short run would count as one of its steps
    begin = time.process_time()
    run = fmbd.solve(scene, t_end=steps * H, dt=H, output=output, **scheme)
    return time.process_time() - begin, run["end"][-1], run.counters["newton_iterations"] / steps


def theirs(made, steps, sparse):
    """The same in Exudyn."""
    found = []
    for modified in (False, True):
        model, body, point = made()
        found.append(model.run(steps, body, point, modified, sparse))
    return min(found, key=lambda x: x[0])


def compare(name, repeat):
    """One row: microseconds a step on both sides, ratio, difference of the ends."""
    made, other, steps, goal, sparse = SCENES[name]
    ours(made, 10)  # kernels are kept from here on
    rows = []
    for _ in range(repeat):
        (a, _, _), (b, end, iterations) = ours(made, steps), ours(made, 2 * steps)
        more = int(np.clip(ENOUGH / max(b - a, 1e-3), 1, 20)) * steps
        if more > steps:
            (a, _, _), (b, _, _) = ours(made, more), ours(made, 2 * more)
        (c, _), (d, there) = theirs(other, steps, sparse), theirs(other, 2 * steps, sparse)
        rows.append(((b - a) / more * 1e6, (d - c) / steps * 1e6, (2 * a - b) * 1e3))
    mine, exudyn, setup = np.median(rows, axis=0)
    ratio = float(np.median([x / y for x, y, _ in rows]))
    away = float(np.abs(end - there[: len(end)]).max())
    return {
        "scene": name, "us a step": mine, "Exudyn, us": exudyn, "ratio": ratio, "goal": goal, "set-up, ms": setup,
        "iterations": iterations, "difference, m": away, "agree to, m": AGREE.get(name, 1e-4),
    }  # fmt: skip


def main():
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="*", default=list(SCENES))
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()

    rows = []
    for name in given.scene or SCENES:
        row = compare(name, given.repeat)
        rows.append(row)
        print(*(f"{k}: {x:.3g}" if isinstance(x, float) else x for k, x in row.items()), sep="; ", flush=True)
    ratios = np.array([row["ratio"] for row in rows])
    print(f"geometric mean of {len(rows)} ratios: {np.exp(np.log(ratios).mean()):.3g}")
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
