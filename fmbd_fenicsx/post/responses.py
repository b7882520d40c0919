"""Bode's and Nyquist's figures of linear models. Rank 0 writes, no window opens."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..analysis.vibration.linear_model import LinearModel
from ..checks import typed
from ..errors import require
from ..rotations import Array
from .figures import figure


@typed
def bode(model: LinearModel, file: str | Path, omega: Sequence[float] | Array, *, title: str = "") -> None:
    """Write amplitude (logarithmic) and phase (degrees) over the angular frequency (rad/s), a curve for each pair of input and
    output.
    """
    omega = _frequencies(omega)
    H = model.frequency_response(omega)
    with figure(file, 2, 1, title=title) as (amplitude, phase):
        for label, h in _pairs(model, H):
            amplitude.loglog(omega, np.abs(h), label=label)
            phase.semilogx(omega, np.degrees(np.unwrap(np.angle(h))))
        amplitude.set_ylabel("amplitude")
        phase.set(xlabel="angular frequency (rad/s)", ylabel="phase (degrees)")


@typed
def nyquist(model: LinearModel, file: str | Path, omega: Sequence[float] | Array, *, title: str = "") -> None:
    """Write H(i omega) in the complex plane, from the lowest frequency (dot) to the highest, and the critical point -1."""
    omega = _frequencies(omega)
    H = model.frequency_response(omega)
    with figure(file, size=(6.0, 5.5), title=title) as axes:
        for label, h in _pairs(model, H):
            (curve,) = axes.plot(h.real, h.imag, label=label)
            axes.plot(h.real[:1], h.imag[:1], "o", color=curve.get_color())
        axes.plot(-1.0, 0.0, "k+", markersize=10)
        axes.set(xlabel="real part", ylabel="imaginary part")


def _frequencies(omega: Sequence[float] | Array) -> Array:
    """Checked angular frequencies."""
    found = np.atleast_1d(np.asarray(omega, dtype=float))
    good = len(found) >= 2 and bool(np.isfinite(found).all()) and bool((found > 0.0).all())
    require(good, f"A frequency response is drawn over at least two positive frequencies (rad/s), found {omega!r:.80}.")
    return found


def _pairs(model: LinearModel, H: Array) -> list[tuple[str, Array]]:
    """Label and response (n,) of every pair."""
    return [(f"{o} / {i}", H[:, a, b]) for a, o in enumerate(model.outputs) for b, i in enumerate(model.inputs)]
