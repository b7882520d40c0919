"""Whether a checkpoint and a scene belong together: what was given, and what it does.

What was given are names, sizes, numbers and strings of bodies, joints, forces, sensors, scheme and tolerances. What it does are
the balance of forces, constraints and energies in the state of the checkpoint: they tell another weak form, mesh or law from
the one that was used, however it was written. Functions themselves are not compared: a load that differs only later is not
seen.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import CheckpointError
from ...rotations import Array
from ...system.layout import State
from ...system.scene.described import described, text_of
from ...system.scene.scene import Scene
from ...system.serialisation import Memory
from ...system.system import System

SAME = 1e-6  # relative difference of forces and energies
NOTHING = 1e-6  # of the largest force: what is smaller is measured by this, SAME * NOTHING being well above roundoff


def given(scene: Scene, system: System, settings: dict[str, Any]) -> dict[str, str]:
    """What was given, as text: name -> value."""
    out = {name: text_of(value) for name, value in described(scene, **settings).items()}
    if scene.origin is not None:
        out["goes on, as next_scene() of a run, from"] = f"t = {scene.begins:.9g} s"
    for _, part in system.fields:
        out[f'unknowns of "{part.name}"'] = str(part.field.n_global)
    out["constraint rows"] = ", ".join(f"{b.name} ({b.rows.stop - b.rows.start})" for b in system.blocks)
    return out


def compare(known: dict[str, str], now: dict[str, str], where: Any) -> None:
    """Raise CheckpointError with what differs."""
    names = [n for n in dict.fromkeys((*known, *now)) if known.get(n) != now.get(n)]
    whole = tuple(f"{n}." for n in names if (n in known) != (n in now))
    names = [n for n in names if not n.startswith(whole)]  # of what is absent its name is enough
    if names:
        lines = [f"{n}: {known.get(n, 'absent')} in the checkpoint, {now.get(n, 'absent')} here" for n in names]
        more = f"; and {len(lines) - 5} more" if len(lines) > 5 else ""
        raise CheckpointError(
            f"The checkpoint {where} is not of this run. {'; '.join(lines[:5])}{more}. Restart with the scene, scheme and "
            "settings of the first run; to go on with others from there, let that end at the checkpoint's time, and solve "
            "run.next_scene()."
        )


def check_effect(system: System, state: State, m: Memory, where: Any) -> None:
    """Forces, constraints, energies and nodes in a state: noted when writing, compared when reading; collective.

    Raises:
        CheckpointError: one of them differs, naming the body or joint.
    """
    for k, part in system.fields:
        numbering = part.field.numbering
        if numbering is None:
            continue

        x = part.field.X_world
        apart = np.abs(m.nodal(f"nodes {k}", x.ravel(), numbering) - x.ravel()).max(initial=0.0)
        if max(part.comm.allgather(float(apart))) > 1e-9 * part.field.size:
            raise CheckpointError(
                f'The checkpoint {where} cannot be used for body "{part.name}": its mesh is another one, or is numbered '
                "otherwise (a mesh that was refined on other ranks)."
            )

    # what the system does must be the same but for roundoff
    for name, (value, scale) in _effect(system, state).items():
        known = m(name, value)
        if not np.abs(known - value).max(initial=0.0) <= SAME * scale:
            raise CheckpointError(
                f"The checkpoint {where} is not of this scene: {name} in its state are {_text(known)}, this scene gives "
                f"{_text(value)}. A form, a law, a mesh or a load has changed."
            )


def _effect(system: System, state: State) -> dict[str, tuple[Array, float]]:
    """What the system does in a state: name -> numbers and what they are measured by, equal on all ranks; collective."""
    ev = system.at(state.t, state.q, state.v)
    forces = ev.balance(np.zeros_like(state.a))
    inertia = ev.balance(state.a) - forces
    acting = _acting(system, forces, inertia)
    d, pairs = system.motions.dim, acting.values()
    largest = max([float(np.abs(x[:d]).max()) for pair in pairs for x in pair], default=0.0)

    # each by the largest of its kind, moments by it times the model's length
    out: dict[str, tuple[Array, float]] = {}
    for where, pair in acting.items():
        size = max(NOTHING * largest, *(float(np.abs(x[:d]).max()) for x in pair))
        turning = max(size * system.length, *(float(np.abs(x[d:]).max(initial=0.0)) for x in pair))
        for what, x in zip(("forces", "inertia forces"), pair, strict=True):
            out[f"{what} {where}"] = x[:d], size
            out[f"moments of {what} {where}"] = x[d:], turning

    energies = np.array(list(ev.energies().values()))
    out["energies"] = energies, max(float(np.abs(energies).max(initial=0.0)), NOTHING * largest * system.length)
    out["constraints"] = ev.constraint(), system.length
    return out


def _acting(system: System, forces: Array, inertia: Array) -> dict[str, tuple[Array, Array]]:
    """Forces and inertia forces (n_v,) by where they act: wrenches on frames, and of all in a part one size each, (1,)."""
    n = system.motions.n_twist

    def inside(k: int, part: Any, x: Array) -> Array:
        own = system.local_v(x, k)
        square = np.array([float(own @ own)])
        return np.sqrt(part.field.total(square) if part.distributed else square)

    applied, inertial = (x[: system.n_frames * n].reshape(-1, n) for x in (forces, inertia))
    found = {f'on "{name}"': (applied[i], inertial[i]) for i, name in enumerate(system.frame_names)}
    for k, part in enumerate(system.parts):
        found[f'in "{part.name}"'] = inside(k, part, forces), inside(k, part, inertia)
    return found


def _text(x: Array) -> str:
    return np.array2string(np.asarray(x).ravel()[:6], precision=6)
