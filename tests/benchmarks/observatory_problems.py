"""All problems of the observatory by name."""

from __future__ import annotations

from observatory_fields import FIELDS
from observatory_motions import MOTIONS
from observatory_oscillators import OSCILLATORS
from observatory_problem import Problem

PROBLEMS: dict[str, Problem] = {**MOTIONS, **OSCILLATORS, **FIELDS}
