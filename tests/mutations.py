# ruff: noqa: E501
"""Break the package on purpose, one line at a time, and see which tests turn red.

Run:  ./with-dolfinx python3 tests/mutations.py            (all; writes docs/mutations.md)
      ./with-dolfinx python3 tests/mutations.py 3 7        (some; prints only)

Works on a copy in a temporary folder. Exit code 1 when a mutation is not caught.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MECHANICS = (
    "test_rotations test_frames test_joints test_system test_fields test_surfaces test_linear test_start".split()
)
ALPHA = ["test_generalized_alpha"]
CONTACT = ["test_contact"]

# what is broken, file, old text, new text, tests tried
MUTATIONS: list[tuple[str, str, str, str, list[str]]] = [
    ("sign of B^T on elastic surfaces", "system/tangents/jacobian.py", "p.port_force(self.port[:, s.port_slice(k)].T @ lam, self.t)",
     "-p.port_force(self.port[:, s.port_slice(k)].T @ lam, self.t)", MECHANICS),
    ("sign of G^T on frames", "system/tangents/jacobian.py", "core = np.asarray(self.core.T @ lam)",
     "core = -np.asarray(self.core.T @ lam)", MECHANICS),
    ("T(theta) in place of its inverse", "rotations.py", "w = (tangent_inverse(xi[..., 3:])", "w = (tangent(xi[..., 3:])",
     MECHANICS),
    ("left tangent operator for the right one", "rotations.py", "np.eye(3) - a * H + b", "np.eye(3) + a * H + b", MECHANICS),
    ("T^-1 dropped from the increments of Newton", "schemes/onestep/alpha/alpha_step.py", "self._moved(rate(self.end.xi, increment.q))",
     "self._moved(increment.q)", ALPHA),
    ("history of A forgotten", "schemes/onestep/alpha/alpha_stepper.py", "self.A, self.fresh = A, False",
     "self.A, self.fresh = step.end.a, False", ALPHA),
    ("alpha_f in the wrong place", "schemes/onestep/alpha/alpha_step.py", "(1 - af) * start.a + af * start.state.a - am * start.A",
     "(1 - af) * start.a + am * start.state.a - af * start.A", ALPHA),
    ("start with exact velocities", "schemes/onestep/alpha/alpha_stepper.py", "miss = h * h * (c * rate", "miss = 0 * h * (c * rate", ALPHA),
    ("start with A_0 = a_0", "schemes/onestep/alpha/alpha_stepper.py", "s.a + ahead * h * rate, s.a", "s.a, s.a", ALPHA),
    ("Lie term of the start dropped", "schemes/onestep/alpha/alpha_stepper.py", "spin_of_acceleration(system, s.v, s.a) / 12", "0.0", ALPHA),
    ("rho_inf = 1 accepted", "schemes/onestep/alpha/generalized_alpha.py", "0.0 <= self.rho_inf < 1.0", "0.0 <= self.rho_inf <= 1.0", ALPHA),
    ("Coriolis term halved", "mechanics/elastic/floating.py", "A += Ud @ (2.0 * spin.T)", "A += Ud @ (1.0 * spin.T)", MECHANICS),
    ("deformation left out of the lever", "mechanics/elastic/floating.py", "axial(P.T @ F)", "axial(self.field.X.T @ F)", MECHANICS),
    ("gyroscopic moment of rigid bodies dropped", "mechanics/placements.py", " + m.moment(v[:, d:], Jw)", "", MECHANICS),
    ("Coriolis part of a surface's bias halved", "mechanics/frames.py", "2.0 * m.spin(w[s], local_rate[:, :d])",
     "1.0 * m.spin(w[s], local_rate[:, :d])", MECHANICS),
    ("stretch left out of a surface's rotation", "mechanics/frames.py", "rest = stretch.sum(1, keepdims=True) - stretch",
     "rest = 2.0 + 0.0 * stretch", MECHANICS),
    ("gamma of a drive without its second rate", "mechanics/joints/constraints.py", "return second - self.offsets(t)[2] if", "return second if",
     MECHANICS),
    ("multiplier of a distance is half of its force", "mechanics/kinds/definitions.py", "((d @ d) / length - length) * 0.5",
     "(d @ d) / length - length", MECHANICS),
    ("fields left out of the Schur complement", "linear/prepared.py", "-block.seen_by(R", "-0.0 * block.seen_by(R", MECHANICS),
    ("judge accepts everything", "linear/residual.py", "if not (relative <= self.tolerance or self._is_roundoff(residual, scale, grown)):",
     "if False:", MECHANICS),
    ("velocities projected in the wrong metric", "schemes/consistent.py", "    v = v + dv\n",
     "    v = v - np.linalg.pinv(ev.jacobian.core) @ (ev.jacobian.times(v)) if not system.fields else v + dv\n", MECHANICS),
    ("gap of the joints accepted", "system/lengths.py", "FITS = 1e-3", "FITS = 1e3", MECHANICS),
    ("centroid left out of the trace weights", "fem/nodal_field.py", "weights(-float(c), axis)", "weights(0.0, axis)", MECHANICS),
    ("symmetry of the elastic form not checked", "fem/field_checks.py", "if abs(vKu - uKv) > 1e-9 * scale:", "if False:", MECHANICS),
    ("inverted cells not counted", "fem/mesh/checks.py", "        bad += wrong.size", "        bad += 0 * wrong.size", ["test_mesh"]),
    ("sums over ranks in no fixed order (rank 0 last)", "ranks.py", "_of_each(comm, x).sum(axis=0)",
     "_of_each(comm, x)[:: -1 if comm.rank else 1].sum(axis=0)", ["test_ranks"]),
    ("end rule of the multipliers dropped", "fem/traces/multipliers.py", "if ends is Ends.KEPT or len(border) == 0:", "if True:",
     ["test_multipliers", "test_stability"]),
    ("contact forces pull", "schemes/impacts/contact_newton.py", "r = residuals[0] - contacts.transposed(", "r = residuals[0] + contacts.transposed(",
     CONTACT),
    ("contact nodes keep their mass", "mechanics/contact/mass.py", "B = M.ptap(P)", "B = M.copy()", ["test_contact_mass"]),
    ("restitution forgotten", "schemes/impacts/moreau_step.py", "back = np.where(before[:, 0] < 0.0, self.rows.restitution, 1.0)", "back = np.where(before[:, 0] < 0.0, 0.0, 1.0)", ["test_compiled_contact"]),
    ("impacts at the end of the step", "schemes/impacts/moreau_stepper.py", "flight = step if share == 1.0 else self._located(step, share, which)",
     "flight = step", ["test_compiled_contact"]),
    ("friction along the slip", "linear/complementarity/coulomb.py", "F[s, 1:] = x[s, 1:] - radius[s, None] * e", "F[s, 1:] = x[s, 1:] + radius[s, None] * e",
     ["test_complementarity"]),
    ("no proximal points for dependent contacts", "linear/complementarity/coulomb.py", "for _ in range(40 if rho else 1):", "for _ in range(1):",
     ["test_complementarity", "test_moreau"]),
    ("proximal parameter does not fall", "linear/complementarity/coulomb.py", "rho = 0.1 * rho if near.size(found.F, x) <= FOUND else 10.0 * rho", "rho = rho",
     ["test_complementarity"]),
    ("friction by products: slope of the cone of wrong sign", "linear/complementarity/coulomb_matrix_free.py", "a[:, 1:2] += self.slope[:, None] * a[:, :1]",
     "a[:, 1:2] -= self.slope[:, None] * a[:, :1]", ["test_delassus"]),
    ("friction by products: known forces left out of the gaps", "linear/complementarity/coulomb_matrix_free.py", "if s.any():\n            r = r - cone", "if False:\n            r = r - cone",
     ["test_delassus"]),
    ("friction by products: preconditioner holds slips", "linear/complementarity/coulomb_matrix_free.py", "w[rest] = solve(load[rest] - held @ r[free])", "w[rest] = 0.0",
     ["test_delassus"]),
    ("contact sees no ties of many multipliers", "linear/complementarity/delassus.py", "if elastic and (len(trace) > self.most or self.solver.iterated is not None):",
     "if elastic and len(trace) > self.most:", ["test_delassus"]),
    ("sliding ties of curved surfaces taken", "mechanics/joints/trace_rows.py", "require(trace.flat,", "require(True,",
     ["test_trace_ties"]),
    ("geometric stiffening left out", "mechanics/elastic/stiffening.py", "return out.reshape(len(U), len(matrices))", "return 0 * out.reshape(len(U), len(matrices))",
     ["test_stiffening"]),
    ("loads do no work on second-order displacements", "mechanics/elastic/second_order.py", "-0.5 * axial(twice.T @ axes)", "0.0 * axial(twice.T @ axes)",
     ["test_system"]),
    ("a frame does not see second-order displacements", "mechanics/elastic/second_order.py", "N = N + np.outer(h[0], b[:d])", "N = N + 0.0 * np.outer(h[0], b[:d])",
     ["test_system"]),
    ("surfaces turn as they stand at the end of a step", "schemes/onestep/conserving/discrete_gradient.py", "kin.jac_port[still] = surface_quotients", "_ = surface_quotients",
     ["test_mixed_momentum"]),
    ("springs along the mean line at full length", "mechanics/joints/relative.py", "np.asarray(2 * self.values(mean) / (ends[0] + ends[1]))",
     "np.ones(len(linear))", ["test_mixed_momentum"]),
    ("multipliers are the means over a step", "schemes/onestep/conserving/energy_momentum.py", "accelerations(self.system, State(s.t + h, q, v, s.a, lam), self.solver)",
     "State(s.t + h, q, v, s.a, lam)", ["test_mixed_momentum", "test_energy_momentum"]),
    ("viscous law at the old strain", "fem/mean_forces.py", "return force + viscous(mean, rate, v,",
     "return force + viscous(self.u0, rate, v,", ["test_mixed_momentum"]),
    ("pressure at the old surface", "fem/mean_forces.py", "POINTS = (0.5 - 1 / 12**0.5, 0.5 + 1 / 12**0.5)", "POINTS = (0.0, 0.0)",
     ["test_mixed_momentum"]),
    ("stiffness of a pressure left out", "fem/motion_tangent.py", "parts.append(-field.loads.moving_form", "parts.append(0 * field.loads.moving_form",
     ["test_viscous"]),
    ("viscous law with the rate's own gradient", "materials.py", "strain_rate = sym(F.T * grad(rate))", "strain_rate = sym(grad(rate))",
     ["test_viscous"]),
    ("A forgotten in the checkpoint", "schemes/onestep/alpha/alpha_stepper.py",
     '        "A": Memory.like_v,\n', "",
     ["test_checkpoint"]),
    ("turns of an increment not counted", "system/configurations.py", "q[..., at] += system.counted.ahead(", "_ = system.counted.ahead(",
     ["test_counted"]),
    ("a damaged checkpoint is read", "run/checkpoints/archive.py", "(actual := sha256(folder / name)) != expected", "not (actual := sha256(folder / name))",
     ["test_checkpoint_files"]),
    ("a mesh library loaded by the package", "__init__.py", "from .leaving import install_hooks", "import gmsh\nfrom .leaving import install_hooks",
     ["test_imports"]),
    ("an arrow that points up", "mechanics/frames.py", "def polar_rotation", "def _up() -> None:\n    from ..run import solve\n\n\ndef polar_rotation",
     ["test_layers"]),
]  # fmt: skip


def red(folder: Path, tests: list[str]) -> list[str]:
    """Names of the failing tests, without their parameters."""
    done = subprocess.run(  # noqa: PLW1510
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "--tb=no",
            "-p",
            "no:cacheprovider",
            "--maxfail=4",
            "-k",
            "not elastic_pendulum",
        ]
        + [f"tests/{t}.py" for t in tests],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
    )
    lines = re.findall(r"^(?:FAILED|ERROR) tests/(\S+?\.py)(?:::(\w+))?", done.stdout, re.MULTILINE)
    if done.returncode and not lines:
        return ["the suite does not start"]
    return sorted({f"{file[:-3]}::{test}" if test else file for file, test in lines})


def main() -> int:
    """Try the chosen mutations."""
    chosen = [int(a) for a in sys.argv[1:]] or range(len(MUTATIONS))
    rows, missed = [], 0
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch) / "copy"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", "__pycache__", ".cache", "docs"))
        for k in chosen:
            what, name, old, new, tests = MUTATIONS[k]
            path = copy / "fmbd_fenicsx" / name
            text = path.read_text()
            if old not in text:
                print(f"{k:3} {what}: {name} no longer has this line", flush=True)
                missed += 1
                continue
            path.write_text(text.replace(old, new, 1))
            found = red(copy, tests)
            path.write_text(text)
            missed += not found
            print(f"{k:3} {what}: {', '.join(found[:4]) or 'NOT CAUGHT'}", flush=True)
            rows.append(f"| {what} | `{name}` | {', '.join(f'`{t}`' for t in found[:4]) or '**none**'} |")
    if len(sys.argv) == 1:
        head = [
            "# Mutations",
            "",
            "One line of the package is broken at a time by `tests/mutations.py`; the tests named here turned red (four at most",
            "are listed). A test that stays green when its subject is broken proves nothing.",
            "",
            "| broken | in | caught by |",
            "|---|---|---|",
        ]
        page = ROOT / "docs/mutations.md"
        _, mark, drawn = page.read_text().partition("\n## Drawn at random")  # judged by hand: kept
        page.write_text("\n".join([*head, *rows]) + "\n" + mark + drawn)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
