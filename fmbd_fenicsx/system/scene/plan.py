"""The plan of a scene: what exists, what is constant, what was left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ...mechanics.bodies.line_body import LineBody
from ..system import System
from .scene import Scene


@dataclass(frozen=True)
class Plan:
    """Lists of what a run has (name, size), what stays constant during it, and what it does without; who makes the steps.

    ``solvers``: by what the elastic blocks are solved, with the names of the bodies where they differ; empty before a run.
    """

    unknowns: tuple[tuple[str, int], ...]
    constant: tuple[str, ...]
    left_out: tuple[str, ...]
    path: str = "NumPy"
    solvers: tuple[str, ...] = ()

    def __str__(self) -> str:
        width = max((len(n) for n, _ in self.unknowns), default=0)
        lines = ["plan"]
        lines += [f"  {n:<{width}}  {k:>9}" for n, k in self.unknowns]
        lines += [f"  constant: {', '.join(self.constant)}", f"  left out: {', '.join(self.left_out)}"]
        lines += [f"  elastic blocks by {how}" for how in self.solvers]
        lines += [f"  steps: {self.path}"]
        return "\n".join(lines)


def make_plan(scene: Scene, system: System, path: str = "NumPy", methods: Mapping[str, str] | None = None) -> Plan:
    """Derive the plan from the scene, its system, the path its steps take and what solves the blocks of bodies (by name); no
    computation.
    """
    reduced = [b for b in scene.bodies.values() if b.modal]
    modes = [(f"{b.name}: modes", b.constants.n_modes) for b in reduced]
    unknowns = [("frames", system.n_core - sum(n for _, n in modes)), *modes]
    unknowns += [(f"{f.name}.u", f.field.n_global) for _, f in system.fields]
    unknowns += [(b.name, b.rows.stop - b.rows.start) for b in system.blocks]

    constant, left = [], []
    if system.fields:
        constant += ["mass and stiffness", "trace weights", "one factor of cm M + ck K for each field and step size"]
    if system.rigid is not None:
        constant.append("masses and inertias of rigid bodies")
    else:
        left.append("rigid bodies")
    if any(isinstance(b, LineBody) for b in scene.bodies.values()):
        constant.append("mass of lines")
    elif not system.fields:
        left.append("elastic fields (no mesh library, no PETSc, no MPI)")
    if system.fields and system.comm.size == 1:
        left.append("communication between ranks")

    if not scene.joints:
        left.append("joints")
    if not scene.forces:
        left.append("applied forces")
    if scene.gravity is None:
        left.append("gravity")

    if system.contacts is None:
        left.append("contact")
    else:
        unknowns += [(f'contact "{p.name}"', p.count) for p in system.contacts.pairs]
        constant.append("compliance of the contact nodes for each step size")
        if not system.contacts.frictional:
            left.append("friction")
    if reduced:
        constant.append("modes and inertia tensors of reduced bodies")
    else:
        left.append("modal reduction")
    if not scene.ties:
        left.append("field multipliers")

    return Plan(tuple(unknowns), tuple(constant), tuple(left), path, _solvers(methods or {}))


def _solvers(methods: Mapping[str, str]) -> tuple[str, ...]:
    """The methods, each once, with the bodies it serves where there are several."""
    different = sorted(set(methods.values()))
    if len(different) <= 1:
        return tuple(different)
    return tuple(f"{how}: " + ", ".join(name for name, by in methods.items() if by == how) for how in different)
