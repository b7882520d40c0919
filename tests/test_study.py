"""Observed orders and work-precision: right on made-up errors, on an exact solution, with failures listed."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError
from fmbd_fenicsx.post.study import Configuration, compare, orders, work_precision

SYSTEM = SimpleNamespace(n_q=1, n_lam=0)
SCENE = SimpleNamespace(sensors={"x": SimpleNamespace(unit="m")})


class MadeUp(SimpleNamespace):
    """A run of one sensor with one component."""

    def __getitem__(self, name):
        return self.series[name]

    def components(self, name):
        return [name]


def made_up(order, size=1.0):
    """Runs of x' = 1 from 0 to 1 whose series has the error size h^order sin(t)."""

    def run(h):
        t = np.linspace(0, 1, round(1 / h) + 1)
        series = {"x": (t + size * h**order * np.sin(t))[:, None]}
        return MadeUp(
            times=t,
            series=series,
            system=SYSTEM,
            scene=SCENE,
            scheme=fmbd.GeneralizedAlpha(),
            step_limit=np.inf,
            seconds={"set-up": 0.5, "start": 0.25, "steps": 1 / h},
            counters={"steps": 1 / h},
            reduction_error={},
        )

    return run


EXACT = {"x": lambda t: t}


def free_fall_pendulum(h, rho_inf=0.8):
    bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(1.0, 0.0))
    scene = fmbd.Scene("swing", gravity=(0, -9.81))
    scene.add(bob, fmbd.revolute("pin", fmbd.ground, bob, center=(0, 0)))
    scene.sensor("bob", fmbd.position(bob))
    return fmbd.solve(scene, t_end=0.8, dt=h, scheme=fmbd.GeneralizedAlpha(rho_inf), output=fmbd.Output(energy=False))


@pytest.mark.parametrize("order", [1.0, 2.0, 3.5])
def test_made_up_order_is_found_exactly(order):
    table = orders(made_up(order), [0.1, 0.05, 0.02, 0.01], reference=EXACT)
    assert table.pairwise("x") == pytest.approx([order] * 3)
    assert table.order("x") == pytest.approx(order)
    assert table.errors["x"][-1] == pytest.approx(0.01**order * np.sin(1.0))
    table.assert_order("x", order)
    with pytest.raises(AssertionError, match="finest three"):
        table.assert_order("x", order + 0.2)


def test_steps_that_a_scheme_chooses_have_no_order_in_dt():
    scene = free_fall_pendulum(0.1).scene
    with pytest.raises(InputError, match=r"Radau IIA\(3\), GGL chooses its steps by rtol = 0.0001; .* rtol=None"):
        orders(lambda h: fmbd.solve(scene, t_end=0.8, dt=h, scheme=fmbd.Radau(3, rtol=1e-4)), [0.1, 0.05])
    # of tolerances, and of steps that these only bound by chance, there are
    exact = fmbd.solve(scene, t_end=0.8, scheme=fmbd.Radau(3, rtol=1e-10), output=fmbd.Output(times=[0.4, 0.8]))
    output = fmbd.Output(times=[0.4, 0.8])
    table = orders(
        lambda r: fmbd.solve(scene, t_end=0.8, scheme=fmbd.Radau(3, rtol=r), output=output),
        [1e-3, 1e-5], reference=exact, names=["bob"], parameter="rtol",
    )  # fmt: skip
    assert 0.4 < table.order("bob") < 1.3


def test_orders_of_a_pendulum_for_positions_velocities_and_multipliers():
    table = orders(free_fall_pendulum, [0.04, 0.02, 0.01, 0.005], reference=free_fall_pendulum(0.0005))
    assert list(table.errors) == ["bob", "q", "v", "lam"]
    for name in table.errors:
        table.assert_order(name, 2.0)
        assert table.order(name) < 2.2


def test_orders_of_a_component():
    """Against a run, and against a function of its own name."""
    fine = free_fall_pendulum(0.0025)
    table = orders(free_fall_pendulum, [0.04, 0.02], reference=fine, names=["bob y", "bob"])
    assert 0 < table.errors["bob y"][1] <= table.errors["bob"][1]
    exact = {"bob y": lambda t: np.interp(t, fine.times, fine["bob y"])}
    np.testing.assert_allclose(
        orders(free_fall_pendulum, [0.04, 0.02], reference=exact).errors["bob y"], table.errors["bob y"], rtol=1e-12
    )


def test_table_as_text_and_markdown():
    table = orders(made_up(2.0), [0.1, 0.05], reference=EXACT)
    lines = str(table).splitlines()
    assert lines[0].split() == ["h", "x", "order"] and lines[2].split()[-1] == "2.00"
    assert table.markdown().splitlines()[1] == "| --- | ---: | ---: |"


def test_unusable_studies_are_refused():
    with pytest.raises(InputError, match="fall"):
        orders(made_up(2), [0.1, 0.2], reference=EXACT)
    with pytest.raises(InputError, match='Did you mean "x"'):
        orders(made_up(2), [0.2, 0.1], reference=EXACT, names=["xx"])
    with pytest.raises(InputError, match="no sensor in common"):
        orders(made_up(2), [0.2, 0.1], reference={"y": lambda t: t})


def test_work_precision_lists_failures_and_takes_medians(tmp_path):
    seconds = iter([9.0, 1.0, 3.0, 2.0])  # one run to warm up, three repeats

    def timed(h):
        run = made_up(2)(h)
        run.seconds["steps"] = next(seconds)
        return run

    def broken(h):
        raise ConvergenceError("Newton stopped")

    found = work_precision([Configuration("a", timed, [0.1]), Configuration("b", broken, [0.1, 0.05])], reference=EXACT)
    assert found.points[0].seconds == 2.0 and found.points[0].setup == 0.75
    row = dict(zip(*found.rows()[:2], strict=True))
    assert row["ms/step"] == "200" and row["set-up, s"] == "0.75" and row["newton_iterations"] == ""
    assert found.points[0].errors["x"] == pytest.approx(0.01 * np.sin(1.0))
    assert [p.label for p in found.failures] == ["b", "b"]
    assert "failed: b at 0.05: ConvergenceError: Newton stopped" in str(found)
    found.json(tmp_path / "wp.json")
    assert json.loads((tmp_path / "wp.json").read_text())[0]["label"] == "a"
    with pytest.raises(InputError):
        work_precision([Configuration("c", lambda h: free_fall_pendulum(-h), [0.1])], reference=EXACT)


def test_work_precision_of_two_damping_parameters(tmp_path):
    configurations = [
        Configuration(f"rho {r}", lambda h, r=r: free_fall_pendulum(h, r), [0.02, 0.01]) for r in (0.9, 0.0)
    ]
    found = work_precision(configurations, reference=free_fall_pendulum(0.0005), repeats=1)
    e = {(p.label, p.value): p.errors["bob"] for p in found.points}
    assert e["rho 0.0", 0.01] > e["rho 0.9", 0.01] > 0
    found.figure(tmp_path / "wp.png")
    found.figure(tmp_path / "wp2.pdf", work="newton_iterations")
    assert min(p.stat().st_size for p in tmp_path.iterdir()) > 5000 and found.units == {"bob": "m"}
    assert all(p.counters["steps"] == round(0.8 / p.value) for p in found.points)


def test_compare_formulations_and_mode_counts_in_one_call(rod_mesh):
    rod = fmbd.FloatingBody("rod", rod_mesh(h=0.2), density=1e3, elastic=fmbd.materials.plane_stress(2e7, 0.3))

    def swing(body):
        scene = fmbd.Scene("swing", gravity=(0, -9.81))
        scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin")))
        scene.sensor("tip", fmbd.position(body.surface("tip")))
        return fmbd.solve(scene, t_end=0.2, dt=4e-3, output=fmbd.Output(energy=False, estimate_reduction=True))

    bodies = {"rigid": rod.reduced(modes=0), "4 modes": rod.reduced(modes=4), "floating": rod, "broken": None}

    def run(body):
        if body is None:
            raise ConvergenceError("Newton stopped")
        return swing(body)

    table = compare(run, bodies, reference=swing(rod), names=["tip"], repeats=1)
    rigid, few, full, broken = table.points
    assert (rigid.value, few.value) == (5, 9) and full.value > 100
    assert rigid.errors["tip"] > few.errors["tip"] > full.errors["tip"] == 0
    assert rigid.errors["tip"] <= rigid.stated["tip"] and few.errors["tip"] <= few.stated["tip"] and not full.stated
    assert rigid.setup > 0 and broken.failure
    assert table.rows()[0][:4] == ["variant", "unknowns", "tip", "tip, stated"]
    assert table.rows()[3][3] == "" and table.rows()[4][1:4] == ["", "failed", "failed"]
