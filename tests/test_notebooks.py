"""The notebooks: pairs of one text, executed where a kernel is there."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))
pytestmark = pytest.mark.serial


def cells(script: str) -> list[tuple[str, str]]:
    """Kind and text of the cells of a script in the percent format."""
    found = []
    for kind, text in re.findall(r"^# %%( \[markdown\])?\n(.*?)(?=^# %%|\Z)", script, re.MULTILINE | re.DOTALL):
        body = re.sub(r"^# ?", "", text, flags=re.MULTILINE) if kind else text
        found.append(("markdown" if kind else "code", body.strip()))
    return found


def test_there_are_three() -> None:
    assert len(NOTEBOOKS) >= 3


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_and_script_are_one_text(notebook: Path) -> None:
    content = json.loads(notebook.read_text())
    stored = [(c["cell_type"], "".join(c["source"]).strip()) for c in content["cells"]]
    assert stored == cells(notebook.with_suffix(".py").read_text())
    assert not any(c.get("outputs") for c in content["cells"])  # results come from running it


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_runs_and_shows_its_scene(notebook: Path) -> None:
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    made = nbformat.read(notebook, as_version=4)
    nbclient.NotebookClient(made, timeout=240, resources={"metadata": {"path": str(ROOT)}}).execute()
    shown = [o["data"] for c in made.cells if c.cell_type == "code" for o in c.outputs if "data" in o]
    assert shown and all("text/html" in data or "text/plain" in data for data in shown)
    assert any("text/html" in data for data in shown)
