"""The work-precision figure of the README, made in the five lines printed there.

Run:  PYTHONPATH=tests:tests/benchmarks:demos ./with-dolfinx python3 docs/scripts/work_precision.py
"""

from pathlib import Path

from observatory_motions import double

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import study

PICTURE = Path(__file__).resolve().parents[1] / "pictures/work_precision.png"
README = Path(__file__).resolve().parents[2] / "README.md"


def script() -> str:
    """The five lines, from the README."""
    return (
        README.read_text()
        .split("<!-- docs/scripts/work_precision.py runs this -->")[1]
        .split("```")[1][len("python\n") :]
    )


if __name__ == "__main__":
    exec(script().replace("work.png", str(PICTURE)), {"fmbd": fmbd, "study": study, "scene": double()})
