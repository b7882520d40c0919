"""Geometry that pictures are made of, on any number of ranks, and what they show."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import plot
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.post import figures
from fmbd_fenicsx.post.drawing.draw import draw
from fmbd_fenicsx.post.drawing.render import Renderer, strobe
from fmbd_fenicsx.post.drawing.scene_graph import Drawing
from fmbd_fenicsx.post.plot import draw_history

STEEL = fmbd.materials.linear_elastic(5e6, 0.3)


def swing(rod_mesh, snapshots=3):
    rod = fmbd.FloatingBody("rod", rod_mesh(), degree=2, density=1e3, elastic=STEEL)
    bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(1.5, 0))
    scene = fmbd.Scene("swing", gravity=(0, -9.81))
    scene.add(rod, bob, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    scene.add(fmbd.revolute("link", rod.surface("tip"), bob, center=(1, 0)))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    return fmbd.solve(scene, t_end=0.4, dt=0.02, output=fmbd.Output(snapshots=snapshots))


@pytest.mark.smoke
@pytest.mark.mpi
def test_nodes_are_placed_where_the_sensors_say(rod_mesh):
    run = swing(rod_mesh)
    rod = next(p for p in draw(run).pieces if p.name == "rod")
    if run.system.comm.rank == 0:
        x = rod.at(2)
        near = np.linalg.norm(x[:, :2] - run["tip"][-1], axis=1).min()
        assert near < 0.02, "a node lies beside the mean of the tip surface"
        assert x.shape[1] == 3 and np.all(x[:, 2] == 0)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [fmbd.FloatingBody, fmbd.AbsoluteBody])
def test_both_placements_draw_a_resting_body_where_its_mesh_lies(rod_mesh, kind):
    rod = kind("rod", rod_mesh(), degree=2, density=1e3, elastic=STEEL)
    scene = fmbd.Scene("rest")
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    run = fmbd.solve(scene, t_end=0.1, dt=0.1, output=fmbd.Output(snapshots=2))
    found = next(p for p in draw(run).pieces if p.name == "rod")
    if run.system.comm.rank == 0:
        x = found.at(1)
        assert x.min(0) == pytest.approx([0, -0.05, 0], abs=1e-12) and x.max(0) == pytest.approx([1, 0.05, 0])


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
def test_painted_triangles_have_the_values_of_their_middles(rod_mesh, degree):
    how = {"elastic": STEEL, "displacement": lambda X: np.array([X[0] ** degree, 0 * X[1]])}
    rod = fmbd.AbsoluteBody("rod", rod_mesh(), degree=degree, density=1e3, **how)
    scene = fmbd.Scene("stretched")
    scene.add(rod)
    run = fmbd.solve(scene, t_end=1e-9, dt=1e-9, output=fmbd.Output(snapshots=2))
    found = next(p for p in draw(run, paint=fmbd.Paint(lambda u: u[0].dx(0), "strain (-)")).pieces if p.name == "rod")
    field = run.system.parts[0].field
    nodes = np.concatenate(field.comm.allgather(field.X))
    middles = nodes[found.triangles][:, :, 0].mean(1) + field.center[0]
    assert found.paint[0] == pytest.approx(1.0 if degree == 1 else 2 * middles, abs=1e-7)


@pytest.mark.serial
def test_picture_shows_each_snapshot_in_its_colour(rod_mesh):
    pytest.importorskip("pyvista")
    run = swing(rod_mesh)
    colors = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    view = strobe(draw(run), fmbd.View(), colors, width=600)
    x0, x1, y0, y1 = view.extent
    rows, columns = view.image.shape[:2]
    for color, state in zip(colors, run.snapshots, strict=True):
        center = state.q[:2]  # of mass of the rod
        row, column = int((y1 - center[1]) / (y1 - y0) * rows), int((center[0] - x0) / (x1 - x0) * columns)
        pixel = view.image[row, column].astype(float)
        assert np.argmax(pixel) == np.argmax(color) and pixel.max() > 2 * np.sort(pixel)[1]


@pytest.mark.smoke
@pytest.mark.mpi
def test_files_are_written_by_rank_0(rod_mesh, shared_tmp):
    pytest.importorskip("pyvista")
    run = swing(rod_mesh)
    for name, write in {
        "a.png": lambda f: run.picture(f, sensors="tip"),
        "b.pdf": lambda f: run.picture(f),
        "c.png": lambda f: run.plot(file=f),
        "d.png": lambda f: run.plot("tip y", file=f, reference={"tip y": lambda t: -t}),
    }.items():
        write(shared_tmp / name)
        run.system.comm.barrier()
        assert (shared_tmp / name).stat().st_size > 5000


@pytest.mark.mpi
def test_mistakes_are_told_on_all_ranks(rod_mesh, shared_tmp):
    run = swing(rod_mesh, snapshots=0)
    with pytest.raises(InputError, match="snapshots"):
        run.animate(shared_tmp / "a.gif")
    with pytest.raises(InputError, match='Did you mean "tip"'):
        run.plot("tipp", file=shared_tmp / "a.png")
    with pytest.raises(InputError, match="cannot be written"):
        run.plot("tip", file=shared_tmp / "missing folder" / "a.png")


@pytest.mark.serial
def test_series_are_named_by_sensor_or_component_and_drawn_over_what_is_known(rod_mesh):
    run = swing(rod_mesh)
    axes = Figure().subplots()
    draw_history(axes, run, "tip", lambda t: (t, 2 * t))
    exact, x, y = (next(c for c in axes.lines if c.get_label() == n) for n in ("reference", "tip x", "tip y"))
    assert (x.get_ydata() == run["tip"][:, 0]).all() and (y.get_ydata() == run["tip"][:, 1]).all()
    assert (exact.get_ydata() == run.times).all() and exact.get_zorder() < x.get_zorder()
    assert (run["tip y"] == run["tip"][:, 1]).all()
    axes = Figure().subplots()
    draw_history(axes, run, "tip y", (0.1, -0.5))
    marks, y = axes.lines
    assert (marks.get_xdata(), marks.get_ydata()) == ([0.1], [-0.5]) and marks.get_marker() == "x"
    assert (y.get_ydata() == run["tip"][:, 1]).all() and axes.get_ylabel() == "tip y (m)"
    with pytest.raises(InputError, match='No sensor "tip z"'):
        draw_history(axes, run, "tip z")


@pytest.mark.serial
def test_components_have_the_names_of_axes_or_coordinates_or_numbers():
    scene = fmbd.Scene("named")
    scene.add(fmbd.CoordinateBody("mass", np.eye(3), lambda q, v, t: 0 * q, np.zeros(3)))
    scene.sensor("q", fmbd.coordinates("mass", unit="m", names=("left", "right")))
    run = fmbd.solve(scene, t_end=0.1, dt=0.1)
    assert run.components("q") == ["q left", "q right", "q 3"] and run.scene.sensors["q"].unit == "m"


@pytest.mark.mpi
def test_shapes_lie_where_the_bodies_are(rod_mesh):
    run = swing(rod_mesh)
    axes = Figure().subplots()
    plot.shapes(axes, run)
    if run.system.comm.rank == 0:
        drawn = [c.get_datalim(axes.transData) for c in axes.collections]
        assert len(drawn) == len(run.snapshots)
        rod = next(p for p in draw(run).pieces if p.name == "rod")
        for k, box in enumerate(drawn):
            x = rod.at(k)
            assert (box.min, box.max) == (pytest.approx(x.min(0)[:2]), pytest.approx(x.max(0)[:2]))
        assert axes.get_aspect() == 1.0
    else:
        draw(run)


@pytest.mark.serial
def test_own_axes_get_a_legend_that_lies_on_no_curve(tmp_path):
    with plot.figure(tmp_path / "two.png", 1, 2) as (left, right):
        left.plot([0, 1], [0, 1], label="one")
        left.plot([0, 1], [1, 0], label="two")
        right.plot([0, 1], [0, 1], label="alone")
    assert left.get_legend().get_window_extent().y0 >= left.get_window_extent().y1 and right.get_legend() is None
    assert (tmp_path / "two.png").stat().st_size > 5000


def test_energy_and_momenta_of_a_run(rod_mesh):
    run = swing(rod_mesh)
    assert run.total_energy == pytest.approx(sum(run.energy.values()), rel=1e-14)
    start, end = (run.momenta(s)[0] for s in (run.snapshots[0], run.state))
    assert np.abs(start).max() == 0.0 and (run.momenta()[0] == end).all() and end[1] < 0.0


@pytest.mark.serial
def test_a_figure_has_its_title_above_all_axes(tmp_path):
    with plot.figure(tmp_path / "titled.png", 1, 2, title="two ways") as (left, _):
        left.plot([0, 1], [0, 1])
    drawn = [text for text in left.figure.findobj(Text) if text.get_text() == "two ways"]
    assert len(drawn) == 1 and drawn[0].get_window_extent().y0 >= left.get_window_extent().y1


@pytest.mark.serial
def test_of_several_instants_in_space_the_last_is_opaque(monkeypatch):
    pytest.importorskip("pyvista")
    shown = []
    monkeypatch.setattr(Renderer, "add", lambda self, k, **how: shown.append((how["opacity"], how["moving"])))
    body = fmbd.RigidBody("body", 1.0, (0.1, 0.1, 0.1), velocity=(1.0, 0.0, 0.0))
    scene = fmbd.Scene("flight")
    scene.add(body)
    run = fmbd.solve(scene, t_end=0.2, dt=0.1, output=fmbd.Output(snapshots=3))
    strobe(draw(run), fmbd.View(), None, width=200)
    assert [moving for _, moving in shown] == [True, True, False]
    assert [opacity == 1.0 for opacity, _ in shown] == [False, False, True]


def test_a_drawing_of_nothing_has_a_box():
    low, high = Drawing("empty", 3, np.array([0.0, 0.0, 1.0]), np.zeros(1), ()).bounds()
    assert low.shape == high.shape == (3,) and (low < high).all()


@pytest.mark.serial
@pytest.mark.parametrize("top", [1.1, 1.6, 4.0, 30.0, 1e6])
def test_ticks_of_logarithmic_axes_are_some_and_apart(top, tmp_path):
    """Labels of axes of little more than a factor lay on each other."""
    with plot.figure(tmp_path / "log.png", 1, 3) as axes:
        for one in axes:
            one.loglog([0.3, 0.3 * top], [0.3, 0.3 * top])
    for one in axes:
        low, high = one.get_xlim()
        labels = [x for x in one.get_xticklabels() if low <= x.get_position()[0] <= high and x.get_text()]
        boxes = sorted((x.get_window_extent() for x in labels), key=lambda box: box.x0)
        assert len(boxes) >= 2 and all(a.x1 < b.x0 for a, b in zip(boxes[:-1], boxes[1:], strict=True))


@pytest.mark.serial
@pytest.mark.parametrize("name", ["x", "coordinates q1"])
def test_a_label_is_no_longer_than_its_axes(name, tmp_path):
    """The unit stands below the name where both have no room beside each other."""
    with plot.figure(tmp_path / "low.png", 3, 1, size=(5.0, 6.3)) as axes:
        for one in axes:
            figures.set_label(one, name, "m, rad")
    for one in axes:
        assert one.yaxis.label.get_window_extent().height < 1.02 * one.get_window_extent().height
    assert axes[0].get_ylabel() == {"x": "x (m, rad)", "coordinates q1": "coordinates q1\n(m, rad)"}[name]
