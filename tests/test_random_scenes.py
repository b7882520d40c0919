"""Random scenes: every run is right by an independent look, ends with an error of the package, or has warned; none hangs."""

from __future__ import annotations

import logging
import os
import signal
import warnings
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
import random_combined
import random_flexible
import random_mechanisms
import random_scenes

from fmbd_fenicsx.errors import FmbdError
from fmbd_fenicsx.log import log

SECONDS = 30.0  # of processor time that one scene may take
FINE = ("right", "refused", "warned", "unjudged")
UNJUDGED = 0.01  # share of runs that may end while the integration that judges them does not
FEW, FEW_MECHANISMS, FEW_FLEXIBLE, FEW_COMBINED = 40, 12, 8, 8
MANY = int(os.environ.get("FMBD_RANDOM_SCENES", "5000"))
MANY_MECHANISMS = int(os.environ.get("FMBD_RANDOM_MECHANISMS", "1000"))
MANY_FLEXIBLE = int(os.environ.get("FMBD_RANDOM_FLEXIBLE", "300"))
MANY_COMBINED = int(os.environ.get("FMBD_RANDOM_COMBINED", "300"))
Draw = Callable[[int], Any]


class _Warnings(logging.Handler):
    """Counts warnings."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.count += 1


def outcome(draw: Draw, number: int) -> str:
    """How one random scene ends: right, refused, warned, or what is wrong; unjudged where the judge finds no end."""
    heard, run = _Warnings(), None

    def late(*_: Any) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGPROF, late)
    log.addHandler(heard)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            made = draw(number)
            run = made.run()
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        found = made.wrong(run)  # its own integration may take long too
    except FmbdError:
        return "refused"
    except TimeoutError:
        late_judge = "unjudged" if run is not None else f"no end within {SECONDS:g} s"
        return "warned" if heard.count else late_judge
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
        log.removeHandler(heard)
    if not found:
        return "right"
    return "warned" if heard.count else found


def judged(tally: Counter[str]) -> None:
    """The number of each outcome, printed; nothing else than those that are fine, and most runs right."""
    print("\n" + ", ".join(f"{n} {what}" for what, n in tally.most_common()))
    assert set(tally) <= set(FINE)
    assert tally["unjudged"] <= UNJUDGED * tally.total()
    assert tally["right"] > 0.8 * tally.total()


def tallied(draw: Draw, count: int) -> Counter[str]:
    """How so many scenes end."""
    tally: Counter[str] = Counter()
    for number in range(count):
        found = outcome(draw, number)
        tally[found if found in FINE else f"scene {number}: {found}"] += 1
    return tally


def test_random_scenes() -> None:
    """The first scenes, each named by its number."""
    judged(tallied(random_scenes.case, FEW))


def test_random_mechanisms() -> None:
    """The same of mechanisms in the plane and in space, on all kinds of joints and forces."""
    judged(tallied(random_mechanisms.case, FEW_MECHANISMS))


def test_random_flexible() -> None:
    """The same of rods, lines, wires, fields, rolling bodies, stops and contacts."""
    judged(tallied(random_flexible.case, FEW_FLEXIBLE))


def test_random_combined() -> None:
    """The same of chains of all kinds of bodies with all that acts on them."""
    judged(tallied(random_combined.case, FEW_COMBINED))


def test_states_after_a_restart_are_judged_as_before() -> None:
    """A bar for forces out of balance, by all motion so far, that a state near rest would not pass by its own."""
    random_mechanisms.case(824).taken_up()


def test_steps_of_own_choice_are_taken_up_where_they_are_made_many_in_a_call() -> None:
    """Times at the parts of a stretch are those of single steps, and with them all that depends on time, to the last bit."""
    random_mechanisms.case(182).taken_up()


@pytest.mark.slow
@pytest.mark.timeout(0)
@pytest.mark.parametrize(
    "draw, count",
    [
        (random_scenes.case, MANY),
        (random_mechanisms.case, MANY_MECHANISMS),
        (random_flexible.case, MANY_FLEXIBLE),
        (random_combined.case, MANY_COMBINED),
    ],
    ids=["scenes", "mechanisms", "flexible", "combined"],
)
def test_many_random_scenes(draw: Draw, count: int) -> None:
    judged(tallied(draw, count))
