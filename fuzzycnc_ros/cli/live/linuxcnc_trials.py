# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trials of settings on an axis of a running LinuxCNC, each only for as long as a key is held.

The component in the servo thread drives and judges.  The component of `servo_controller` hears the
same, period by period: it says whether a trial may begin, and how well it followed.
"""

from __future__ import annotations

import io
import os
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from fuzzycnc_ros.adapters.linuxcnc import trial_process
from fuzzycnc_ros.adapters.linuxcnc.control import LineProcess, LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.simulation import PYTHON
from fuzzycnc_ros.cli.live.held_trials import HeldKey
from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.components.servo.servo_controller_config import file_controller
from fuzzycnc_ros.components.servo.servo_trial import UNSTABLE, vertical_refusal
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.machine_data import MachineData, axis_hash
from fuzzycnc_ros.core.servo.axis_control import UNTUNED_CONTROLLER, make_axis_controller
from fuzzycnc_ros.core.servo.course import REST, AxisFigures
from fuzzycnc_ros.runtime.enums import MachineMode, TrialStatus
from fuzzycnc_ros.runtime.merge import Merger
from fuzzycnc_ros.runtime.records import (
    AxisState,
    MachineState,
    ServoTrial,
    ServoTrialState,
    nanoseconds,
)
from fuzzycnc_ros.simulation.servo.axis_tuning import AxisCase
from fuzzycnc_ros.studies.servo.c_export import controller_hash, trial_numbers
from fuzzycnc_ros.studies.servo.linuxcnc_bag import AxisBag, axis_config

ANSWER = 5.0
"""Time for an answer of the process beside LinuxCNC [s]."""

ENDED = 'LinuxCNC, or the process beside it, has ended'

RENEWED = 0.03
"""Time between two signs of life [s]."""

SLACK = 0.05
"""Time that the axis rests beyond what is judged [s]."""

NEAR = 1e-7
"""Distance from where the trials begin that is none [m]."""

_TRIED = trial_process.TRIED
_STATUS = [None, TrialStatus.RUNNING, TrialStatus.DONE, None, *[TrialStatus.ENDED] * 8, None]
"""What a state of a trial in the component is to the node."""

_ENABLED, _COMMAND, _VELOCITY, _READING, _OUTPUT, _SIGN, _STATE = range(1, 8)
"""Columns of a sample, behind its number."""


class LinuxcncTrials:
    """Tries settings on an axis of a LinuxCNC that runs here.

    Parameters
    ----------
    key : HeldKey
        What the operator holds.
    machine, axis
        The machine, and the name of its axis, which is LinuxCNC's of that name.
    bag : Path
        Bag to write.
    prefix : str
        Prefix of the exported component in HAL.

    Raises
    ------
    ValueError
        If LinuxCNC does not run, or its component is not that of this machine file.
    """

    def __init__(
        self, key: HeldKey, machine: MachineData, axis: str, bag: Path, prefix: str
    ) -> None:
        data = machine.axes[axis]
        if data.limits.vertical:
            raise ValueError(vertical_refusal(axis))
        self._key, self._machine, self._axis, self._data = key, machine, axis, data
        self._hash = axis_hash(axis, data)
        self._law = data.controller or UNTUNED_CONTROLLER
        self._own = make_axis_controller(data)
        self._period = self._own.period
        self._number = 0
        self._pending = np.empty((0, 1 + _STATE))
        self._rows: io.FileIO | None = None
        self._folder = tempfile.TemporaryDirectory(prefix='fuzzycnc-trials-')
        rows = Path(self._folder.name, 'rows')
        command = [PYTHON, trial_process.__file__, prefix, axis, str(rows)]
        try:
            self._process = LineProcess(command, ended=ENDED, start_new_session=True)
        except LinuxcncError as error:
            self._folder.cleanup()
            raise ValueError(str(error)) from error
        try:
            self._rows = rows.open('rb', buffering=0)
            self._check(self._ask('state'), prefix)
            self._start = float(self._ask('manual')['command'])
        except BaseException:
            self._end_process()
            raise
        self._bag = AxisBag(bag, machine, axis, self._law)
        self._bag.say('machine_state', self._machine_state())

    def __enter__(self) -> LinuxcncTrials:
        """Return it."""
        return self

    def __exit__(self, *error: object) -> None:
        """Leave LinuxCNC alone, and close the bag."""
        try:
            self._end_process()
        finally:
            self._bag.__exit__()

    def __call__(
        self, name: str, settings: Mapping[str, float], case: AxisCase, error_max: float
    ) -> AxisFigures:
        """Try settings in a case, anew where the key was let go.

        Raises
        ------
        ValueError
            If the machine does not allow a trial, or LinuxCNC is lost.
        GraphError
            If the terminal is lost.
        """
        config = self._bag.component.configuration
        tried = file_controller(config, self._axis, self._data, name, settings)
        try:
            numbers = trial_numbers(self._own, tried)
        except ValueError as error:  # another one may be tried
            return AxisFigures(rms=nan, largest=nan, rest=nan, fault=str(error))
        while True:
            self._until_ready()
            self._number += 1
            asked = ServoTrial(
                stamp=0,
                axis_name=self._axis,
                trial=self._number,
                machine_file=self._hash,
                controller=name,
                setting=tuple(settings),
                value=np.array([*settings.values()], np.float64),
                gain=case.gain,
                way=case.way,
                pace=case.pace,
                error_max=error_max,
            )
            refusal = self._refusal(asked)
            if refusal and UNSTABLE not in refusal:
                raise ValueError(refusal)
            if refusal:
                return AxisFigures(rms=nan, largest=nan, rest=nan, fault=refusal)
            told = self._held(asked, numbers, case)
            if told is not None:
                return AxisFigures(
                    rms=told.rms, largest=told.largest, rest=told.rest, fault=told.reason
                )

    def _check(self, state: Mapping[str, Any], prefix: str) -> None:
        """Refuse another machine file or controller than that of the component."""
        exported, used = state['exported_from'], state['in_use']
        again = f'`fuzzycnc linuxcnc install FILE.ini --machine-file ... --axis {self._axis}`'
        if exported != int(self._hash[:8], 16):
            raise ValueError(
                f'machine file: expected the state of {self._axis} that {prefix} was exported '
                f'from, 0x{exported:08x}, but found 0x{self._hash[:8]}; {again}'
            )
        if used != exported:
            raise ValueError(
                f'{prefix}: expected machine-file = 0x{exported:08x} but found 0x{used:08x}; '
                f'{again}'
            )
        if state['controller'] != int(controller_hash(self._own)[:8], 16):
            raise ValueError(
                f'{prefix}: expected the controller of the machine file, {self._law} without '
                f'rules, but found another; {again}'
            )

    def _anew(self) -> None:
        """Have the controller of LinuxCNC and that of the bag begin anew at rest."""
        self._ask('anew')
        self._rested(SLACK)
        self._ask('end')
        self._read()
        anew = np.flatnonzero(self._pending[:, _SIGN] == trial_process.ANEW)
        if not len(anew):
            raise ValueError(f'{self._axis}: expected an axis at rest but found it moving')
        self._pending = self._pending[anew[0] :]
        self._bag.begin()

    def _machine_state(self) -> MachineState:
        return MachineState(
            stamp=0,
            frame_id=self._bag.component.frame('machine'),
            state=int(MachineMode.ON),
            homed=True,
            offsets_allowed=False,
            cold_since=0,
            spindle_speed=0.0,
            axis=(self._axis,),
            position=np.array([self._start]),
        )

    def _refusal(self, asked: ServoTrial) -> str:
        """Return why a node would not begin a trial with this way; empty if it would."""
        component = ServoController(axis_config(self._machine, self._axis, self._law))
        component.on_request('activate', {}, 0)
        merger, step = Merger(component), nanoseconds(self._period)
        place = np.array([self._start])
        merger.push('machine_state', self._machine_state())
        merger.push('servo_trial', replace(asked, stamp=step + 1))
        for number in (1, 2):
            state = AxisState(
                stamp=number * step,
                axis=(self._axis,),
                reference=place,
                position=place,
                velocity=np.array([nan]),
            )
            merger.push('axis_state', state)
        told = [
            item.record
            for item in merger.advance(2 * step)
            if isinstance(item.record, ServoTrialState)
        ]
        return told[0].reason if told else 'servo_controller: expected an answer but found none'

    def _until_ready(self) -> None:
        """Wait until the key is held and the axis rests where the trials begin."""
        while True:
            state = self._ask('state')
            if state['forbidden']:
                raise ValueError(state['forbidden'])
            if state['fault_code'] or not state['enabled']:
                raise ValueError(
                    f'{self._axis}: expected no fault but found number {state["fault_code"]}; '
                    'switch LinuxCNC on again'
                )
            away = self._start - state['command']
            if self._key.held and state['still'] * self._period > SLACK:
                if abs(away) <= NEAR:
                    return
                self._ask('jog', way=away, speed=self._speed(0.5))
                self._jogged(state['rows'])
            time.sleep(RENEWED)

    def _jogged(self, since: int) -> None:
        """Wait for the end of a way for as long as the key is held."""
        moves = time.monotonic()
        while self._key.held:
            state = self._ask('state')
            rests = state['still'] * self._period > SLACK and state['rows'] > since
            if rests and time.monotonic() - moves > 0.2:
                return
            time.sleep(RENEWED)
        self._ask('end')

    def _speed(self, pace: float) -> float:
        return pace * self._data.limits.positioning[0]

    def _held(
        self, asked: ServoTrial, numbers: list[float], case: AxisCase
    ) -> ServoTrialState | None:
        """Hold a trial to its end; return what became of it, None where the key was let go."""
        limits = self._data.limits
        ways = [case.way, -case.way]
        self._anew()
        begun = self._ask(
            'begin',
            numbers=numbers,
            gain=case.gain,
            error_max=asked.error_max,
            low=limits.travel_low,
            high=limits.travel_high,
        )['rows']
        resting = round((REST + SLACK) / self._period)
        while True:
            time.sleep(RENEWED)
            held = self._key.held
            state = self._ask('hold' if held else 'end')
            lost = state['forbidden'] or state['error']
            over = state['state'] != _TRIED and state['rows'] > begun
            if over or lost or not held:
                break
            if ways and min(state['still'], state['rows'] - begun) >= resting:
                self._ask('jog', way=ways.pop(0), speed=self._speed(case.pace))
                begun = state['rows']
        self._ask('end')
        self._rested(SLACK)
        told = self._write(replace(asked, way=0.0))
        if lost:
            raise ValueError(lost)
        return told if held else None

    def _rested(self, time_: float) -> None:
        """Wait until the axis has rested for some time [s]."""
        begun = self._ask('state')['rows']
        while True:
            time.sleep(RENEWED)
            state = self._ask('state')
            if min(state['still'], state['rows'] - begun) * self._period >= time_:
                return

    def _read(self) -> None:
        """Take the samples that have come."""
        width = self._pending.shape[1]
        assert self._rows is not None
        block = self._rows.readall()
        found = np.frombuffer(block[: len(block) // (8 * width) * 8 * width]).reshape(-1, width)
        self._rows.seek(len(found) * 8 * width - len(block), os.SEEK_CUR)
        self._pending = np.concatenate([self._pending, found])
        if (np.diff(self._pending[:, 0]) != 1.0).any():
            raise ValueError(
                'LinuxCNC: expected samples of every period but some were read too late'
            )

    def _write(self, asked: ServoTrial) -> ServoTrialState:
        """Write a trial up to this rest; return what became of it.

        Raises
        ------
        ValueError
            If LinuxCNC has switched off, or has not done what a node would have.
        """
        self._read()
        rows, self._pending = self._pending, self._pending[:0]
        off = np.flatnonzero(rows[:, _ENABLED] == 0.0)
        rows = rows[: off[0]] if len(off) else rows
        tried = np.flatnonzero(rows[:, _STATE] == _TRIED)
        if not len(tried):
            raise ValueError(f'{self._axis}: expected a trial that begins but it was refused')
        begin = int(tried[0])
        told: ServoTrialState | None = None
        last = rows[0]
        for number, row in enumerate(rows):
            if number == begin + 1:
                self._bag.lead(*self._led(rows[begin:]))
            if number >= begin and row[_SIGN] != last[_SIGN]:
                sign = asked if row[_SIGN] > 0.0 else replace(asked, controller='')
                self._bag.say('servo_trial', sign)
            said = self._bag.step(float(last[_COMMAND]), float(row[_READING]), float(row[_OUTPUT]))
            told = next((item for item in said if isinstance(item, ServoTrialState)), told)
            if number >= begin and (told is None or told.status != _STATUS[int(row[_STATE])]):
                raise ValueError(
                    f'{self._axis}: expected a trial that goes on and ends as the node judges it '
                    f'({told.reason if told else "refused"}) but found state {row[_STATE]:.0f} of '
                    'the component'
                )
            last = row
        if len(off):
            raise ValueError(
                f'{self._axis}: LinuxCNC has switched off; look at the axis, switch it on and '
                'begin anew'
            )
        assert told is not None
        return told

    def _led(self, rows: Array) -> tuple[Array, Array]:
        """Return where a motion leads from period to period [m], and how fast [m/s], to rest."""
        if rows[-1, _VELOCITY] == 0.0:
            return rows[:-1, _COMMAND], rows[:-1, _VELOCITY]
        # It was cut off; a trajectory ends at rest.
        place, speed = rows[:, _COMMAND], rows[:, _VELOCITY]
        step = self._data.limits.acceleration * self._period
        slower = speed[-1] * np.linspace(1.0, 0.0, 2 + int(abs(speed[-1]) / step))
        way = np.cumsum(0.5 * self._period * (slower[1:] + slower[:-1]))
        return np.append(place, place[-1] + way), np.append(speed, slower[1:])

    def _ask(self, operation: str, **values: Any) -> dict[str, Any]:
        try:
            return self._process.ask({'op': operation, **values}, ANSWER)
        except LinuxcncError as error:
            raise ValueError(str(error)) from error

    def _end_process(self) -> None:
        if self._rows is not None:
            self._rows.close()
        self._process.close(ANSWER)
        self._folder.cleanup()
