"""Parts of a scene whose modules are loaded only by scenes that have them: what a scene must know of them all the same."""

from __future__ import annotations

from typing import ClassVar


class ScenePart:
    """A tie by a field of multipliers, or a contact. ``what``: "tie" or "contact", as messages and the scene's lists call it."""

    name: str
    what: ClassVar[str]
