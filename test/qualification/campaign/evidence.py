# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the bags of a campaign show: records in the order in which they were recorded.

Faults move clocks, so that stamps say nothing of the order.  What belongs to a scenario stands
between two marks that the campaign publishes itself.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from campaign.relay import direct
from fuzzycnc_ros.bags.errors import BagTruncatedError
from fuzzycnc_ros.bags.mcapfile import McapFile
from fuzzycnc_ros.bags.metadata import storage_files
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.recorder import SequenceCounter
from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.runtime.component import STREAM
from fuzzycnc_ros.runtime.convert import decode
from fuzzycnc_ros.runtime.records import (
    AxisCommand,
    AxisState,
    CompensatedPath,
    Compensation,
    CompensationApplied,
    MachineState,
    ServoState,
    ThermalError,
    ToolPath,
    Trajectory,
    TrajectoryState,
)

MARKS = 'fault_marks'
"""Topic of the marks: `begin <scenario>` and `end <scenario>`."""
RECORDS = {
    'compensation': Compensation,
    'compensation_applied': CompensationApplied,
    'thermal_error': ThermalError,
    'machine_state': MachineState,
    'axis_state': AxisState,
    'tool_path': ToolPath,
    'trajectory': Trajectory,
    'trajectory_state': TrajectoryState,
    'axis_command': AxisCommand,
    'servo_state': ServoState,
    'compensated_path': CompensatedPath,
}
"""Topics that a scenario is judged by."""

STREAMS = frozenset(
    item.name for c in COMPONENTS.values() for item in c.OUTPUTS if item.durability is STREAM
)
"""Topics with one publisher, whose numbers show what is missing: those of several nodes at once,
such as /diagnostics, cannot be told apart."""

OPEN = 2**62
"""End of a window whose end has not been recorded."""


@dataclass(frozen=True)
class Recorded:
    """One message: when it was recorded, counted from the first, and its publisher's number."""

    place: int
    sequence: int
    record: Any


@dataclass
class Window:
    """The part of a recording that belongs to one scenario; places as in `Recorded`."""

    begin: int
    end: int

    def of(self, items: Sequence[Recorded], before: int = 0) -> list[Recorded]:
        """Return what was recorded in the window, and some records before it."""
        inside = [item for item in items if self.begin <= item.place < self.end]
        earlier = [item for item in items if item.place < self.begin]
        return earlier[len(earlier) - before :] + inside if before else inside


@dataclass
class Evidence:
    """All that was recorded of a graph.

    Attributes
    ----------
    records : dict of str to list of Recorded
        By topic, without namespace.
    told : list of (int, int, str, str)
        Place, level, item and text of every diagnostic status.
    lost : list of int
        Places at which a message is missing by the numbers of its publisher.
    windows : dict of str to Window
        By scenario.
    """

    records: dict[str, list[Recorded]] = field(default_factory=lambda: defaultdict(list))
    told: list[tuple[int, int, str, str]] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    windows: dict[str, Window] = field(default_factory=dict)
    _place: int = 0

    @classmethod
    def from_bags(cls, bags: Sequence[Path], machine: str) -> 'Evidence':
        """Read bags that were recorded one after the other; a torn one is repaired beside it.

        Raises
        ------
        BagError
            If one cannot be read.
        """
        found = cls()
        for bag in bags:
            found._read(bag, f'/{machine}/')
        return found

    def sent(self, topic: str) -> list[Recorded]:
        """Return what the publisher of a topic sent, whatever a relay made of it."""
        own = self.records.get(direct(topic))
        return own if own else self.records.get(topic, [])

    def _read(self, bag: Path, space: str) -> None:
        path = whole(bag)
        counters: dict[str, SequenceCounter] = defaultdict(SequenceCounter)
        wanted = {f'{space}{name}': (name, kind) for name, kind in RECORDS.items()}
        wanted |= {f'{space}{direct(n)}': (direct(n), kind) for n, kind in RECORDS.items()}
        with BagReader(path) as reader:
            for file in storage_files(path):
                with McapFile(file) as mcap:
                    for block in mcap.contents().blocks:
                        for raw in block.read():
                            self._take(raw, reader, counters, wanted, space)

    def _take(
        self, raw: Any, reader: BagReader, counters: Any, wanted: dict[str, Any], space: str
    ) -> None:
        self._place += 1
        topic = raw.channel.topic
        if topic.removeprefix(space).removeprefix(direct('')) in STREAMS:
            counter = counters[topic]
            before = counter.missing
            counter.update(raw.sequence)
            self.lost += [self._place] * (counter.missing - before)
        if topic not in wanted and topic not in ('/diagnostics', f'{space}{MARKS}'):
            return
        message = reader.decoder.decode(raw.channel.type)(raw.payload)
        if topic in wanted:
            name, kind = wanted[topic]
            self.records[name].append(Recorded(self._place, raw.sequence, decode(kind, message)))
        elif topic == '/diagnostics':
            for status in message.status:
                self.told.append((self._place, int(status.level), status.name, status.message))
        else:
            # A recorder that is started anew gets all earlier marks again.
            word, _, name = message.data.partition(' ')
            window = self.windows.setdefault(name, Window(self._place, OPEN))
            if word == 'end' and window.end == OPEN:
                window.end = self._place


def whole(bag: Path) -> Path:
    """Return a bag, or what could be read of it where it was torn, repaired beside it."""
    target = bag.with_name(f'{bag.name}_whole')
    try:
        BagReader(bag).close()
    except BagTruncatedError:
        if not target.exists():
            repair(bag, target)
        return target
    return bag
