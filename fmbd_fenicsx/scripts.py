"""Scripts of the user's own that are read as modules: those of meshes, and of units of co-simulation."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

from .errors import named


def module_of(what: str, script: Path) -> ModuleType:
    """The module that a script makes; ``what`` it is in the :class:`.LawError` where it fails."""
    spec = importlib.util.spec_from_file_location(f"fmbd_script_{script.stem}", script)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    named(what, str(script), spec.loader.exec_module, time=None)(module)
    return module
