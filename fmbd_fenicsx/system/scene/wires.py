"""Wires and sliding contacts of a scene as parts and rows of its system."""

from __future__ import annotations

from typing import Any

from ...errors import require
from ...mechanics.catenary.sliding import place


def slider_rows(scene: Any, parts: list[Any], part_of: dict[str, int], row: int) -> list[tuple[Any, slice]]:
    """Both sides of every sliding contact, one row each, from row ``row`` on."""
    out: list[tuple[Any, slice]] = []
    slots: dict[str, int] = {}
    for s in scene.sliders.values():
        for b in (s.wires, s.body):
            require(
                scene.bodies.get(b.name) is b,
                f'Contact "{s.name}" refers to body "{b.name}", which is not in the scene.',
            )

        slot = slots[s.wires.name] = slots.get(s.wires.name, -1) + 1
        numbers = (part_of[s.wires.name], part_of[s.body.name])
        wire, head = place(s, numbers, slot, row)
        parts[numbers[0]].statuses.append(wire.status)
        out += [(wire, wire.status.rows), (head, wire.status.rows)]
        row += 1
    return out
