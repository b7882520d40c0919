"""Build the documentation site: guide, gallery, reference. One command, no network.

Run:  ./with-dolfinx python3 docs/build.py [--demos NAME ...] [--out FOLDER]

Needs ``./with-dolfinx pip install sphinx myst-parser furo``. Pictures and animations of the gallery are made by the demos in
their fast versions where ``docs/_static/gallery`` does not have them yet; ``--demos`` names those to be made, "none" for none.
"""

from __future__ import annotations

import argparse
import ast
import html
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
MEDIA = DOCS / "_static" / "gallery"
SPACES = ("forces", "loads", "sensors", "contacts", "schemes", "forms", "solvers", "multipliers", "materials")
WHOLE = {"plot": "fmbd_fenicsx.post.plot", "study": "fmbd_fenicsx.post.study", "demo": "fmbd_fenicsx.post.demo"}


def demos() -> list[Path]:
    """All demos: scripts that end with checks."""
    return sorted(
        p for p in (ROOT / "demos").glob("*.py") if "finish(" in p.read_text() and "arguments(" in p.read_text()
    )


def title_of(demo: Path) -> str:
    """First line of a demo's docstring."""
    return (ast.get_docstring(ast.parse(demo.read_text())) or demo.stem).splitlines()[0].rstrip(".")


def animates(demo: Path) -> bool:
    """Whether a demo writes an animation."""
    text = demo.read_text()

    return any(word in text for word in ("show(", "film(", ".animate(", "snapshots"))


def make_media(demo: Path) -> None:
    """Picture and animation of a demo's fast version."""
    MEDIA.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, str(demo), "--fast", "--picture", str(MEDIA / f"{demo.stem}.png")]
    if animates(demo):
        command += ["--animate", str(MEDIA / f"{demo.stem}.html")]
    print("making", demo.stem, flush=True)
    subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, check=False)


def gallery() -> str:
    """The gallery page: every demo with what it shows, its picture, its animation, its command."""
    cards = "\n".join(card(demo) for demo in demos())
    intro = (
        "Every demo in its fast version; `--picture` and `--animate` make them again. Animations turn, zoom and play."
    )

    return f'# Gallery\n\n{intro}\n\n```{{raw}} html\n<div class="gallery">\n{cards}\n</div>\n```\n'


def card(demo: Path) -> str:
    """One demo of the gallery, as HTML."""
    title = html.escape(title_of(demo))
    picture, film = f"_static/gallery/{demo.stem}.png", f"_static/gallery/{demo.stem}.html"
    parts = [f"<b>{title}</b>"]
    if (DOCS / picture).exists():
        parts.append(f'<a href="{picture}"><img src="{picture}" alt="{title}" loading="lazy"></a>')
    if (DOCS / film).exists():
        parts.append(f'<p><a href="{film}">Animation</a></p>')
    parts.append(f"<p><code>demos/{demo.name}</code></p>")
    return '<div class="card">' + "\n".join(parts) + "</div>"


def reference(folder: Path) -> None:
    """Pages of the reference: the flat names, then each namespace."""
    sys.path.insert(0, str(ROOT))
    fmbd = import_module("fmbd_fenicsx")
    folder.mkdir(exist_ok=True)
    spaces = {name: getattr(fmbd, name) for name in SPACES}
    inside = {name for module in spaces.values() for name in module.__all__}
    flat = [
        n for n in fmbd.__all__ if n not in inside and n not in spaces and not isinstance(getattr(fmbd, n), type(ast))
    ]

    (folder / "flat.md").write_text(
        page_of("fmbd_fenicsx", flat, "The names that nearly every script uses: `fmbd.solve`, ...")
    )
    for name, module in spaces.items():
        intro = (module.__doc__ or "").strip()
        (folder / f"{name}.md").write_text(page_of(f"fmbd_fenicsx.{name}", list(module.__all__), intro))
    for name, path in WHOLE.items():
        (folder / f"{name}.md").write_text(f"# fmbd.{name}\n\n```{{eval-rst}}\n.. automodule:: {path}\n```\n")
    names = "\n".join(["flat", *SPACES, *WHOLE])
    (folder / "index.md").write_text(f"# Reference\n\n```{{toctree}}\n:maxdepth: 1\n\n{names}\n```\n")


def page_of(module: str, names: list[str], intro: str) -> str:
    """A page with the given names of a module."""
    found = import_module(module)
    lines = [f"# {module.replace('fmbd_fenicsx', 'fmbd')}", "", intro, ""]
    for name in sorted(names, key=str.lower):
        kind = (
            "autoclass"
            if isinstance(getattr(found, name), type)
            else "autofunction"
            if callable(getattr(found, name))
            else "autodata"
        )
        lines += ["```{eval-rst}", f".. {kind}:: {module}.{name}", "```", ""]
    return "\n".join(lines)


def main() -> None:
    """Media, generated pages, site."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--demos", nargs="*", help='demos whose pictures are made again; "none" for none')
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "site", help="default build/site")
    args = parser.parse_args()
    wanted = [d for d in demos() if not (MEDIA / f"{d.stem}.png").exists()]
    if args.demos is not None:
        wanted = [d for d in demos() if d.stem in args.demos]
    for demo in wanted:
        make_media(demo)

    source = args.out.parent / "site-source"
    shutil.rmtree(source, ignore_errors=True)
    shutil.copytree(DOCS, source, ignore=shutil.ignore_patterns("__pycache__", "scripts"))
    (source / "gallery.md").write_text(gallery())
    reference(source / "api")
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q", str(source), str(args.out)]
    done = subprocess.run(command, cwd=ROOT, check=False)
    if done.returncode:
        sys.exit("the site has warnings: see above")
    print(f"open {args.out / 'index.html'}")


if __name__ == "__main__":
    main()
