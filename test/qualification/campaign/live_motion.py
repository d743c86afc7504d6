# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Graphs of machines that move, with an operator, that faults are put into."""

import time
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

from campaign.drive_verdict import GOAL, TRAVEL
from campaign.live_graphs import LiveGraph
from campaign.pattern_verdict import BLEND
from campaign.relay import direct, durability
from campaign.scenario import Stage
from fuzzycnc_ros.core.deformation.model import write_model
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.graph.bring_up import NodeSpec
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.enums import ServoStatus
from fuzzycnc_ros.runtime.records import (
    AxisCommand,
    AxisState,
    CompensatedPath,
    Material,
    PositionCommand,
    Record,
    ServoState,
    StitchPattern,
    ToolPath,
    Trajectory,
    TrajectoryState,
)
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples

MOVES = 5e-3
"""Speed from which on an axis moves [m/s]; readings of one that rests show less."""
LASTING = 20
"""Periods in a row in which it has to move."""
OPERATOR_TRIES = 2.0
"""Wall time [s] until the operator acts again."""
REACHING = 0.5
"""Wall time [s] in which a sheet that is clamped is known everywhere."""
ANEW = 100
"""Paths that the machine itself loads, one after the other: more than a stage has time for."""
FOREVER = 86400.0
"""Machine time [s] for which it waits for one that was broken off: the operator mends it."""
CURVE = 'trident'
"""Path that is followed: it takes seconds, but is planned quickly on a busy computer too."""
SHEETS = ('0.015', '0.02')
"""Sheets that are clamped in turn [m]."""


class MovingGraph(LiveGraph):
    """A machine whose axes move, and an operator who sends what they are to do.

    Parameters
    ----------
    stage, folder
        As `LiveGraph`.
    """

    REJOINS = 0.01
    LEADS: ClassVar[str]
    """Managed node that leads the axes."""
    WAITS = 0.6
    """Wall time [s] without motion after which the operator acts."""

    def __init__(self, stage: Stage, folder: Path) -> None:
        self._working = 0
        self._moved_at = self._acted_at = time.monotonic()
        self._own: dict[str, Any] = {}  # the operator's publishers
        self._asked: list[Any] = []  # answers that he waits for
        super().__init__(stage, folder)
        self._transitions = self.node.create_client(ChangeState, f'{self.LEADS}/change_state')

    def at_work(self) -> bool:
        """Whether the axes have moved for some periods."""
        return self._working >= LASTING

    def _reactivate(self) -> None:
        """Ask what leads the axes to end what it does, and to begin anew."""
        if self._transitions.service_is_ready():
            self._asked = [
                self._transitions.call_async(ChangeState.Request(transition=Transition(id=wanted)))
                for wanted in (
                    Transition.TRANSITION_DEACTIVATE,
                    Transition.TRANSITION_ACTIVATE,
                )
            ]

    def _operate(self) -> None:
        now = time.monotonic()
        rests = self._now > 0 and now - self._moved_at > self.WAITS
        if rests and now - self._acted_at > OPERATOR_TRIES and not self.ended:
            self._acted_at = now
            self._act()

    @abstractmethod
    def _act(self) -> None:
        """Send what the axes are to do."""

    def _note(self, topic: str, record: Any) -> None:
        self._hear(topic, record)
        if not isinstance(record, AxisState):
            return
        self._now = record.stamp
        if np.abs(record.velocity).max(initial=0.0) > MOVES:
            self._working += 1
            self._moved_at = time.monotonic()
        else:
            self._working = 0

    def _send(self, topic: str, record: Record) -> None:
        """Publish something in the operator's name, as the machine would."""
        own = self._own.get(topic)
        if own is None:
            name = direct(topic) if topic in self._routes else topic
            kept = durability(topic)
            own = self.node.create_publisher(message_class(record.TYPE), name, publisher_qos(kept))
            self._own[topic] = own
        own.publish(encode(record, RCLPY))


class PathGraph(MovingGraph):
    """A machine that follows one tool path after the other."""

    SPEAKS: ClassVar[Mapping[str, tuple[str, type[Any]]]] = {
        'feedrate_scheduler': ('trajectory', Trajectory)
    }
    LEADS = 'feedrate_scheduler'
    _path: ToolPath | None = None

    def _specs(self) -> list[NodeSpec]:
        return self._stage_specs(
            {
                'duties': [''],
                'paths': [CURVE] * ANEW,
                'path_timeout': FOREVER,
                'tick_period': 0.5,
            }
        )

    def _listen_to_machine(self) -> None:
        for topic, kind in (
            ('axis_state', AxisState),
            ('trajectory_state', TrajectoryState),
            ('tool_path', ToolPath),
        ):
            self._listen(topic, kind, self._note)

    def _note(self, topic: str, record: Any) -> None:
        super()._note(topic, record)
        if isinstance(record, ToolPath):
            self._path = record

    def begin_anew(self) -> None:
        """Have the scheduler bring the axes to rest on their path, and begin it anew."""
        self._reactivate()
        self._acted_at = 0.0

    def _act(self) -> None:
        """Send the path anew that was broken off."""
        if self._path is not None:
            self._send('tool_path', replace(self._path, stamp=self._now))


class PatternGraph(MovingGraph):
    """A machine that stitches one pattern after the other, on two sheets in turn."""

    SPEAKS: ClassVar[Mapping[str, tuple[str, type[Any]]]] = {
        'deformation_compensator': ('compensated_path', CompensatedPath),
        'feedrate_scheduler': ('trajectory', Trajectory),
    }
    LEADS = 'feedrate_scheduler'
    WAITS = 1.6  # the machine itself waits after it has clamped a sheet

    def __init__(self, stage: Stage, folder: Path) -> None:
        self._file = folder / 'foam.json'
        model = TSFuzzyNetwork().fit(*foam_samples(0)).model_
        self._file.write_text(write_model(model), encoding='utf-8')
        self._sheet: Material | None = None
        self._pattern: StitchPattern | None = None
        self._clamped_at = 0.0
        super().__init__(stage, folder)

    def _specs(self) -> list[NodeSpec]:
        own: dict[str, dict[str, Any]] = {
            'deformation_compensator': {'model': str(self._file)},
            'feedrate_scheduler': {'blend': BLEND},
        }
        track = 'parallelogram:45:base=0.012:side=0.009:thickness='
        specs = self._stage_specs(
            {
                'duties': [''],
                'patterns': [track + SHEETS[n % 2] for n in range(ANEW)],
                'pattern_feed': 0.08,
                'path_timeout': FOREVER,
                'tick_period': 0.1,
            }
        )
        return [
            replace(spec, parameters={**spec.parameters, **own.get(spec.name, {})})
            for spec in specs
        ]

    def _listen_to_machine(self) -> None:
        for topic, kind in (
            ('axis_state', AxisState),
            ('trajectory_state', TrajectoryState),
            ('material', Material),
            ('stitch_pattern', StitchPattern),
        ):
            self._listen(topic, kind, self._note)

    def _note(self, topic: str, record: Any) -> None:
        super()._note(topic, record)
        if isinstance(record, Material):
            self._sheet = record
        elif isinstance(record, StitchPattern):
            self._pattern = record

    def _operate(self) -> None:
        super()._operate()
        known = self._clamped_at and time.monotonic() - self._clamped_at > REACHING
        if known and self._pattern is not None:
            self._clamped_at = 0.0
            self._send('stitch_pattern', replace(self._pattern, stamp=self._now))

    def _act(self) -> None:
        """Clamp the sheet again, then send the pattern anew that was not stitched."""
        if self._sheet is not None and self._pattern is not None:
            self._clamped_at = time.monotonic()
            self._send('material', replace(self._sheet, stamp=self._now))


class DriveGraph(MovingGraph):
    """A machine whose axis is sent back and forth, driven by the servo controller."""

    SPEAKS: ClassVar[Mapping[str, tuple[str, type[Any]]]] = {
        'servo_controller': ('axis_command', AxisCommand)
    }
    LEADS = 'servo_controller'

    def __init__(self, stage: Stage, folder: Path) -> None:
        self._status = ServoStatus.INACTIVE
        self._goal = GOAL
        super().__init__(stage, folder)

    def _specs(self) -> list[NodeSpec]:
        low, high = TRAVEL
        specs = self._stage_specs(
            {
                'duties': [''],
                'servo_axes': ['X:lathe'],
                'servo_travel_low': low,
                'servo_travel_high': high,
                'paths': [CURVE],  # nobody follows it: the axes are driven as long as it waits
                'path_timeout': FOREVER,
                'tick_period': 0.5,
            }
        )
        reach = {'travel_low': 0.8 * low, 'travel_high': 0.8 * high}
        return [
            replace(spec, parameters={**spec.parameters, **reach})
            if spec.name == 'servo_controller'
            else spec
            for spec in specs
        ]

    def _listen_to_machine(self) -> None:
        self._listen('axis_state', AxisState, self._note)
        self._listen('servo_state', ServoState, self._note)

    def _note(self, topic: str, record: Any) -> None:
        super()._note(topic, record)
        if isinstance(record, ServoState):
            self._status = ServoStatus(record.status)

    def begin_anew(self) -> None:
        """Send the axis back at once."""
        self._act()

    def _act(self) -> None:
        """Send the axis to the other end; a controller that gave up is activated anew first."""
        if self._status is ServoStatus.FAULT:
            self._reactivate()
            return
        self._goal = -self._goal
        self._send(
            'position_command',
            PositionCommand(
                stamp=self._now,
                axis=('X',),
                position=np.array([self._goal]),
                velocity=np.array([np.nan]),
            ),
        )
