"""What Python reads of the driver's sources is what a compiler makes of them."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import pytest

from fmbd_fenicsx.kernel_cache import compiler
from fmbd_fenicsx.linear.blocks.complex_factor import Symmetric
from fmbd_fenicsx.schemes.impacts.compiled import structures as contact
from fmbd_fenicsx.system.compiled import declarations, explicit, implicit, march, own_steps, tape
from fmbd_fenicsx.system.compiled.library import CONTACT, CORE, IMPLICIT, _source
from fmbd_fenicsx.system.compiled.states import convergence, field_stages, stage_patterns, stages
from fmbd_fenicsx.system.compiled.tables.structures import structure

OF_TABLES = "Surface Body Told Field Batch Front Angle Rod Reaction Deflection Control System".split()
OF_CORE: dict[str, Any] = {"Symmetric": Symmetric, "Closed": march.Closed, "Tape": tape.TAPE}
OF_IMPLICIT: dict[str, Any] = {
    "Implicit": implicit.Implicit, "OwnSteps": own_steps.OwnSteps, "Orders": implicit.OrdersOfBDF,
    "Convergence": convergence.Convergence, "Sparse": stages.Sparse, "Lower": stages.Lower, "Stages": stages.Stages,
    "Product": stage_patterns.ProductPairs,
    "Patterns": stage_patterns.Patterns, "FieldStages": field_stages.FieldStages,
}  # fmt: skip
OF_SCHEMES: dict[str, Any] = {"OwnSteps": own_steps.OwnSteps, "Norm": explicit.Norm, "Explicit": explicit.Explicit}
OF_CONTACT: dict[str, Any] = {
    name: getattr(contact, name) for name in "Touch Tally Problem Graph Blocks Tree Block Contacts".split()
}


def told(dim: int, unit: str) -> dict[str, Any]:
    """The structures of a unit that Python knows."""
    if unit == CONTACT:
        return {**OF_CONTACT, **{name: contact.structure(name, dim) for name in ("Mover", "Pair")}}
    own = {"driver": OF_CORE, "implicit_schemes": OF_IMPLICIT, "schemes": OF_SCHEMES}.get(unit, {})
    return {**own, **{name: structure(name, dim) for name in OF_TABLES}}


def statements(name: str, kind: type[ctypes.Structure]) -> list[str]:
    """Where its fields begin, and how long a structure is, for a compiler to judge."""
    places = [f"__builtin_offsetof({name}, {field}) == {getattr(kind, field).offset}" for field, *_ in kind._fields_]
    return [*places, f"sizeof({name}) == {ctypes.sizeof(kind)}"]


def said_of(text: str, *flags: str) -> str:
    """What the compiler says of a source."""
    command = [*(compiler() or ()), "-std=gnu11", *flags, "-fsyntax-only", "-x", "c", "-"]
    return subprocess.run(command, input=text, capture_output=True, text=True, check=False).stderr[:2000]


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("unit", [*CORE, CONTACT, IMPLICIT])
def test_structures_are_those_of_the_compiler(dim: int, unit: str) -> None:
    claims = [x for name, kind in told(dim, unit).items() for x in statements(name, kind)]
    text = _source(dim, unit) + "".join(f'\n_Static_assert({x}, "{x}");' for x in claims)
    assert not said_of(text, f"-DDIM={dim}")


def test_enumerations_count_on_from_what_is_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tables.h").write_text(
        "#if DIM == 3\nenum { D = 3 };\n#else\nenum { D = 2 };\n#endif\n"
        "enum { FIRST, SECOND = D + 2 * D, THIRD /* not 1 */ };\n"
        "static const double SMALL = 1e-3, TINY = 0.5; /* each */\n"
        "static const double BOTH[] = {1.0, -2.0};\n"
        "typedef struct {\n    const double *x, y[D]; /* z; */\n    int (*python)(int what);\n} Both;\n"
    )
    monkeypatch.setattr(declarations, "DRIVER", tmp_path)
    cached = (
        declarations._text, declarations._enumerations, declarations._constants, declarations._structures, declarations._reals
    )  # fmt: skip
    for one in cached:
        one.cache_clear()
    try:
        assert declarations.enumeration("FIRST") == {"FIRST": 0, "SECOND": 9, "THIRD": 10}
        assert declarations.constants("tables.h", "TINY", "SMALL") == (0.5, 1e-3)
        assert declarations.array_of("tables.h", "BOTH") == (1.0, -2.0)
        assert declarations.fields_of("tables.h", "Both", 2) == [
            ("x", ctypes.c_void_p), ("y", ctypes.c_double * 2), ("python", declarations.PYTHON)
        ]  # fmt: skip
    finally:
        for one in cached:
            one.cache_clear()
