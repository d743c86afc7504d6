# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `probe_cycle`: the file of the cycle, and results that the control writes into a file."""

from collections import deque
from pathlib import Path

from rclpy.node import Node

from fuzzycnc_ros.adapters.probing.result_file import ResultFile
from fuzzycnc_ros.adapters.probing.touches import touch_of
from fuzzycnc_ros.components.probing.probe_cycle import ProbeCycle
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.host import ComponentNode
from fuzzycnc_ros.ros.topics import RCLPY, SUBSCRIPTION_DEPTH, create_publisher
from fuzzycnc_ros.runtime.component import STREAM, Health
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.records import ProbeTouch

AT_ONCE = SUBSCRIPTION_DEPTH // 2
"""Most results that are published at one look: a reader keeps twice as many."""
POLL = 0.1
"""Wall time [s] between two looks at the result file."""


NEWS = (ProbeCycle.REFERENCE.name, ProbeCycle.STATUS.name)
"""Inputs that are worth work alone."""


class ProbeCycleNode(ComponentNode):
    """Serve the probing cycle."""

    component: ProbeCycle

    def __init__(self, node: Node) -> None:
        super().__init__(node, ProbeCycle)
        config = self.component.configuration
        self._plan = _plan(config.probe_file) if config.probe_file else ''
        self._results: ResultFile | None = None
        self._unheard = False
        if config.result_file:
            self._results = ResultFile(Path(config.result_file).expanduser())
            self._publisher = create_publisher(node, ProbeTouch.TYPE, 'probe_touch', STREAM)
            self._newest = 0
            self._waiting: deque[tuple[float, float]] = deque()
            wall_timer(node, POLL, self._read)

    def start(self) -> None:
        """Hand the plan over."""
        super().start()
        if self._plan:
            self.request('use_plan', {'plan': self._plan})

    def on_heard(self, topic: str, sequence_number: int) -> None:
        """Note that there is news: no touch, which drives, may come for hours."""
        super().on_heard(topic, sequence_number)
        self._unheard |= topic.rpartition('/')[2] in NEWS

    def on_poll(self) -> None:
        """Work up to what was heard, also where nothing drives."""
        super().on_poll()
        newest = max(self.merger.counts[name].newest or 0 for name in NEWS)
        if self._unheard and newest <= self.now():
            self._unheard = False
            self.work(newest)
            self.note_deadline(newest)

    def own_health(self) -> list[Health]:
        """Report on the result file."""
        return [] if self._results is None else [self._results.health()]

    def _read(self) -> None:
        """Publish what the control has written, a few at a time: it may write all at the end."""
        assert self._results is not None
        self._waiting.extend(self._results.read())
        for _ in range(min(AT_ONCE, len(self._waiting))):
            code, value = self._waiting.popleft()
            self._newest = max(self.now(), self._newest + 1)
            touch = touch_of(
                self._newest,
                self.component.frame('machine'),
                code,
                value,
                includes_offset=self.component.configuration.result_offset,
            )
            if touch is not None:
                self._publisher.publish(encode(touch, RCLPY))


def _plan(name: str) -> str:
    """Return the plan of a probe file as text."""
    # What reads it is no part of every installation.
    from fuzzycnc_ros.adapters.probing.probe_file import read_plan

    return read_plan(Path(name).expanduser()).to_json()


def make() -> ProbeCycleNode:
    """Create the node."""
    return ProbeCycleNode(Node(ProbeCycle.NAME))


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
