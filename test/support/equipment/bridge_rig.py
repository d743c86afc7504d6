# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A bridge as a process, who commands it, and what is heard of it."""

import time
from typing import Any, ClassVar

import numpy as np
from lifecycle_msgs.msg import Transition

from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.records import (
    Compensation,
    CompensationApplied,
    MachineState,
    nanoseconds,
)

MICRON = 1e-6
AGAIN = 1.0
"""Time between two commands [s]."""
CONFIGURE = Transition.TRANSITION_CONFIGURE
ACTIVATE = Transition.TRANSITION_ACTIVATE
DEACTIVATE = Transition.TRANSITION_DEACTIVATE


class BridgeRig:
    """A bridge of machine `mill`; tests subclass it for their controller."""

    NODE: ClassVar[str]
    AXES: ClassVar[tuple[str, ...]]
    CLOSE: ClassVar[float]
    """Applied against requested, after settling [m]."""

    def __init__(self, graph: Any, observer: Any) -> None:
        self.graph, self.observer = graph, observer
        self.applied = observer.records('compensation_applied', CompensationApplied)
        self.states = observer.records('machine_state', MachineState)
        self._publisher = observer.node.create_publisher(
            message_class(Compensation.TYPE), 'compensation', publisher_qos(Durability.STREAM)
        )
        self.bridge: Any = None
        self.epoch = 1

    def launch(self, parameters: dict[str, Any], *, active: bool, wait: bool) -> Any:
        """Start a bridge; wait until it reads the controller and hears commands."""
        before, states = len(self.applied), len(self.states)
        self.bridge = self.graph.start(self.NODE, parameters)
        self.until(lambda: len(self.applied) > before, 'tells what is applied')
        self.until(lambda: len(self.states) > states, 'tells the state')
        self.until(lambda: self._publisher.get_subscription_count() >= 1, 'hears commands')
        if active:
            assert self.change(CONFIGURE)
            assert self.change(ACTIVATE)
            self.until(lambda: not wait or self.allowed, 'active')
        return self.bridge

    @property
    def last(self) -> CompensationApplied:
        """What was told last of the offsets."""
        return self.applied[-1]

    @property
    def allowed(self) -> bool:
        """Whether commands are followed."""
        followed = self.last.status != OffsetStatus.REFUSED
        return followed and self.states[-1].offsets_allowed

    def change(self, transition: int, machine: str = 'mill') -> bool:
        """Ask for a transition; tell whether it was carried out."""
        return bool(self.observer.change(self.NODE, transition, machine))

    def until(self, condition: Any, what: str = '', timeout: float = 60.0) -> None:
        """Wait for a condition."""
        try:
            self.observer.until(condition, what, timeout)
        except AssertionError as error:
            last = self.last if self.applied else None
            output = self.bridge.output if self.bridge else ''
            raise AssertionError(f'{error}; last {last}; {self.controls()}\n{output}') from None

    def controls(self) -> str:
        """Return what is known of the controller, for a test that fails."""
        return ''

    def command(
        self, offset: Any, *, slope: Any = None, reference: Any = None, valid: float = 60.0
    ) -> None:
        """Command offsets [um]."""
        now = time.time_ns()
        size = len(self.AXES)
        record = Compensation(
            stamp=now,
            frame_id='mill/machine',
            epoch=self.epoch,
            state=1,
            axis=self.AXES,
            offset=MICRON * np.array(offset),
            slope=np.zeros(size) if slope is None else np.array(slope),
            reference_position=np.zeros(size) if reference is None else np.array(reference),
            at_limit=np.zeros(size, bool),
            slewing=np.zeros(size, bool),
            valid_until=now + nanoseconds(valid),
            source=('test',),
        )
        self._publisher.publish(encode(record, RCLPY))

    def at(self, offset: Any) -> bool:
        """Whether these offsets [um] are in force."""
        return bool(np.all(np.abs(self.last.offset - MICRON * np.array(offset)) <= self.CLOSE))

    def settle(self, offset: Any, **more: Any) -> None:
        """Command offsets, again and again as a compensator does, and wait for them."""
        due = 0.0

        def there() -> bool:
            nonlocal due
            if time.monotonic() >= due:
                due = time.monotonic() + AGAIN
                self.command(offset, **more)
            return self.at(offset)

        self.until(there, f'{offset} um in force')

    def refused(self, text: str) -> None:
        """Wait until commands are refused because of something."""
        self.until(
            lambda: self.last.status == OffsetStatus.REFUSED and text in self.last.reason,
            f'refused: {text}',
        )
