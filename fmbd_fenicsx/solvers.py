"""Linear solvers of a step: which factors, preconditioners and iterations; Newton's iteration."""

from .linear.blocks.elastic_blocks import Bddc, Cholesky, Multigrid
from .linear.presets import Direct, FieldSplit, Schur
from .schemes.newton import ExactTangent, Newton

__all__ = ["Bddc", "Cholesky", "Direct", "ExactTangent", "FieldSplit", "Multigrid", "Newton", "Schur"]
