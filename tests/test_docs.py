"""The documentation: its scripts run, its questions are answered, its site builds where the tools are."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from importlib.util import find_spec
from inspect import signature
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import fmbd_fenicsx as fmbd

ROOT = Path(__file__).resolve().parents[1]
HOWTO = (ROOT / "docs/howto.md").read_text()


def blocks(text: str) -> list[str]:
    """Python blocks of a page."""
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def answers() -> list[tuple[str, str]]:
    """Question and answer, one for each block under a question."""
    parts = re.split(r"^### \.\.\. ", HOWTO, flags=re.MULTILINE)[1:]
    return [(part.splitlines()[0].rstrip("?"), block) for part in parts for block in blocks(part)]


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the clone's meshes in which scripts may write."""
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.serial
@pytest.mark.parametrize(("question", "answer"), answers(), ids=[q for q, _ in answers()])
def test_answers_run_and_are_short(question: str, answer: str, clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len([line for line in answer.splitlines() if line.strip()]) <= 9
    if "picture" in answer:
        pytest.importorskip("pyvista")
    if "notebook" in question:  # a cell runs in a kernel, which is a screen
        monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))
    known: dict[str, Any] = {}
    exec(blocks(HOWTO)[0], known)  # noqa: S102
    exec(answer, known)  # noqa: S102


@pytest.mark.serial
def test_tutorial_runs_and_shows_what_it_says(clone: Path) -> None:
    pytest.importorskip("pyvista")
    script = "\n".join(blocks((ROOT / "docs/tutorial.md").read_text()))
    (clone / "arm.py").write_text(script)
    done = subprocess.run([sys.executable, "arm.py"], capture_output=True, text=True, timeout=250)  # noqa: PLW1510
    assert done.returncode == 0, done.stderr[-3000:]
    assert "load at the end:" in done.stdout and "estimated from runs with other steps" in done.stdout
    for name in ("arm.png", "arm.html"):
        assert (clone / name).stat().st_size > 20_000
    assert list((clone / "arm_fields").glob("*.pvd"))


def test_stress_of_the_tutorial_is_the_tension_of_a_pulled_link() -> None:
    from basix.ufl import element
    from ufl import Mesh, SpatialCoordinate, as_vector

    block = next(b for b in blocks((ROOT / "docs/tutorial.md").read_text()) if "def von_mises" in b)
    known: dict[str, Any] = {"E": 2e9, "nu": 0.35}
    exec(block.split("stress = ")[0], known)  # noqa: S102
    x, y = SpatialCoordinate(Mesh(element("Lagrange", "triangle", 1, shape=(2,))))
    pulled = as_vector((1e-3 * x, -0.35e-3 * y))
    assert known["von_mises"](pulled)((0.2, 0.1)) == pytest.approx(2e6)


def anchors(page: Path) -> set[str]:
    """Places of a page that links can name: those of its headings, as GitHub and the site form them."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    titles = [re.sub(r"[`*]", "", title) for title in re.findall(r"^#+ (.*)$", text, re.MULTILINE)]

    return {re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize(
    "page", sorted(str(p.relative_to(ROOT)) for p in (*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")))
)
def test_links_name_pages_and_headings(page: str) -> None:
    here = ROOT / page
    text = re.sub(r"```.*?```", "", here.read_text(), flags=re.DOTALL)
    for file, place in re.findall(r"\]\((?!https?:|mailto:)([^)#\s]*)(?:#([^)\s]+))?\)", text):
        target = (here.parent / file).resolve() if file else here
        assert target.exists(), f"{page}: {file}"
        if place:
            assert place in anchors(target), f"{page}: {file}#{place}; there is {sorted(anchors(target))}"


def test_twenty_questions_are_answered() -> None:
    table = HOWTO.split("## Where is it?")[1].split("\n## ")[0]
    rows = [row.split("|")[1:3] for row in table.splitlines() if row.startswith("| ")][1:]
    assert len(rows) >= 20
    for question, answer in rows:
        assert question.strip() and "](" in answer, question


@pytest.mark.parametrize("page", sorted(p.name for p in (ROOT / "docs").glob("*.md")))
def test_every_page_is_in_the_index(page: str) -> None:
    index = (ROOT / "docs/index.md").read_text()
    assert page == "index.md" or re.search(rf"^{Path(page).stem}$", index, re.MULTILINE), (
        f"{page} is not in docs/index.md"
    )


def named(node: ast.expr) -> Any:
    """What a chain of names that begins with ``fmbd`` stands for; None for others. Raises where nothing has that name."""
    if isinstance(node, ast.Attribute):
        owner = named(node.value)
        return None if owner is None else getattr(owner, node.attr)
    return fmbd if isinstance(node, ast.Name) and node.id == "fmbd" else None


@pytest.mark.parametrize("page", sorted(p.name for p in (ROOT / "docs").glob("*.md")))
def test_python_of_a_page_calls_what_there_is(page: str) -> None:
    """Names and parameters of the package; what runs as well is tested above, and beside the subjects."""
    for block in blocks((ROOT / "docs" / page).read_text()):
        for node in ast.walk(ast.parse(block, page)):
            if isinstance(node, ast.Attribute):
                named(node)
            if isinstance(node, ast.Call) and (called := named(node.func)) is not None:
                given = {k.arg: k for k in node.keywords if k.arg is not None}
                some = len(given) < len(node.keywords) or any(isinstance(x, ast.Starred) for x in node.args)
                (signature(called).bind_partial if some else signature(called).bind)(*node.args, **given)


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.skipif(find_spec("sphinx") is None or find_spec("myst_parser") is None, reason="no Sphinx")
def test_site_builds_without_warnings(tmp_path: Path) -> None:
    command = [sys.executable, "docs/build.py", "--demos", "none", "--out", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=280)  # noqa: PLW1510
    assert done.returncode == 0, done.stderr[-3000:]
    for page in ("index", "tutorial", "howto", "gallery", "api/flat", "api/sensors", "genindex"):
        assert (tmp_path / "site" / f"{page}.html").exists()
    text = (tmp_path / "site/tutorial.html").read_text()
    assert not re.search(r'<(?:script|link|img)[^>]*(?:src|href)="https?:', text)  # no network at view time
