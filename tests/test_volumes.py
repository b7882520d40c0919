"""Bodies of several materials: named volumes of one mesh, in forms, energies, loads and densities."""

import numpy as np
import pytest
from ufl import grad, inner, sym

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError, MeshError
from fmbd_fenicsx.fem.mixed import make_field
from fmbd_fenicsx.mechanics.elastic.modes import bound_by_soft_parts

SCRIPT = '''
def build(gmsh, length=2.0, height=0.1, h=0.1, stacked=False, shared=False):
    """Two equal rectangles, one after the other, or one above the other: the volumes "one" and "two"."""
    occ = gmsh.model.occ
    if stacked:
        parts = [occ.addRectangle(0, -height, 0, length, height), occ.addRectangle(0, 0, 0, length, height)]
    else:
        parts = [occ.addRectangle(k * length / 2, 0, 0, length / 2, height) for k in (0, 1)]
    occ.fragment([(2, parts[0])], [(2, parts[1])])
    occ.synchronize()
    for k, name in enumerate(("one", "two")):
        gmsh.model.addPhysicalGroup(2, parts if shared else [parts[k]], name=name)
    ends = {"left": [], "right": []}
    for _, curve in gmsh.model.getEntities(1):
        x = occ.getCenterOfMass(1, curve)[0]
        if x < 1e-6 or x > length - 1e-6:
            ends["left" if x < 1e-6 else "right"].append(curve)
    for name, curves in ends.items():
        gmsh.model.addPhysicalGroup(1, curves, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", h)
    gmsh.model.mesh.generate(2)
'''

BOTH = ("one", "two")
E = {"one": 2e6, "two": 5e6}
RHO = {"one": 1000.0, "two": 3000.0}


@pytest.fixture
def script(tmp_path):
    path = tmp_path / "parts.py"
    path.write_text(SCRIPT)
    return path


def hooke(mesh, nu=0.0):
    """Hooke's law with the modulus of each volume."""
    laws = {name: fmbd.materials.plane_stress(modulus, nu) for name, modulus in E.items()}

    def elastic(u, v, dx):
        return sum(law(u, v, dx(mesh.volume_tag(name))) for name, law in laws.items())

    return elastic


def stretched(body):
    """How far the right end goes under 1e3 N/m^2 along the bar, m."""
    scene = fmbd.Scene("bar")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
    scene.sensor("end", fmbd.position(body.surface("right")))
    return fmbd.equilibrium(scene)["end"]


@pytest.mark.mpi
@pytest.mark.parametrize("quadrature", [None, 4])
def test_bar_in_series(script, quadrature):
    mesh = fmbd.read_gmsh(script, volume=BOTH)
    pull = fmbd.loads.traction("right", (1e3, 0.0))
    body = fmbd.AbsoluteBody("bar", mesh, density=RHO, elastic=hooke(mesh), loads=[pull], quadrature=quadrature)
    found = stretched(body)
    assert found[0] - 2.0 == pytest.approx(1e3 * (1.0 / E["one"] + 1.0 / E["two"]), rel=1e-9)
    assert mesh.volume == "one + two"


@pytest.mark.mpi
def test_where_the_mesh_is_placed(script):
    mesh = fmbd.read_gmsh(script, volume=BOTH)
    there = mesh.placed((1.0, 2.0), np.pi / 2)
    pull = fmbd.loads.traction("right", (0.0, 1e3))
    body = fmbd.AbsoluteBody("bar", there, density=RHO, elastic=hooke(there), loads=[pull])
    assert stretched(body)[1] - 4.0 == pytest.approx(1e3 * (1.0 / E["one"] + 1.0 / E["two"]), rel=1e-9)


@pytest.mark.mpi
def test_mass_and_its_centre(script):
    mesh = fmbd.read_gmsh(script, volume=BOTH)
    body = fmbd.FloatingBody("bar", mesh, density=RHO, elastic=hooke(mesh))
    scene = fmbd.Scene("bar")
    scene.add(body)
    field = scene.build()[0].parts[0].field
    assert field.mass_total == pytest.approx(0.1 * (1000.0 + 3000.0), rel=1e-12)
    assert field.center == pytest.approx([1.25, 0.05], rel=1e-12)
    assert field.mean_density == pytest.approx(2000.0, rel=1e-12)
    assert field.inertia[0, 0] == pytest.approx(400.0 * (1 / 12 + 0.01 / 12 + 0.75 * 0.25), rel=1e-12)


def heated_strip(script, placement):
    """End of a clamped strip of equal layers whose layer "two" is warm, over that of Timoshenko: modulus ratio n, curvature
    24 dT (alpha_2 - alpha_1) / (h (14 + n + 1 / n)).
    """
    mesh = fmbd.read_gmsh(script, volume=BOTH, stacked=True, length=4.0, h=0.05)
    rise = 1e-4  # alpha dT of the layer "two"

    def hot(v, dx, ds):
        return E["two"] * rise * inner(sym(grad(v))[0, 0], 1.0) * dx(mesh.volume_tag("two"))

    body = placement(mesh, fmbd.Load(hot, internal=True))
    scene = fmbd.Scene("strip")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
    scene.sensor("end", fmbd.position(body.surface("right")))
    n = E["two"] / E["one"]
    curvature = 24 * rise / (0.2 * (14 + n + 1 / n))
    return fmbd.equilibrium(scene)["end"][1] / (-curvature * 4.0**2 / 2)


def floating_strip(mesh, *loads):
    return fmbd.FloatingBody("strip", mesh, density=RHO, elastic=hooke(mesh), loads=loads)


def reduced_strip(mesh, *loads):
    return floating_strip(mesh, *loads).reduced(basis=fmbd.CraigBampton(("left", "right"), 4))


def absolute_strip(mesh, *loads):
    def energy(u, dx):
        laws = ((fmbd.materials.sheet_saint_venant_kirchhoff(E[name], 0.0), mesh.volume_tag(name)) for name in BOTH)
        return sum(law(u, dx(tag)) for law, tag in laws)

    return fmbd.AbsoluteBody("strip", mesh, density=RHO, energy=energy, loads=loads)


@pytest.mark.parametrize("placement", [floating_strip, reduced_strip, absolute_strip])
def test_bimetal_strip_bends_as_timoshenko_says(script, placement):
    assert heated_strip(script, placement) == pytest.approx(1.0, rel=5e-3)


def test_stress_that_does_not_turn_with_the_body_is_refused(script):
    mesh = fmbd.read_gmsh(script, volume=BOTH, stacked=True, h=0.2)

    def hot(v, dx, ds):
        return E["two"] * 1e-4 * sym(grad(v))[0, 0] * dx(mesh.volume_tag("two"))

    def couple(v, dx, ds):  # has a moment: no stress
        return (v[1].dx(0) - v[0].dx(1)) * dx

    for placement in (floating_strip, absolute_strip):
        turning, warm = (placement(mesh, fmbd.Load(form)) for form in (couple, hot))
        make_field("strip", mesh, turning.forms()).destroy()
        with pytest.raises(InputError, match="is a stress.*internal=True"):
            make_field("strip", mesh, warm.forms())


def test_energy_in_volumes(script):
    # a bar in series, pulled by an energy that is linear elasticity for such a load
    mesh = fmbd.read_gmsh(script, volume=BOTH, h=0.2)
    energies = {name: fmbd.materials.sheet_saint_venant_kirchhoff(modulus, 0.0) for name, modulus in E.items()}

    def energy(u, dx):
        return sum(law(u, dx(mesh.volume_tag(name))) for name, law in energies.items())

    pull = fmbd.loads.traction("right", (10.0, 0.0))
    body = fmbd.AbsoluteBody("bar", mesh, density=RHO, energy=energy, loads=[pull])
    assert stretched(body)[0] - 2.0 == pytest.approx(10.0 * (1.0 / E["one"] + 1.0 / E["two"]), rel=1e-4)


@pytest.mark.mpi
def test_damping_by_mass_under_energy_momentum(script):
    # alpha M of both volumes: the body slows down as a whole, v = exp(-alpha t)
    mesh = fmbd.read_gmsh(script, volume=BOTH, h=0.2)
    body = fmbd.AbsoluteBody("bar", mesh, density=RHO, elastic=hooke(mesh), mass_damping=0.1, velocity=(1.0, 0.0))
    scene = fmbd.Scene("free")
    scene.add(body)
    scene.sensor("end", fmbd.position(body.surface("right")))
    run = fmbd.solve(scene, t_end=0.02, dt=2e-3, scheme=fmbd.EnergyMomentum())
    assert run["end"][-1, 0] - 2.0 == pytest.approx((1 - np.exp(-0.002)) / 0.1, rel=1e-7)


def test_what_is_refused(script):
    with pytest.raises(MeshError, match=r"several volumes.*volume=\(\.\.\., \.\.\.\)"):
        fmbd.read_gmsh(script)
    with pytest.raises(MeshError, match='no volume "too".*two'):
        fmbd.read_gmsh(script, volume=("one", "too"))
    with pytest.raises(MeshError, match='"one" and "two" share'):
        fmbd.read_gmsh(script, volume=BOTH, shared=True)
    with pytest.raises(InputError, match="several strings"):
        fmbd.read_gmsh(script, volume=3)

    mesh = fmbd.read_gmsh(script, volume=BOTH)
    with pytest.raises(MeshError, match='No volume "tow".*two'):
        mesh.volume_tag("tow")

    def bar(density):
        return fmbd.AbsoluteBody("bar", mesh, density=density, elastic=hooke(mesh))

    with pytest.raises(InputError, match=r"density: none is given for the volumes \['two'\]"):
        bar({"one": 1.0})
    with pytest.raises(InputError, match="density: no volume 'three'.*two"):
        bar({"one": 1.0, "two": 1.0, "three": 1.0})
    with pytest.raises(InputError, match='density of volume "two".*positive'):
        bar({"one": 1.0, "two": -1.0})
    with pytest.raises(InputError, match="density"):
        bar("heavy")


def graded(x):
    """A density of the place that a bar of 2 m has, kg/m^2."""
    return 1000.0 * (1.0 + 3.0 * x[0] ** 2)


@pytest.mark.parametrize("kind", [fmbd.FloatingBody, fmbd.AbsoluteBody])
def test_a_density_of_the_place_weighs_what_its_integral_says(script, kind):
    """int rho = 0.1 (2 + 8) 1000, int rho x = 0.1 (2 + 12) 1000; and a function that is constant is the number."""
    reactions = []
    for density in (graded, 1000.0, lambda x: 1000.0):
        mesh = fmbd.read_gmsh(script, volume=BOTH, h=0.2)
        body = kind("bar", mesh, density=density, elastic=fmbd.materials.plane_stress(1e11, 0.3))
        scene = fmbd.Scene("bar", gravity=(0.0, -9.81))
        scene.add(body, fmbd.fixed("wall", fmbd.ground, body.surface("left"), center=(0, 0)))
        scene.sensor("force", fmbd.reaction_force("wall"))
        scene.sensor("moment", fmbd.reaction_torque("wall"))
        found = fmbd.equilibrium(scene)
        reactions.append((found["force"][1], found["moment"][0]))
    assert reactions[0] == pytest.approx((-9.81 * 1000.0, -9.81 * 1400.0), rel=1e-5)
    assert reactions[1] == pytest.approx(reactions[2], rel=1e-12)


def test_frequencies_with_a_density_and_a_modulus_of_the_place(script):
    """Those of the matrices that DOLFINx makes of the same forms."""
    import scipy.sparse.linalg as sparse
    import ufl
    from dolfinx import fem

    mesh = fmbd.read_gmsh(script, volume=BOTH, h=0.2)
    body = fmbd.FloatingBody("bar", mesh, density=graded, elastic=fmbd.materials.plane_stress(graded, 0.3))
    V = fem.functionspace(mesh.dolfinx, ("Lagrange", 2, (2,)))
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh.dolfinx)
    e, f, nu = sym(grad(u)), sym(grad(v)), 0.3
    stress = graded(x) / (1.0 - nu**2) * ((1.0 - nu) * e + nu * ufl.tr(e) * ufl.Identity(2))
    forms = inner(stress, f) * mesh.dx, graded(x) * inner(u, v) * mesh.dx
    K, M = (fem.assemble_matrix(fem.form(a)).to_scipy().tocsc() for a in forms)
    squares = np.sort(sparse.eigsh(K, 6, M, sigma=-1.0, return_eigenvectors=False))[3:]
    assert body.frequencies(3) == pytest.approx(np.sqrt(squares) / 2 / np.pi, rel=1e-7)


@pytest.mark.parametrize(
    ("density", "words"),
    [
        (lambda: 1.0, "must be a function of 1 argument"),
        (lambda x: x, "expected one number at each place"),
        (lambda x: np.exp(x[0]), "It takes UFL's coordinates"),
        (lambda x: x[0] - 0.5, "It must be positive everywhere"),
    ],
)
def test_densities_of_the_place_that_are_none(script, density, words):
    mesh = fmbd.read_gmsh(script, volume=BOTH, h=0.5)
    with pytest.raises(InputError, match=words):
        scene = fmbd.Scene("bar")
        scene.add(fmbd.FloatingBody("bar", mesh, density=density, elastic=fmbd.materials.plane_stress(1e7, 0.3)))
        scene.build()


@pytest.mark.parametrize(
    "law, nu",
    [
        ("saint_venant_kirchhoff", 0.0),
        ("sheet_saint_venant_kirchhoff", 0.0),
        ("neo_hookean", 0.0),
        ("nearly_incompressible", 0.4),
        ("neo_hookean_mixed", 0.4),
        ("neo_hookean_incompressible", 0.5),
    ],
)
def test_laws_with_a_modulus_of_the_place(script, law, nu):
    """In its small strains a bar stretches by int F (1 - nu^2) / (E A) dx."""
    mesh = fmbd.read_gmsh(script, volume=BOTH, h=0.2)
    made = {"elastic" if law == "nearly_incompressible" else "energy": getattr(fmbd.materials, law)(modulus, nu)}
    body = fmbd.AbsoluteBody("bar", mesh, density=1.0, loads=[fmbd.traction("right", (1.0, 0.0))], **made)
    scene = fmbd.Scene("bar")
    scene.add(body, fmbd.fixed("wall", fmbd.ground, body.surface("left")))
    scene.sensor("end", fmbd.position(body.surface("right")))
    assert fmbd.equilibrium(scene)["end"][0] - 2.0 == pytest.approx(4e-6 * (1 - nu**2), rel=1e-4)


def modulus(x):
    """Pa."""
    return 1e6 / (1.0 + x[0])


@pytest.mark.parametrize("modulus", [lambda: 1e7, lambda x: x, lambda x: np.exp(x[0])])
def test_moduli_of_the_place_that_are_none(script, modulus):
    with pytest.raises(InputError, match="Young's modulus"):
        scene = fmbd.Scene("bar")
        mesh = fmbd.read_gmsh(script, volume=BOTH, h=0.5)
        scene.add(fmbd.FloatingBody("bar", mesh, density=1.0, elastic=fmbd.materials.plane_stress(modulus, 0.3)))
        scene.build()


def test_a_volume_without_material_is_refused(script):
    mesh = fmbd.read_gmsh(script, volume=BOTH)
    one = fmbd.materials.plane_stress(2e6, 0.3)
    body = fmbd.AbsoluteBody("bar", mesh, density=RHO, elastic=lambda u, v, dx: one(u, v, dx(mesh.volume_tag("one"))))
    scene = fmbd.Scene("bar")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
    with pytest.raises(InputError, match="nodes have no stiffness.*each volume"):
        fmbd.solve(scene, t_end=0.01, dt=0.001)


@pytest.mark.parametrize("ratio", [1e11, 1e13])
def test_a_stiffness_lost_in_roundoff_is_told(script, ratio):
    """A soft half that holds one so many times as stiff: the start is no equilibrium, however short the increments are."""
    mesh = fmbd.read_gmsh(script, volume=BOTH, h=0.5)
    laws = {name: fmbd.materials.plane_stress(modulus, 0.0) for name, modulus in (("one", 1.0), ("two", ratio))}

    def elastic(u, v, dx):
        return sum(law(u, v, dx(mesh.volume_tag(name))) for name, law in laws.items())

    load = fmbd.traction("right", (0.0, 1e-7))
    body = fmbd.FloatingBody("bar", mesh, density=1e3, elastic=elastic, loads=[load])
    scene = fmbd.Scene("bar")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
    with pytest.raises(ConvergenceError, match="stiffness may be lost in roundoff"):
        fmbd.equilibrium(scene)


@pytest.mark.parametrize("ratio", [1e4, 1e7])
def test_digits_lost_beside_a_stiff_part_are_told(script, ratio, caplog):
    """A soft half that holds a stiff one, in absolute coordinates, against the same in a floating frame."""
    mesh = fmbd.read_gmsh(script, volume=BOTH)
    laws = {name: fmbd.materials.plane_stress(modulus, 0.0) for name, modulus in (("one", 1.0), ("two", ratio))}

    def elastic(u, v, dx):
        return sum(law(u, v, dx(mesh.volume_tag(name))) for name, law in laws.items())

    def bent(body):
        scene = fmbd.Scene("bar", gravity=(0.0, -1e-9))
        scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("left")))
        scene.sensor("tip", fmbd.position(body.surface("right")))
        return fmbd.equilibrium(scene)["tip"][1] - 0.05

    exact, found = (
        bent(make("bar", mesh, density=1.0, elastic=elastic)) for make in (fmbd.FloatingBody, fmbd.AbsoluteBody)
    )
    rough = abs(found / exact - 1.0) > 1e-5
    assert rough == (ratio > 1e6) == ("roundoff of forces moves bodies by" in caplog.text)


@pytest.mark.parametrize("softer", [0, 1])
def test_first_frequencies_are_bounded_by_soft_parts(script, softer):
    """Free, one half 1e11 times as stiff: the soft one, of 1 m, vibrates by 0.01 (rad/s)^2 held, by 0.42 free."""
    mesh = fmbd.read_gmsh(script, volume=BOTH)
    laws = {name: fmbd.materials.plane_stress(1.0 if k == softer else 1e11, 0.0) for k, name in enumerate(BOTH)}

    def elastic(u, v, dx):
        return sum(law(u, v, dx(mesh.volume_tag(name))) for name, law in laws.items())

    body = fmbd.FloatingBody("bar", mesh, density=1.0, elastic=elastic)
    assert 0.01 < bound_by_soft_parts(make_field("bar", mesh, body.forms())) < 0.42
