"""Kept libraries: built once, loaded only when they are this user's own and whole."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from fmbd_fenicsx import kernel_cache

SOURCE = "int value(void) { return %d; }"
pytestmark = pytest.mark.compiled


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Empty folders of libraries and of their hashes; the second is made by the first use."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    libraries = kernel_cache.cache_folder()
    return libraries, kernel_cache.notes_folder(libraries)


def value(number: int) -> int:
    """What the library of a number says, in a process of its own: a library once loaded stays loaded."""
    code = f"from fmbd_fenicsx import kernel_cache as k; print(k.load('test', {SOURCE % number!r}).value())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return int(done.stdout)


def kept(folder: Path) -> list[Path]:
    return sorted(folder.glob("test_*.so"))


def test_built_once_and_private(folders: tuple[Path, Path]) -> None:
    libraries, notes = folders
    assert value(7) == 7
    first = kept(libraries)[0].stat().st_mtime_ns
    assert value(7) == 7
    assert [p.stat().st_mtime_ns for p in kept(libraries)] == [first]
    for folder in folders:
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert [p.suffix for p in libraries.iterdir()] == [".so"]  # no hash beside the library, nothing left over
    assert len(list(notes.iterdir())) == 1


def test_a_first_compile_is_said_once(folders: tuple[Path, Path]) -> None:
    code = f"from fmbd_fenicsx import kernel_cache as k; k.load('test', {SOURCE % 8!r})"
    first, again = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stderr
        for _ in range(2)
    )
    assert first.count("compiling test, once") == 1
    assert str(folders[0]) in first.replace("\n    ", "")
    assert again == ""


def test_threads_build_once(folders: tuple[Path, Path]) -> None:
    """One that found half a note took NumPy, beside others whose tables held addresses of the library."""
    code = f"""
from concurrent.futures import ThreadPoolExecutor
from fmbd_fenicsx import kernel_cache as k
with ThreadPoolExecutor(8) as pool:
    print(*pool.map(lambda _: k.load("test", {SOURCE % 5!r}).value(), range(8)))
"""
    count = "made = []; run = k._Building._run; k._Building._run = lambda self, c: (made.append(c), run(self, c))\n"
    code = code.replace("with Thread", count + "with Thread") + "print(len(made))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [*"55555555", "2"]  # compiled and linked


def test_units_are_compiled_once_for_several_libraries(folders: tuple[Path, Path]) -> None:
    """A library of two units, then one that has the first of them and another; an object that was changed is made again."""
    code = (
        "from fmbd_fenicsx import kernel_cache as k\n"
        "one = k.SourceUnit('one', 'int one(void) { return 1; }', shared=True)\n"
        "def more(n):\n"
        "    text = f'int one(void); int value(void) {{ return {n} + one(); }}'\n"
        "    return k.load_library(k.Library('test', (one, k.SourceUnit(f'more{n}', text, shared=True)))).value()\n"
        "print(more(NUMBER))\n"
    )

    def said(number: int) -> tuple[int, str]:
        text = code.replace("NUMBER", str(number))
        done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
        return int(done.stdout), done.stderr.replace("\n    ", " ")

    value, text = said(10)
    assert value == 11 and "compiling one, more10, once" in text
    value, text = said(20)
    assert value == 21 and "compiling more20, once" in text
    (kept_one,) = folders[0].glob("one_*.o")
    kept_one.write_bytes(b"another's")
    value, text = said(30)
    assert value == 31 and "compiling one, more30, once" in text


def test_forms_that_take_long_are_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from fmbd_fenicsx import dolfinx_compat as compat

    said: list[str] = []
    monkeypatch.setattr(compat, "note", said.append)
    monkeypatch.setitem(compat.JIT_OPTIONS, "cache_dir", str(tmp_path))
    import ufl
    from dolfinx.mesh import create_unit_interval
    from mpi4py import MPI

    mesh = create_unit_interval(MPI.COMM_SELF, 1)
    x = ufl.SpatialCoordinate(mesh)
    monkeypatch.setattr(compat, "SLOW", 0.05)
    compat.form(x[0] ** 2 * ufl.dx)  # generated and compiled: tenths of a second at least
    assert said == ["compiling a functional of an elastic body, once (some seconds)"]

    monkeypatch.setattr(compat, "SLOW", 60.0)
    compat.form(x[0] ** 2 * ufl.dx)
    assert len(said) == 1


def test_an_interrupt_leaves_no_source_that_others_wait_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import ufl
    from dolfinx.mesh import create_unit_interval
    from ffcx.codegeneration import jit
    from mpi4py import MPI

    from fmbd_fenicsx import dolfinx_compat as compat

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setitem(compat.JIT_OPTIONS, "cache_dir", str(tmp_path))
    x = ufl.SpatialCoordinate(create_unit_interval(MPI.COMM_SELF, 2))[0]
    compat.form(x * ufl.dx)
    with monkeypatch.context() as during:
        during.setattr(jit.cffi, "FFI", interrupted)
        with pytest.raises(KeyboardInterrupt):
            compat.form(x**4 * ufl.dx)
    left = [path for path in tmp_path.glob("*.c") if not path.with_suffix(".c.cached").exists()]
    assert not left


def test_a_form_that_was_loaded_is_not_looked_for_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Of the same form on another mesh the module is remembered; another form is looked for."""
    import ufl
    from dolfinx import fem
    from dolfinx.mesh import create_unit_interval
    from ffcx.codegeneration import jit
    from mpi4py import MPI

    from fmbd_fenicsx import dolfinx_compat as compat

    monkeypatch.setitem(compat.JIT_OPTIONS, "cache_dir", str(tmp_path))

    def cube(cells: int) -> float:
        mesh = create_unit_interval(MPI.COMM_SELF, cells)
        return float(fem.assemble_scalar(compat.form(ufl.SpatialCoordinate(mesh)[0] ** 3 * ufl.dx)))

    assert cube(1) == pytest.approx(0.25) == cube(2)

    def nowhere(*_: object) -> None:
        raise FileNotFoundError("looked into the folder")

    monkeypatch.setattr(jit.importlib.machinery, "FileFinder", nowhere)
    assert cube(3) == pytest.approx(0.25)


@pytest.mark.parametrize("damage", ["another library", "half", "empty", "writable by others", "link", "hash"])
def test_what_is_not_as_built_is_built_again(folders: tuple[Path, Path], damage: str, tmp_path: Path) -> None:
    """Another's library under the right name would say 8."""
    libraries, notes = folders
    value(8)
    wrong = kept(libraries)[0]
    wrong.rename(tmp_path / "wrong.so")
    value(7)
    (file,) = kept(libraries)
    whole = (tmp_path / "wrong.so").read_bytes()

    file.unlink()
    if damage == "link":
        file.symlink_to(tmp_path / "wrong.so")
    else:
        file.write_bytes({"half": whole[: len(whole) // 2], "empty": b""}.get(damage, whole))
        file.chmod(0o777 if damage == "writable by others" else 0o700)
    if damage == "hash":
        for note in notes.iterdir():
            note.write_text("0" * 64)
    assert value(7) == 7
    assert not kept(libraries)[0].is_symlink()


@pytest.mark.skipif(os.geteuid() != 0, reason="gives folders to another user")
@pytest.mark.parametrize("which", ["libraries", "above"])
def test_folder_of_another_user_is_not_used(folders: tuple[Path, Path], which: str) -> None:
    """Kernels are then built for the process alone; what the other put there is neither loaded nor touched."""
    libraries, _ = folders
    value(7)
    (file,) = kept(libraries)
    file.write_bytes(b"another user's")
    if which == "libraries":
        os.chown(libraries, 65534, 65534)
    else:
        libraries.parent.chmod(0o777)
    assert value(7) == 7
    assert file.read_bytes() == b"another user's"


def test_own_folder_that_others_may_write_is_closed(folders: tuple[Path, Path]) -> None:
    libraries, _ = folders
    libraries.mkdir(parents=True)
    libraries.chmod(0o777)
    assert value(7) == 7
    assert stat.S_IMODE(libraries.stat().st_mode) == 0o700


@pytest.mark.parametrize("where", ["no such folder", "file"])
def test_without_a_place_to_keep_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nothing" if where == "no such folder" else str(tmp_path / "file"))
    assert value(7) == 7


def test_source_that_does_not_compile_and_no_compiler_are_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(kernel_cache, "note", said.append)
    assert kernel_cache.load("test", "no C at all") is None
    # what is compiled, and what the compiler says
    assert "test is not compiled" in said[-1] and "error" in said[-1] and "NumPy" in said[-1]
    monkeypatch.setenv("CC", "no-such-compiler")
    for name in ("test", "other"):
        assert kernel_cache.load(name, SOURCE % 1) is None
    # one text, of which a second is not written
    assert "no C compiler" in said[-1] and said[-1] == said[-2]
