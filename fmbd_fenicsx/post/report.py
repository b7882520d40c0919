"""A run as text: what was done, how accurate it is, what it cost, and what it was made of."""

from __future__ import annotations

import platform
import sys
import textwrap
from collections.abc import Mapping, Sequence
from importlib import import_module, metadata
from typing import TYPE_CHECKING

import numpy as np

from ..energies import Hooke
from ..mechanics.forces.forces import Spring
from ..mechanics.joints.constraints import standstill
from ..notices import WIDTH
from ..run.accuracy.orders import expected_orders
from ..schemes.declared import Declared
from ..system.scene.scene import Scene

if TYPE_CHECKING:
    from ..run.result import Run

LIBRARIES = ("dolfinx", "ufl", "basix", "ffcx", "petsc4py", "mpi4py", "numpy", "scipy", "gmsh")
# of their packages
NAMES = {"dolfinx": "fenics-dolfinx", "ufl": "fenics-ufl", "basix": "fenics-basix", "ffcx": "fenics-ffcx"}


def about() -> str:
    """Versions of this package, of Python and of the libraries that it stands on, and the machine, as lines of text.

    Libraries that are not loaded are looked up without loading them.
    """
    from .. import __version__

    rows = [("fmbd_fenicsx", __version__), ("Python", platform.python_version())]
    rows += [(name, version_of(name)) for name in LIBRARIES]
    rows.append(("system", f"{platform.system()} {platform.release()}, {platform.machine()}"))

    return "\n".join(f"{name:14s}{version}" for name, version in rows)


def version_of(name: str) -> str:
    """Version of a library: as it says itself where it is loaded, else from its package."""
    if name in sys.modules:
        return str(getattr(import_module(name), "__version__", "of unknown version"))
    for package in (NAMES.get(name, name), name):
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return "not found"


def short() -> str:
    """One line for reports: this package, and of the libraries those that the run has loaded."""
    from .. import __version__

    loaded = [f"{name} {version_of(name)}" for name in ("dolfinx", "petsc4py", "numpy") if name in sys.modules]
    return ", ".join([f"fmbd_fenicsx {__version__}", f"Python {platform.python_version()}", *loaded])


LABEL = 18
APART = ("error estimate", "reduction estimate", "space estimate")  # phases behind the run itself
SHOWN = 4  # sensors or phases listed by name
BLOCKS = 8  # blocks of unknowns listed by name


def run_report(run: Run) -> str:
    """Steps, iterations, solves, start, drift, time error, energy ledger, seconds, memory and the plan; not
    collective.
    """
    if Declared.by(run.scheme).timeless:
        return "\n".join([f"{run.scene.name}: {run.scheme.name}, {len(run.times)} instants", *_plan(run)])

    c, (gap, slip), start = run.counters, run.drift, run.correction
    steps = max(int(c["steps"]), 1)
    lines = [f"{run.scene.name}: {run.status} at t = {run.state.t:.6g} s"]
    for warning in run.warnings:
        lines += _entry("look at this", warning)
    lines += _entry("scheme", f"{run.scheme.name}, {_steps(run, steps)}")

    newton = c["newton_iterations"]
    lines += _entry("Newton", f"{newton:.0f} iterations, {newton / steps:.2f} a step")
    lines += _entry("linear solves", _linear(run))
    lines += _entry(
        "consistent start",
        f"positions moved by {start.position:.2g} m, velocities by {start.velocity:.2g} m/s, "
        + _n(start.iterations, "iteration"),
    )
    lines += _entry("constraint drift", f"position {gap:.2g} m, velocity {slip:.2g} m/s")

    if run.not_unique:
        lines += _entry("not unique", "reactions of " + ", ".join(run.not_unique) + "; the smallest are given")
    if c.get("contact_steps"):
        lines += _entry("contact", _contact(c))

    # errors that the run states of itself
    lines += _entry("time error", _time_error(run))
    lines += _reduction_error(run)
    if run.space_error or "space estimate" in run.seconds:
        listed = _listed(run, run.space_error) if run.space_error else ""
        lines += _entry("space error", "; ".join(filter(None, (listed, run.space_unstated))))
    if run.space_error or run.history:
        lines += _entry(
            "certificate",
            "sum of stated errors: " + _listed(run, {s.sensor: s.total for s in run.certificate.statements}),
        )
    lines += [line for k, a in enumerate(run.history) for line in _entry(f"attempt {k + 1}", str(a))]

    if run.energy:
        lines += _ledger(run)
    lines += _entry("seconds", _seconds(run.seconds, steps))
    lines += _entry("peak memory", f"{run.memory / 1e6:.0f} MB" + _ranks(run))
    lines += _entry("made by", short())
    return "\n".join(lines + _plan(run))


def _steps(run: Run, steps: int) -> str:
    """Constant steps, or those that the error control chose and refused."""
    rtol = Declared.by(run.scheme).rtol
    if rtol is None:
        halved = run.counters.get("halved_steps", 0.0)
        return f"h = {run.dt:.6g} s, {steps} steps" + (f", {_n(halved, 'halving')}" if halved else "")
    causes = [f"{n:.0f} for {k.split(': ')[1]}" for k, n in run.counters.items() if k.startswith("rejected: ")]
    rejected = _n(run.counters["rejections"], "rejection") + (f" ({', '.join(causes)})" if causes else "")
    # what a scheme does not count it does not tell
    work = {"jacobians": "tangent", "residuals": "residual"}
    done = [_n(run.counters[key], what) for key, what in work.items() if key in run.counters]
    return ", ".join((f"rtol = {rtol:g}, {steps} steps of {run.dt:.3g} s on average", rejected, *done))


def _n(count: float, what: str) -> str:
    return f"{count:.0f} {what}{'' if count == 1 else 's'}"


def _entry(label: str, text: str) -> list[str]:
    """A label and its text, wrapped under itself."""
    first = f"  {label:<{LABEL}}"
    return textwrap.wrap(text, WIDTH, initial_indent=first, subsequent_indent=" " * len(first)) or [first.rstrip()]


def _linear(run: Run) -> str:
    c = run.counters
    if not run.system.fields:
        done = _n(c["core_factorisations"], "core factorisation")
        return f"{done}, worst relative residual {c['worst_linear_residual']:.1e}"
    return (
        f"{_n(c['factorisations'], 'elastic factorisation')}, {c['back_solves']:.0f} back-solves "
        f"({c['back_solves_per_step']:.2f} a step), {_n(c['core_factorisations'], 'core factorisation')}, "
        f"worst relative residual {c['worst_linear_residual']:.1e}"
    )


def _contact(c: Mapping[str, float]) -> str:
    """How the complementarity problems of a run were solved, and how well."""
    cycles = f", {_n(c['cycles_broken'], 'cycle')} broken" if c["cycles_broken"] else ""
    newton = c["contact_newton_iterations"] / c["contact_steps"]
    sets = f"{_n(c['active_set_iterations'], 'iteration')} on sets with {_n(c['active_set_changes'], 'change')}{cycles}"
    return (
        f"{_n(c['contact_steps'], 'step')} with forces, {newton:.2f} Newton iterations each, {sets}, complementarity to "
        f"{c['complementarity_residual']:.1e} of the largest force"
    )


def _time_error(run: Run) -> str:
    local = f"largest local indicator {run.local_error:.1e} a step"
    if "error estimate" in run.seconds and not run.error_estimate and run.series:
        return f"not estimated: the run with 2 h failed, h is near the largest usable step; {local}"
    if not run.error_estimate:
        return f"not estimated (Output(estimate_error=True) repeats the run with 2 h and 4 h); {local}"
    text = f"estimated from runs with other steps: {_listed(run, run.error_estimate, run.observed_order)}; {local}"
    # an order far below the scheme's own: the estimate rests on it
    expected = expected_orders(run.scheme, run.scene, run.system)
    slow = [expected[n] for n, p in run.observed_order.items() if not p > expected[n] - 0.5]
    return text + (f". Some orders are below {max(slow)}: the step does not resolve all motion" if slow else "")


def _reduction_error(run: Run) -> list[str]:
    """The error by left-out modes; nothing for a run without reduced bodies."""
    if "reduction estimate" not in run.seconds:
        known = any(b.modal and b.meshed for b in run.scene.bodies.values())
        text = "not estimated (Output(estimate_reduction=True) repeats the run with more modes)"
        return _entry("reduction error", text) if known else []
    if not run.reduction_error:
        return []
    return _entry(
        "reduction error", f"estimated from above by a run with more modes: {_listed(run, run.reduction_error)}"
    )


def _listed(run: Run, errors: Mapping[str, float], orders: Mapping[str, float] | None = None) -> str:
    """The sensors with the largest errors, each in its unit and as a share of its range, with an observed order."""
    shares, orders = [], orders or {}
    for name, error in errors.items():
        # against the range of the sensor: the worst come first
        spread = float(np.ptp(run.series[name], axis=0).max(initial=0.0))
        shares.append((error / spread if spread > 0 else 0.0, name, error))
    shares.sort(reverse=True)
    listed = [_share(run, name, error, share, orders.get(name, np.nan)) for share, name, error in shares[:SHOWN]]
    return ", ".join(listed) + (f", {len(shares) - SHOWN} sensors with less" if len(shares) > SHOWN else "")


def _share(run: Run, name: str, error: float, share: float, order: float) -> str:
    """The error of a sensor in its unit and as a share of its range, with the observed order where there is one."""
    seen = f", order {order:.1f}" if np.isfinite(order) else ""
    return f'"{name}" {error:.2g} {run.scene.sensors[name].unit} ({share:.1e} of its range{seen})'


def conservative(scene: Scene) -> bool:
    """Whether the exact motion of a scene keeps the sum of the recorded energies: no loads, drives, damping,
    gravity that changes.
    """
    if scene.gravity_changes:
        return False
    if not all(body.keeps_energy for body in scene.bodies.values()):
        return False
    # drives do work
    if any(row.motion is not standstill for joint in scene.joints.values() for row in joint.rows):
        return False
    # of force elements only linear springs without dampers are recorded as potentials
    return all(isinstance(f, Spring) and f.law is None and f.damping == 0 for f in scene.forces.values())


def _ledger(run: Run) -> list[str]:
    """Energies at start and end and their change; the loss of a conservative scene is numerical."""
    kinds = {k: x for k, x in run.energy.items() if np.any(x)}
    total = sum(run.energy.values())
    assert isinstance(total, np.ndarray)
    # energies are compared with what is exchanged, not with their level
    scale = max((float(np.ptp(x)) for x in kinds.values()), default=0.0)

    lines = [f"  {'energy (J)':<{LABEL}}{'start':>14}{'end':>14}{'change':>14}"]
    for name, x in {**kinds, "total": total}.items():
        x = np.where(np.abs(x) < 1e-12 * scale, 0.0, x)  # roundoff of the weight at its zero level
        lines.append(f"    {name:<{LABEL - 2}}{x[0]:>14.6g}{x[-1]:>14.6g}{x[-1] - x[0]:>14.3g}")

    if conservative(run.scene):
        loss = total[0] - total[-1]
        share = f", {loss / scale:.1e} of the largest exchange" if scale > 0 else ""
        lines += _entry(
            "numerical loss", f"{loss:.3g} J{share}; largest deviation {np.abs(total - total[0]).max():.2g} J"
        )
    else:
        lines += _entry("numerical loss", "not separable: loads, drives, damping or gravity that changes do work here")
    return lines


def _seconds(seconds: Mapping[str, float], steps: int) -> str:
    phases = [f"{name} {s:.3g}" for name, s in seconds.items() if name not in ("total", *APART)]
    text = f"{', '.join(phases)}, total {seconds['total']:.3g}; {1e3 * seconds['steps'] / steps:.3g} ms a step"
    apart = [f"{name} {seconds[name]:.3g}" for name in APART if name in seconds]
    return text + (f"; apart: {', '.join(apart)}" if apart else "")


def _ranks(run: Run) -> str:
    comm = run.system.comm
    return f" (largest of {comm.size} ranks)" if comm is not None and comm.size > 1 else ""


def _plan(run: Run) -> list[str]:
    """The plan, shortened: the largest unknowns by name, the others counted."""
    plan = run.plan
    listed = _shortened(plan.unknowns)
    plane = _in_plane(run.scene)
    elastic = _elastic_bodies(run)
    return [
        *_entry("plan: unknowns", listed),
        *(_entry("elastic bodies", elastic) if elastic else []),
        *(_entry("in the plane", plane) if plane else []),
        *(_entry("elastic blocks", "; ".join(plan.solvers)) if plan.solvers else []),
        *_entry("constant", ", ".join(plan.constant) or "nothing"),
        *_entry("left out", ", ".join(plan.left_out) or "nothing"),
    ]


def _elastic_bodies(run: Run) -> str:
    """How large (diagonal of the box around one) and heavy they are, which shows a mesh in other units than m."""
    found = [(part.name, part.field.size, part.field.mass_total) for _, part in run.system.fields]
    found += [(b.name, b.constants.size, b.constants.mass) for b in run.scene.bodies.values() if b.modal]
    text = ", ".join(f'"{name}" {size:.3g} m, {mass:.3g} kg' for name, size, mass in found[:SHOWN])
    return text + (f", {len(found) - SHOWN} more" if len(found) > SHOWN else "")


def _in_plane(scene: Scene) -> str:
    """What linear laws mean in the plane, by body; nothing in space."""
    laws = [(name, body.elastic_law) for name, body in scene.bodies.items() if body.dim == 2]
    return ", ".join(f'"{name}" in {law.in_plane} ({law.name})' for name, law in laws if isinstance(law, Hooke))


def _shortened(unknowns: Sequence[tuple[str, int]]) -> str:
    # the largest blocks, in the order of the scene
    ordered = sorted(unknowns, key=lambda x: -x[1])
    kept = [u for u in unknowns if u in ordered[:BLOCKS]]
    rest = sum(n for _, n in unknowns) - sum(n for _, n in kept)
    text = ", ".join(f"{name} {n}" for name, n in kept)
    return text + (f", {len(unknowns) - len(kept)} more blocks with {rest}" if len(kept) < len(unknowns) else "")
