"""The README's script runs as printed, its links point to files, its demo command exists."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text()


def script() -> str:
    """The first Python block after the marker."""
    return TEXT.split("<!-- tests/test_readme.py runs this -->")[1].split("```python\n")[1].split("```")[0]


@pytest.mark.serial
@pytest.mark.smoke
def test_script_of_the_readme_runs_and_is_short(tmp_path):
    pytest.importorskip("pyvista")
    assert len([line for line in script().splitlines() if line.strip()]) <= 25
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")
    (tmp_path / "pendulum.py").write_text(script())
    done = subprocess.run([sys.executable, "pendulum.py"], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "finished at t = 1 s" in done.stdout and "estimated from runs with other steps" in done.stdout
    assert (tmp_path / "pendulum.png").stat().st_size > 10_000


@pytest.mark.parametrize("page", ["README.md", *sorted(p.name for p in (ROOT / "docs").glob("*.md"))])
def test_links_point_to_files(page):
    folder = ROOT if page == "README.md" else ROOT / "docs"
    for link in re.findall(r"\]\(([^)#]+)[^)]*\)", (folder / page).read_text()):
        assert link.startswith("http") or (folder / link).exists(), f"{page}: {link}"
