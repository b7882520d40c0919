"""Public names: listed, found, typed and explained."""

from __future__ import annotations

import inspect
import pydoc
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import fmbd_fenicsx as fmbd

ROOT = Path(__file__).resolve().parents[1]
SPACES = ["contacts", "forces", "forms", "loads", "materials", "multipliers", "schemes", "sensors", "solvers"]


@pytest.mark.parametrize("name", fmbd.__all__)
def test_every_flat_name_is_found_and_explained(name: str) -> None:
    found = getattr(fmbd, name)
    assert name in dir(fmbd)
    assert (inspect.getdoc(found) or "").strip()


@pytest.mark.parametrize("space", SPACES)
def test_namespaces_are_modules_whose_names_are_found(space: str) -> None:
    module = getattr(fmbd, space)
    assert isinstance(module, ModuleType)
    text = pydoc.plain(pydoc.render_doc(module))
    for name in module.__all__:
        assert (inspect.getdoc(getattr(module, name)) or "").strip(), name
        assert name in dir(module)
        assert name in text


def test_a_misspelt_name_is_an_error_that_names_its_neighbours() -> None:
    with pytest.raises(AttributeError, match="contakt.*contact"):
        fmbd.contakt  # noqa: B018


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.timeout(0)
def test_mypy_checks_the_package_and_knows_every_name_and_which_can_be_called(tmp_path: Path) -> None:
    """One run for both; ``.ci/run`` has it beside the serial tests."""
    pytest.importorskip("mypy")
    lines = ["from collections.abc import Callable", "import fmbd_fenicsx as fmbd"]
    lines.append("def call(f: Callable[..., object]) -> None: ...")
    places = [("fmbd", fmbd), *((f"fmbd.{s}", getattr(fmbd, s)) for s in SPACES)]
    for prefix, place in places:
        for name in place.__all__:
            what = f"{prefix}.{name}"
            lines.append(f"call({what})" if callable(getattr(place, name)) else f"print({what})")

    script = tmp_path / "script.py"
    script.write_text("\n".join(lines) + "\n")
    command = [sys.executable, "-m", "mypy", "fmbd_fenicsx", str(script)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)  # noqa: PLW1510
    assert done.returncode == 0, done.stdout[-2000:]


@pytest.mark.parametrize("name", [*SPACES, "study", "plot", "demo", "errors", "log"])
def test_a_public_module_shows_its_own_names_alone(name: str) -> None:
    """``dir`` and completion: nothing that it has imported for itself."""
    module = getattr(fmbd, name)
    assert {n for n in dir(module) if not n.startswith("__")} == set(module.__all__)
    assert all(hasattr(module, n) for n in module.__all__)
