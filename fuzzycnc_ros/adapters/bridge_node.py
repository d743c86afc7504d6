# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node of every bridge: reads the controller in every cycle, also while not active.

What is applied is known before anybody commands anything.  Offsets are written in the active state
alone, and after it until they are at zero.  The controller may end and come back meanwhile: each
connection is a fresh one.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

from fuzzycnc_ros.adapters.controller import Controller
from fuzzycnc_ros.adapters.controller_bridge import ControllerBridge
from fuzzycnc_ros.adapters.link import LinkError
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.lifecycle import ManagedComponentNode
from fuzzycnc_ros.runtime.component import Answer
from fuzzycnc_ros.runtime.records import nanoseconds

CLAIM_AGAIN = 1.0
"""Wall time [s] between two tries to become the writer."""


class ControllerBridgeNode(ManagedComponentNode, ABC):
    """Serve a bridge and its connection to the controller."""

    component: ControllerBridge[Any, Any, Any]
    RETRY_FIRST: ClassVar[float]
    """Wall time [s] from a try to connect to the next; it doubles with each that fails."""
    RETRY_MAX: ClassVar[float]
    """Longest such time [s]."""

    def __init__(self, component_type: type[ControllerBridge[Any, Any, Any]]) -> None:
        super().__init__(component_type)
        self._controller: Controller[Any, Any, Any] | None = None
        self._claimed = False
        self._why = f'{component_type.CONTROLLER} has not been found yet'
        self._pause = self.RETRY_FIRST
        self._connect_at = self._claim_at = 0.0
        if self.node.get_parameter('use_sim_time').value:
            self.component.in_simulated_time()
        if self.settings.lockstep:
            self.troubles['lockstep'] = (
                f'{component_type.CONTROLLER} keeps its own time: in lock-step it is not read'
            )
        else:
            self._timer = wall_timer(self.node, self._wait(), self._on_timer)

    @abstractmethod
    def _open(self) -> Controller[Any, Any, Any]:
        """Make a connection.

        Raises
        ------
        LinkError
            If the controller is not there.
        """

    @abstractmethod
    def _wait(self) -> float:
        """Return the wall time to the next cycle [s]."""

    @abstractmethod
    def _before_activation(self, controller: Controller[Any, Any, Any]) -> str:
        """Do what belongs before the activation; say why it is refused."""

    @abstractmethod
    def _refusal(self, controller: Controller[Any, Any, Any]) -> str:
        """Say why offsets must not be written; empty if they may."""

    def stop(self) -> None:
        """Let the controller take to zero what still stands, then end."""
        if self._controller is not None:
            try:
                self._controller.release()
            except LinkError as error:
                self.node.get_logger().warning(str(error))
            self._controller.close()
        super().stop()

    def request(self, name: str, arguments: Mapping[str, Any]) -> Answer:
        """Carry out a request; refuse to be activated beside another writer."""
        if name == 'activate' and self._controller is not None and not self._claimed:
            trouble = self._before_activation(self._controller)
            if trouble:
                return Answer(False, trouble)
        answer = super().request(name, arguments)
        if self._claimed and self.component.active and not self.component.holding:
            self.component.take_control()
        return answer

    def on_heard(self, topic: str, sequence_number: int) -> None:
        """Act on a command at once."""
        super().on_heard(topic, sequence_number)
        if not self.settings.lockstep:
            # A command says when it takes effect; it is handed over as it comes.
            newest = max(item.newest or 0 for item in self.merger.counts.values())
            self.work(max(self.merger.time, newest))
            self._on_timer()

    def _on_timer(self) -> None:
        """Make a cycle, and set when the next one is."""
        self._cycle()
        self._timer.timer_period_ns = nanoseconds(self._wait())
        self._timer.reset()

    def _cycle(self) -> None:
        """Read the controller, work, write."""
        try:
            controller = self._controller or self._connect()
            orders = self.component.orders if self._claimed else None
            controller.probe_due = self.component.probe_due
            if self._claimed and orders is None:
                controller.release()
                self._claimed = False
            status = controller.read() if orders is None else controller.write(orders)
        except LinkError as error:
            self._lose(error)
            return
        if status is None:
            return
        self._pause = self.RETRY_FIRST
        self.follow_clock()
        self.publish(self.component.observe(self.now(), status))
        if self.component.wants_control and time.monotonic() - self._claim_at > CLAIM_AGAIN:
            trouble = self._claim(controller)
            if trouble:
                self.troubles['claim'] = trouble
            else:
                self.component.take_control()

    def _connect(self) -> Controller[Any, Any, Any]:
        """Connect anew, from time to time.

        Raises
        ------
        LinkError
            If the controller is not there.
        """
        now = time.monotonic()
        if now < self._connect_at:
            raise LinkError(self._why)
        self._connect_at = now + self._pause
        self._pause = min(2.0 * self._pause, self.RETRY_MAX)
        self._controller = self._open()
        return self._controller

    def _lose(self, error: LinkError) -> None:
        """Let go of a connection that is broken."""
        if str(error) != self._why:
            self.node.get_logger().warning(str(error))
        self._why = str(error)
        self._connect_at = max(self._connect_at, time.monotonic() + error.pause)
        if self._controller is not None:
            self._controller.close()
        self._controller, self._claimed = None, False
        self.follow_clock()
        self.publish(self.component.lose(self.now(), self._why))

    def _claim(self, controller: Controller[Any, Any, Any]) -> str:
        """Become the writer; say why not."""
        self._claim_at = time.monotonic()
        try:
            trouble = self._refusal(controller)
            if trouble:
                return trouble
            controller.claim()
        except LinkError as error:
            return str(error)
        self._claimed = True
        self.troubles.pop('claim', None)
        return ''
