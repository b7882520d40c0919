"""What every demo script shares: its flags, a check line for each figure, and the JSON file that tests read.

A demo opens with ``args = demo.arguments(__doc__)`` and ends with ``demo.finish(checks, run, args)``. Demos that show their scene
call :func:`show` in between, or :func:`film` where they draw a picture of their own; snapshots come from
``output=demo.snapshots(args)``.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..log import say
from ..ranks import world_rank
from ..run.recording.output import Output

__all__ = ["Check", "arguments", "film", "finish", "say", "show", "snapshots"]


def __dir__() -> list[str]:
    """What is public here."""
    return __all__


@dataclass(frozen=True)
class Check:
    """A figure of a demo: it passes when |value - reference| <= tolerance (all in the same unit).

    A bound is a check against 0 (``Check("drift", drift, 0.0, 1e-10)``); see :meth:`relative` for a relative
    tolerance, :meth:`at_least` for what may be larger.
    """

    name: str
    value: float
    reference: float
    tolerance: float = 0.0
    least: bool = False

    @classmethod
    def relative(cls, name: str, value: float, reference: float, tolerance: float) -> Check:
        """A check with a tolerance relative to |reference|."""
        return cls(name, value, reference, tolerance * abs(float(reference)))

    @classmethod
    def at_least(cls, name: str, value: float, least: float) -> Check:
        """Passes when value >= least: an order, or by how much something is worse."""
        return cls(name, value, least, least=True)

    @property
    def ok(self) -> bool:
        """Whether the figure is finite and within its tolerance, up to roundoff of the difference."""
        roundoff = 4 * math.ulp(float(self.reference)) if self.reference else 0.0
        within = abs(self.value - self.reference) <= self.tolerance + roundoff
        return math.isfinite(self.value) and bool(self.value >= self.reference if self.least else within)

    def __str__(self) -> str:
        verdict = "ok" if self.ok else "FAILED"
        target = (
            f"at least {self.reference:.8g}"
            if self.least
            else f"reference {self.reference:.8g} +- {self.tolerance:.2g}"
        )
        return f"check {self.name}: {self.value:.8g}, {target}: {verdict}"

    def as_dict(self) -> dict[str, Any]:
        """The entry of the JSON file."""
        return {
            "name": self.name,
            "value": float(self.value),
            "reference": float(self.reference),
            "tolerance": float(self.tolerance),
            "ok": self.ok,
        }


def arguments(description: str | None, own: Mapping[str, Any] | None = None) -> argparse.Namespace:
    """Flags of a demo from the command line: ``--fast``, ``--json FILE``, ``--picture FILE``, ``--animate FILE``, and the
    demo's own; ``title`` is the first line of the description, for figures.

    Args:
        description: the demo's docstring, shown by ``--help``.
        own: flag -> default. False makes a switch, a tuple lists the choices (its first is the default), any
            other default gives the type: ``{"--study": False, "--dim": (2, 3), "--steps": 100}``.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fast", action="store_true", help="a small version that ends within seconds")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write checks, counters and seconds to FILE")
    parser.add_argument("--picture", metavar="FILE", type=Path, help="write a picture to FILE")
    parser.add_argument("--animate", metavar="FILE", type=Path, help="write an animation to FILE: .gif, .mp4 or .html")

    # the default tells what kind of flag it is
    for flag, default in (own or {}).items():
        if default is False:
            parser.add_argument(flag, action="store_true")
        elif isinstance(default, tuple):
            kind = type(default[0])
            parser.add_argument(flag, type=kind, choices=default, default=default[0], help=f"default {default[0]}")
        else:
            parser.add_argument(flag, type=type(default), default=default, help=f"default {default}")

    args = _parsed(parser)
    args.title = (description or "").strip().split("\n")[0].rstrip(".")
    args.filmed = False
    if args.fast:
        args.title += " (fast version)"
    return args


def _parsed(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """What the command line says; help and mistakes are printed once."""
    if world_rank() == 0:
        return parser.parse_args()
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
        return parser.parse_args()


def snapshots(args: argparse.Namespace, count: int = 100, **more: Any) -> Output:
    """What a demo records: snapshots where a picture or an animation is asked for, and what else the demo wants."""
    wanted = count if args.picture or args.animate else 0

    return Output(snapshots=wanted, **more)


def show(run: Any, args: argparse.Namespace, sensors: Sequence[str] = (), **look: Any) -> None:
    """Write the picture and the animation that were asked for; collective.

    ``look``: view, paint and seconds as for ``run.animate``, reference as for ``run.picture``.
    """
    reference = look.pop("reference", None)
    seconds = look.pop("seconds", None)
    if args.picture:
        run.picture(args.picture, sensors=sensors, reference=reference, **look)
    film(run, args, sensors, seconds=seconds, **look)


def film(run: Any, args: argparse.Namespace, sensors: Sequence[str] = (), **look: Any) -> None:
    """Write the animation where one was asked for: of demos that draw a picture of their own; collective."""
    if args.animate:
        run.animate(args.animate, sensors=sensors, **look)
        args.filmed = True


def finish(checks: Sequence[Check], run: Any, args: argparse.Namespace) -> None:
    """Print the report of the run and one line for each check, and write the JSON file, on rank 0; exit with
    code 1 on all ranks when a check fails, or when an animation was asked for of what does not move.

    ``run`` gives the report, ``counters`` and ``seconds``, and the animation where the demo has not made one; None for a demo
    that has no single run. Values must be equal on all ranks.
    """
    still = args.animate is not None and not args.filmed
    if still and run is not None and len(run.snapshots) > 1:
        film(run, args)
        still = False

    if run is not None:
        say(run.report())
    for check in checks:
        say(check)

    if args.json is not None and world_rank() == 0:
        content = {
            "check": [c.as_dict() for c in checks],
            "counters": {} if run is None else {k: float(x) for k, x in run.counters.items()},
            "seconds": {} if run is None else {k: float(x) for k, x in run.seconds.items()},
        }
        if getattr(run, "error_estimate", None):
            content["certificate"] = run.certificate.as_dict()
        args.json.write_text(json.dumps(content, indent=1) + "\n")

    if still:
        say(f"no animation in {args.animate}: this demo compares results, it keeps no motion to show. Try --picture.")
    if still or not all(c.ok for c in checks):
        sys.exit(1)
