# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""An axis that is driven as servo_controller drives it, and controllers that are tried on it."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from fuzzycnc_ros.components.servo.servo_axis import ServoAxis
from fuzzycnc_ros.components.servo.servo_controller_config import (
    ServoControllerConfig,
    make_controllers,
    motion_doubt,
)
from fuzzycnc_ros.components.servo.servo_trial import ServoTrials
from fuzzycnc_ros.core.machine.machine_data import AxisData, axis_hash, axis_texts
from fuzzycnc_ros.core.servo.course import AxisFigures
from fuzzycnc_ros.runtime.enums import MachineMode, TrialStatus
from fuzzycnc_ros.runtime.records import MachineState, ServoTrial
from fuzzycnc_ros.simulation.servo.axis_tuning import AxisCase

PERIOD = 1_000_000
"""Control period [ns]."""

MACHINE = MachineState(
    stamp=0, state=int(MachineMode.ON), homed=True, offsets_allowed=True, cold_since=0,
    spindle_speed=0.0, axis=(), position=np.zeros(0),
)  # fmt: skip


class TriedAxis:
    """The axis of a servo_controller, without messages; its operator never lets go.

    Parameters
    ----------
    data : AxisData
        The axis, with the controller that is there.
    step : callable
        Holds a duty for a period; returns what is read at its end [m].

    Attributes
    ----------
    largest : float
        Largest distance from where the axis was told to be [m].
    faults : list of str
        Why the axis was given up, and activated anew.
    """

    def __init__(self, data: AxisData, step: Callable[[float], float]) -> None:
        self._data, self._step = data, step
        config = ServoControllerConfig(axes=('X:machine_file',), axis_data=axis_texts({'X': data}))
        limits = data.limits
        self.axis = ServoAxis(
            'X',
            make_controllers(config)['X'],
            (limits.travel_low, limits.travel_high),
            motion_doubt(data),
        )
        self._trials = ServoTrials(config)
        self._hash = axis_hash('X', data)
        self._now, self._number = PERIOD, 0
        self._reading = step(0.0)
        self.largest, self.faults = 0.0, list[str]()

    def __call__(
        self, name: str, settings: Mapping[str, float], case: AxisCase, error_max: float
    ) -> AxisFigures:
        """Try a controller in a case."""
        self._rest()
        self._number += 1
        asked = ServoTrial(
            stamp=self._now, axis_name='X', trial=self._number, machine_file=self._hash,
            controller=name, setting=tuple(settings), value=np.array([*settings.values()]),
            gain=case.gain, way=case.way, pace=case.pace, error_max=error_max,
        )  # fmt: skip
        self._trials.take(asked)
        readings = {'X': self._reading}
        self._trials.begin([self.axis], readings, MACHINE, '', self._now)
        told = self._trials.told('')
        while told[-1].status == TrialStatus.RUNNING:
            self._trials.take(replace(asked, stamp=self._now))
            self._period()
            told += self._trials.told('')
        last = told[-1]
        return AxisFigures(rms=last.rms, largest=last.largest, rest=last.rest, fault=last.reason)

    def _rest(self) -> None:
        """Wait until the axis rests."""
        for _ in range(200):
            self._period()
        while self.axis.moving:
            self._period()

    def _period(self) -> None:
        axis, self._now = self.axis, self._now + PERIOD
        if axis.reference != axis.reference:
            axis.hold(self._reading)
        axis.step(self._reading)
        self._trials.judge([axis], [self._reading], MACHINE, self._now)
        if axis.fault:
            self.faults.append(axis.fault)
            self._trials.give_up(axis.fault, self._now)
            axis.release()
            for _ in range(500):
                self._reading = self._step(0.0)
            return
        self.largest = max(self.largest, abs(axis.reference - self._reading))
        self._reading = self._step(axis.duty)
