"""The architecture: imports point only downwards, files and functions stay short."""

from __future__ import annotations

import ast
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "fmbd_fenicsx"
FLOORS = [
    {
        "_lazy",
        "errors",
        "log",
        "rotations",
        "dolfinx_compat",
        "materials",
        "matrices",
        "polynomials",
        "energies",
        "kernel_cache",
        "checks",
        "hints",
        "notices",
        "ranks",
        "agreement",
        "leaving",
        "scripts",
        "uncopied",
        "answers",
    },
    {"fem"},
    {"mechanics"},
    {"system"},
    {"linear"},
    {"schemes"},
    {"analysis"},
    {"run"},
    {"post"},
    {"__init__", "contacts", "forces", "forms", "loads", "multipliers", "sensors", "solvers"},
]
DOORS = {("run", "post")}  # run.report() and run.plot() open post at first use
# what fails; the aim is 300 lines, 40, 6 and 20
LONGEST_FILE, LONGEST_FUNCTION, MOST_PARAMETERS, MOST_METHODS = 450, 90, 6, 40
MODULES = sorted(PACKAGE.rglob("*.py"))
ROOMS = {path.relative_to(PACKAGE).with_suffix("").parts[0] for path in MODULES}


def room(path: Path) -> str:
    """Name of a module, or of the folder it lies in."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return parts[0]


def floor(name: str) -> int:
    """Number of the floor a room is on."""
    for k, rooms in enumerate(FLOORS):
        if name in rooms or any(name.startswith(f"{r}_") for r in rooms):
            return k
    raise AssertionError(f"{name} is on no floor: enter it in FLOORS")


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def imported(path: Path) -> list[tuple[int, list[str], bool]]:
    """(line, parts of the name below the package, only for types) of every import of this package in a module."""
    tree = parsed(path)
    blocks = [node for node in tree.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)]
    typing_only = {id(child) for node in blocks for child in ast.walk(node)}
    package = ["fmbd_fenicsx", *path.relative_to(PACKAGE).parent.parts]
    found = []
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            start = [*base, *(node.module.split(".") if node.module else [])]
            names = [[*start, alias.name] for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
        for parts in names:
            if parts[0] == "fmbd_fenicsx" and len(parts) > 1:
                found.append((node.lineno, parts[1:], id(node) in typing_only))
    return found


def test_imports_point_downwards() -> None:
    upward = [
        f"{path.relative_to(PACKAGE)}:{line} imports {name}"
        for path in MODULES
        for line, (name, *_), typing_only in imported(path)
        if name in ROOMS and not typing_only and floor(name) > floor(room(path)) and (room(path), name) not in DOORS
    ]
    assert not upward


def module(parts: list[str]) -> str:
    """The module that a name below the package is one of, or is in."""
    while parts and not (PACKAGE.joinpath(*parts).with_suffix(".py").exists() or PACKAGE.joinpath(*parts).is_dir()):
        parts = parts[:-1]
    return ".".join(parts)


def test_no_circles() -> None:
    """Neither at import nor by an import within a function: a module can be read with those below it alone."""
    graph: dict[str, set[str]] = {}
    for path in MODULES:
        own = ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")
        graph[own] = {
            module(parts)
            for _, parts, typing_only in imported(path)
            if not typing_only and (room(path), parts[0]) not in DOORS and module(parts) != own
        }
    graph.pop("__init__")

    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError(f"modules import one another in a circle: {' <- '.join(error.args[1])}") from None


def test_folders_stand_on_one_another_in_one_direction() -> None:
    """Of two folders on one floor one uses the other, and is not used by it, not even for types."""
    uses: dict[tuple[str, str], str] = {}
    for path in MODULES:
        here = ".".join(path.relative_to(PACKAGE).parent.parts)
        for line, parts, _ in imported(path):
            target = module(parts)
            there = target if PACKAGE.joinpath(*target.split(".")).is_dir() else target.rpartition(".")[0]
            apart = not f"{here}.".startswith(f"{there}.") and not f"{there}.".startswith(f"{here}.")
            if here and there and apart and (room(path), parts[0]) not in DOORS:
                uses.setdefault((here, there), f"{path.relative_to(PACKAGE)}:{line}")
    mutual = [f"{a} <-> {b}: {uses[a, b]}, {uses[b, a]}" for a, b in uses if a < b and (b, a) in uses]
    assert not mutual


def test_names_are_imported_from_where_they_stand() -> None:
    """One place for each name: a module hands on nothing that it took from another one."""
    taken: dict[str, set[str]] = {}
    for path in MODULES:
        own = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        taken[own] = {parts[-1] for _, parts, _ in imported(path) if module(parts) != ".".join(parts)}

    handed_on = [
        f"{path.relative_to(PACKAGE)}:{line} takes {parts[-1]} from {module(parts)}"
        for path in MODULES
        for line, parts, _ in imported(path)
        if module(parts) != ".".join(parts) and parts[-1] in taken.get(module(parts), ())
    ]
    assert not handed_on


def test_class_names_are_used_once() -> None:
    """Two classes of one name are taken for one another; private ones are seen in their own file alone."""
    homes: dict[str, list[str]] = {}
    for path in MODULES:
        for node in parsed(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    assert not {name: paths for name, paths in homes.items() if len(paths) > 1}


def test_files_and_functions_are_short() -> None:
    found = []
    for path in MODULES:
        where, lines = path.relative_to(PACKAGE), len(path.read_text().splitlines())
        if lines > LONGEST_FILE:
            found.append(f"{where} has {lines} lines: split it by ideas")
        functions = [x for x in ast.walk(parsed(path)) if isinstance(x, ast.FunctionDef | ast.AsyncFunctionDef)]
        found += [f"{where}: {node.name} {too_much}" for node in functions if (too_much := excess(node))]
    assert not found


def excess(node: ast.FunctionDef | ast.AsyncFunctionDef) -> str:
    """What a function has too much of."""
    body = node.body[1:] if ast.get_docstring(node) else node.body
    length = ((body[-1].end_lineno or 0) - body[0].lineno + 1) if body else 0
    if length > LONGEST_FUNCTION:
        return f"has {length} lines"
    positional = [a for a in node.args.args if a.arg not in ("self", "cls")]
    if len(positional) > MOST_PARAMETERS and not node.name.startswith("_"):
        return f"has {len(positional)} parameters"
    return ""


def test_classes_are_of_one_subject() -> None:
    found = []
    for path in MODULES:
        for node in ast.walk(parsed(path)):
            methods = [x for x in node.body if isinstance(x, ast.FunctionDef)] if isinstance(node, ast.ClassDef) else []
            if len(methods) > MOST_METHODS:
                found.append(
                    f"{path.relative_to(PACKAGE)}: {node.name} has {len(methods)} methods: split it by subjects"
                )
    assert not found


def test_every_module_says_what_it_is_for() -> None:
    bare = [str(p) for p in MODULES if not ast.get_docstring(parsed(p))]
    assert not bare


def test_names_in_docstrings_stand_where_they_are_said_to() -> None:
    """As ``:func:`..module.name```: the module holds the name."""
    wrong = []
    for path in MODULES:
        package = path.relative_to(PACKAGE).parent.parts
        for dots, name in re.findall(r":(?:func|class|meth|data):`~?(\.+|fmbd_fenicsx\.)([\w.]+)`", path.read_text()):
            start = () if dots == "fmbd_fenicsx." else package[: len(package) - len(dots) + 1]
            parts = [*start, *name.split(".")]
            home = module(parts)
            file = PACKAGE.joinpath(*home.split(".")).with_suffix(".py")
            by_itself = "." not in name or name[0].isupper()  # looked for everywhere
            if not by_itself and not (file.exists() and parts[len(home.split("."))] in top_names(file)):
                wrong.append(f"{path.relative_to(PACKAGE)}: {dots}{name}")
    assert not wrong


def top_names(path: Path) -> set[str]:
    """Functions, classes and data at the top of a module."""
    found: set[str] = set()
    for node in parsed(path).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {x.id for target in targets for x in ast.walk(target) if isinstance(x, ast.Name)}
    return found


def test_modules_named_in_texts_exist() -> None:
    """In docstrings as ``:mod:`.name```, in comments of C and on pages by their files; tables of old mutants keep old names."""
    sources = [*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.[ch]")]
    known = {str(path.relative_to(PACKAGE)) for path in sources}
    missing = []

    for path in sources:
        for dots, name in re.findall(r":mod:`~?(\.+)([\w.]+)`", path.read_text()):
            place = path.parents[len(dots) - 1] / name.replace(".", "/")
            if not (place.is_dir() or place.with_suffix(".py").exists()):
                missing.append(f"{path.name}: {dots}{name}")

    pages = [page for page in (PACKAGE.parent / "docs").glob("*.md") if page.name != "mutations.md"]
    for path in (*PACKAGE.rglob("*.[ch]"), *pages):
        folders = "run|schemes|linear|system|mechanics|fem|post|analysis"
        for name in re.findall(rf"(?<![\w/.])((?:{folders})/[\w/]+\.(?:py|c|h))\b", path.read_text()):
            if name not in known:
                missing.append(f"{path.name}: {name}")

    files = {
        path.name
        for folder in ("fmbd_fenicsx", "tests", "demos", "docs")
        for path in (PACKAGE.parent / folder).rglob("*.[pch]*")
    }
    for page in pages:
        written = {"arm.py"} if page.name == "tutorial.md" else set()  # by the reader
        named = set(re.findall(r"`(\w+\.(?:py|c|h))`", page.read_text()))
        missing += [f"{page.name}: {name}" for name in named - files - written]
    assert not missing
