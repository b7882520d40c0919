"""The plan of a scene: what exists, what is constant, what was left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

    fields, contacts = bool(system.fields), system.contacts
    if contacts is not None:
        unknowns += [(f'contact "{p.name}"', p.count) for p in contacts.pairs]
    lines = any(isinstance(b, LineBody) for b in scene.bodies.values())
    no_fields = "" if fields else "elastic fields (no mesh library, no PETSc, no MPI)"

    # whether it is there, what is constant of it, what is left out without it
    table: Sequence[tuple[bool, Sequence[str], str]] = (
        (fields, ("mass and stiffness", "trace weights", "one factor of cm M + ck K for each field and step size"), ""),
        (system.rigid is not None, ("masses and inertias of rigid bodies",), "rigid bodies"),
        (lines, ("mass of lines",), no_fields),
        (not fields or system.comm.size > 1, (), "communication between ranks"),
        (bool(scene.joints), (), "joints"),
        (bool(scene.forces), (), "applied forces"),
        (scene.gravity is not None, (), "gravity"),
        (contacts is not None, ("compliance of the contact nodes for each step size",), "contact"),
        (contacts is None or contacts.frictional, (), "friction"),
        (bool(reduced), ("modes and inertia tensors of reduced bodies",), "modal reduction"),
        (bool(scene.ties), (), "field multipliers"),
    )

    constant = tuple([x for there, of, _ in table if there for x in of])
    left = tuple([without for there, _, without in table if not there and without])
    return Plan(tuple(unknowns), constant, left, path, _solvers(methods or {}))


def _solvers(methods: Mapping[str, str]) -> tuple[str, ...]:
    """The methods, each once, with the bodies it serves where there are several."""
    different = sorted(set(methods.values()))
    if len(different) <= 1:
        return tuple(different)
    return tuple(f"{how}: " + ", ".join(name for name, by in methods.items() if by == how) for how in different)
