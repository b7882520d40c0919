"""Parts of a scene that sensors know by name."""

from __future__ import annotations

from typing import Any

from ...checks import name_of, shown
from ...errors import InputError


class PartName(str):
    """The name of a part of a scene, which knows the ``part``: one of another scene may have the same name."""

    part: Any


def named_part(what: str, part: Any) -> str:
    """The name of a part of a scene, given by its name or itself."""
    name = part if isinstance(part, str) else name_of(part)
    if name is None:
        raise InputError(f"{what} {shown(part)} must be a name, or what bears it.")
    if part is name:
        return name
    made = PartName(name)
    made.part = part
    return made
