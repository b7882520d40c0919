"""Time integration: one-step and multistep schemes, schemes with impacts; forms, consistent starts, Newton, step control."""

from .._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
