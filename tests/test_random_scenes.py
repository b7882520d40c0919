"""Random scenes: every run is right by an independent look, ends with an error of the package, or has warned; none hangs."""

from __future__ import annotations

import logging
import os
import signal
import warnings
from collections import Counter
from typing import Any

import pytest
from random_scenes import case

from fmbd_fenicsx.errors import FmbdError
from fmbd_fenicsx.log import log

SECONDS = 30.0  # of processor time that one scene may take
FINE = ("right", "refused", "warned")
FEW = 40
MANY = int(os.environ.get("FMBD_RANDOM_SCENES", "5000"))


class _Warnings(logging.Handler):
    """Counts warnings."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.count += 1


def outcome(number: int) -> str:
    """How one random scene ends: right, refused, warned, or what is wrong."""
    heard = _Warnings()

    def late(*_: Any) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGPROF, late)
    log.addHandler(heard)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            made = case(number)
            run = made.run()
        found = made.wrong(run)  # its own integration may take long too
    except FmbdError:
        return "refused"
    except TimeoutError:
        return "warned" if heard.count else f"no end within {SECONDS:g} s"
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
    assert tally["right"] > 0.8 * tally.total()


def test_random_scenes() -> None:
    """The first scenes, each named by its number."""
    judged(tallied(FEW))


def tallied(count: int) -> Counter[str]:
    """How so many scenes end."""
    tally: Counter[str] = Counter()
    for number in range(count):
        found = outcome(number)
        tally[found if found in FINE else f"scene {number}: {found}"] += 1
    return tally


@pytest.mark.slow
@pytest.mark.timeout(0)
def test_many_random_scenes() -> None:
    judged(tallied(MANY))
