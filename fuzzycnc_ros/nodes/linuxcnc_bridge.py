# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `linuxcnc_bridge`: reads LinuxCNC in every cycle, also while it is not active.

What is applied is known before anybody commands anything.  Pins are written in the active state
alone, and after it until the offsets are at zero.  LinuxCNC may end and come back meanwhile: each
connection is a fresh one.
"""

import time
from collections.abc import Mapping
from typing import Any

from fuzzycnc_ros.bridges.linuxcnc import Linuxcnc, LinuxcncError, linuxcnc_runs
from fuzzycnc_ros.components.component import Answer
from fuzzycnc_ros.components.linuxcnc_bridge import LinuxcncBridge
from fuzzycnc_ros.components.linuxcnc_bridge_config import LinuxcncBridgeConfig
from fuzzycnc_ros.components.records import nanoseconds
from fuzzycnc_ros.nodes import run
from fuzzycnc_ros.nodes.managed import ManagedComponentNode
from fuzzycnc_ros.nodes.timers import wall_timer

SOON = 0.002
"""Wall time [s] between two cycles while LinuxCNC is on its way: the read-back comes sooner."""
RETRY = 1.0
"""Wall time [s] between two tries to connect, or to take the pins."""


class LinuxcncBridgeNode(ManagedComponentNode):
    """Serve the bridge and its connection to LinuxCNC."""

    component: LinuxcncBridge

    def __init__(self) -> None:
        super().__init__(LinuxcncBridge)
        config = self.component.configuration
        assert isinstance(config, LinuxcncBridgeConfig)
        self._controller: Linuxcnc | None = None
        self._claimed = False
        self._why = 'LinuxCNC does not run here'
        self._tried_at = self._claim_at = -RETRY
        if self.settings.lockstep:
            self.troubles['lockstep'] = 'LinuxCNC keeps its own time: in lock-step it is not read'
        else:
            self._timer = wall_timer(self.node, config.cycle_period, self._on_timer)

    def start(self) -> None:
        """Look for LinuxCNC before anybody activates the node."""
        if not self.settings.lockstep:
            for _ in range(10):
                self._cycle()
        super().start()

    def stop(self) -> None:
        """Let the servo thread take to zero what still stands, then end."""
        if self._controller is not None:
            try:
                self._controller.release()
            except LinuxcncError as error:
                self.node.get_logger().warning(str(error))
            self._controller.close()
        super().stop()

    def request(self, name: str, arguments: Mapping[str, Any]) -> Answer:
        """Carry out a request; refuse to be activated beside another writer of the pins."""
        if name == 'activate' and self._controller is not None and not self._claimed:
            trouble = self._claim(self._controller)
            if trouble:
                return Answer(False, trouble)
        answer = super().request(name, arguments)
        if self._claimed and self.component.active and not self.component.holding:
            self.component.take_pins()
        return answer

    def _heard(self, topic: str, sequence_number: int) -> None:
        """Act on a command at once."""
        super()._heard(topic, sequence_number)
        if not self.settings.lockstep:
            # A command says when it takes effect; it is handed over as it comes.
            newest = self.merger.counts['compensation'].newest
            self._work(max(self.merger.time, newest or 0))
            self._on_timer()

    def _on_timer(self) -> None:
        """Make a cycle; look again soon while LinuxCNC is on its way."""
        self._cycle()
        config = self.component.configuration
        assert isinstance(config, LinuxcncBridgeConfig)
        wait = min(config.cycle_period, SOON) if self.component.moving else config.cycle_period
        self._timer.timer_period_ns = nanoseconds(wait)
        self._timer.reset()

    def _cycle(self) -> None:
        """Read LinuxCNC, work, write."""
        try:
            controller = self._controller or self._connect()
            output = self.component.orders if self._claimed else None
            if self._claimed and output is None:
                controller.release()
                self._claimed = False
            status = controller.read() if output is None else controller.write(output)
        except LinuxcncError as error:
            self._lose(str(error))
            return
        self.publish(self.component.observe(self._now(), status))
        if self.component.wants_pins and time.monotonic() - self._claim_at > RETRY:
            trouble = self._claim(controller)
            if trouble:
                self.troubles['pins'] = trouble
            else:
                self.component.take_pins()

    def _connect(self) -> Linuxcnc:
        """Connect anew, from time to time.

        Raises
        ------
        LinuxcncError
            If LinuxCNC is not there.
        """
        now = time.monotonic()
        if now - self._tried_at < RETRY:
            raise LinuxcncError(self._why)
        self._tried_at = now
        if not linuxcnc_runs():
            raise LinuxcncError('LinuxCNC does not run here')
        config = self.component.configuration
        assert isinstance(config, LinuxcncBridgeConfig)
        self._controller = Linuxcnc(config.axes, config.interpreter)
        self.node.get_logger().info('connected to LinuxCNC')
        return self._controller

    def _lose(self, why: str) -> None:
        """Let go of a connection that is broken."""
        if why != self._why:
            self.node.get_logger().warning(why)
        self._why = why
        if self._controller is not None:
            self._controller.close()
        self._controller, self._claimed = None, False
        self.publish(self.component.lose(self._now(), why))

    def _claim(self, controller: Linuxcnc) -> str:
        """Become the writer of the pins; say why not."""
        self._claim_at = time.monotonic()
        try:
            trouble = self.component.refusal(controller.limits(), controller.read())
            if trouble:
                return trouble
            controller.claim()
        except LinuxcncError as error:
            return str(error)
        self._claimed = True
        self.troubles.pop('pins', None)
        return ''


def make() -> LinuxcncBridgeNode:
    """Create the node."""
    return LinuxcncBridgeNode()


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
