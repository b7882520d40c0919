"""Series that compiled code writes itself, record by record, behind what a run has recorded so far."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ...system.compiled.recording import Numbers, Recorded
from ...system.compiled.tape import Tape
from .rows import Records

if TYPE_CHECKING:
    from .recorder import Recorder

Key = tuple[str, str]  # time, sensor or energy, and the name of the sensor or kind
TIME: Key = "time", ""


class Straight:
    """What is recorded of one run and is told in the records of compiled steps as it is."""

    def __init__(self, recorder: Recorder) -> None:
        self.recorder = recorder
        self.tape: Tape | None = None
        self.shapes: dict[Key, tuple[int, ...]] = {}  # of a record, by where it goes to
        self.single = False  # whether nothing else is recorded
        self._count = 0  # of all that is asked for

    def lead(self, tape: Tape, more: int) -> None:
        """The next march of at most so many records writes them where they belong."""
        r = self.recorder
        if self.tape is not tape:
            self.tape, self.shapes = tape, tape.follow(self._asked)
            looks = tape.tables.looks
            known = all(id(sensor) in looks.of for sensor in r.scene.sensors.values())
            known = known and (looks.energies_known or not r.output.energy)
            self.single = known and len(self.shapes) == self._count
        tape.prolong([self._rows(key).end(more, r.expected, x) for key, x in self.shapes.items()], single=self.single)

    def take(self, count: int) -> None:
        """Take over so many records."""
        for key in self.shapes:
            self._rows(key).filled += count

    def _asked(self, seen: Recorded) -> dict[Key, Numbers]:
        """What is recorded and compiled code knows of it, by where it goes to."""
        r = self.recorder
        out: dict[Key, Numbers] = {TIME: (seen.t, 1.0)}
        for name, sensor in r.scene.sensors.items():
            if id(sensor) in seen.looks.of:
                out["sensor", name] = sensor.numbers(seen, r.markers[name])
        if r.output.energy:
            out |= {("energy", kind): (x, 1.0) for kind, x in seen.written.items()}
        self._count = len(out)
        return out

    def _rows(self, key: Key) -> Records:
        """Where it goes to."""
        what, name = key
        if key == TIME:
            return self.recorder.moments
        rows: dict[str, Any] = self.recorder.values if what == "sensor" else self.recorder.energies
        return rows.setdefault(name, Records())
