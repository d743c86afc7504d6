# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""An axis that LinuxCNC moved, as a bag that `replay` repeats with the controller in Python."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from fuzzycnc_ros.bags.recorder import REPORT_NAME
from fuzzycnc_ros.components.servo.servo_axes import FROM_FILE
from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.components.servo.servo_controller_config import ServoControllerConfig
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.machine_data import MachineData
from fuzzycnc_ros.machine_file.parameters import node_parameters
from fuzzycnc_ros.runtime.merge import Merger
from fuzzycnc_ros.runtime.provenance import configuration_record, event_record
from fuzzycnc_ros.runtime.records import (
    AxisCommand,
    AxisState,
    Record,
    ServoTrialState,
    Trajectory,
    nanoseconds,
)
from fuzzycnc_ros.studies.published_bag import PublishedBag

UNIT = 1e-3
"""Length of a unit of LinuxCNC [m], as the component has it."""


def write_axis_bag(
    path: Path, machine: MachineData, axis: str, controller: str, samples: Mapping[str, Array]
) -> None:
    """Write what LinuxCNC commanded, read and gave out up to the last rest of its first enable.

    Parameters
    ----------
    path : Path
        The bag.
    machine : MachineData
        The machine.
    axis : str
        Name of the axis.
    controller : str
        Its controller, of `AXIS_CONTROLLERS`.
    samples : mapping of str to ndarray, shape (n,)
        `enable`, `command`, `command-deriv`, `feedback` and `output` of every period, in units of
        LinuxCNC.

    Raises
    ------
    ValueError
        If the axis was not enabled for three periods.
    BagError
        If the bag cannot be written.
    """
    edges = np.flatnonzero(np.diff(samples['enable'], prepend=0.0, append=0.0))
    first, end = edges[:2] if len(edges) else (0, 0)
    # A trajectory ends at rest; a way on which the axis was stopped does not.
    rests = np.flatnonzero(samples['command-deriv'][first:end] == 0.0)
    if len(rests) < 3:
        raise ValueError('samples: expected an axis that is enabled but found none')
    rows = {name: values[first : first + rests[-1] + 1] for name, values in samples.items()}
    command, velocity, reading = (
        UNIT * rows[name] for name in ('command', 'command-deriv', 'feedback')
    )
    # A command is for the end of its period: the first one for the beginning of the next.
    before = np.concatenate([command[:1], command])
    with AxisBag(path, machine, axis, controller) as bag:
        for number, (place, duty) in enumerate(zip(reading[:-1], rows['output'], strict=False)):
            if number == 1:
                bag.lead(command, velocity)
            bag.step(float(before[number]), float(place), float(duty))


class AxisBag:
    """A bag that gets what LinuxCNC commands, reads and gives out of an axis, period by period.

    Readings are in `axis_state`, commands are trajectories, and `axis_command` has the duties that
    came out of LinuxCNC's thread.  What else a `servo_controller` says is what the component says
    that hears the same.

    Parameters
    ----------
    path : Path
        The bag.
    machine : MachineData
        The machine.
    axis : str
        Name of the axis.
    controller : str
        Its controller, of `AXIS_CONTROLLERS`; it begins anew with the first period.

    Attributes
    ----------
    component : ServoController
        What hears the same.

    Raises
    ------
    BagError
        If the bag cannot be written.
    """

    def __init__(self, path: Path, machine: MachineData, axis: str, controller: str) -> None:
        self.component = ServoController(axis_config(machine, axis, controller))
        self.component.machine = machine.name
        self._merger = Merger(self.component)
        self._axis, self._number, self._paths = axis, 0, 0
        self._period = self.component.configuration.period
        self._step = nanoseconds(self._period)
        self._said = ['trajectory', 'axis_state', 'axis_command']
        self._bag = PublishedBag(path, machine=machine.name)
        self._bag('node_configuration', configuration_record(self.component, 0, 'inactive'))
        self._request('activate', 'active')

    def __enter__(self) -> AxisBag:
        """Return it."""
        return self

    def __exit__(self, *error: object) -> None:
        """Say who said what, and close the bag."""
        space = f'/{self.component.machine}'
        said = {f'{space}/{topic}': [f'{space}/linuxcnc'] for topic in self._said}
        self._bag.attach(REPORT_NAME, json.dumps({'topics': {}, 'publishers': said}))
        self._bag.close()

    def begin(self) -> None:
        """Have the controller begin anew with the next period."""
        if self._number:
            self._request('deactivate', 'inactive')
            self._request('activate', 'active')

    def say(self, topic: str, record: Record) -> None:
        """Write a record and have the component hear it; its stamp is that of the next period."""
        record = replace(record, stamp=(self._number + 1) * self._step - self._step // 2)
        self._hear(topic, record)

    def lead(self, command: Array, velocity: Array) -> None:
        """Lead the axis from the next period on, to rest.

        Parameters
        ----------
        command, velocity : ndarray, shape (n,)
            Where it is to be in each period, and how fast [m, m/s].

        Raises
        ------
        ValueError
            If the component does not take such a motion.
        """
        self._paths += 1
        part = Trajectory(
            stamp=0,
            frame_id=self.component.frame('machine'),
            path_id='linuxcnc',
            epoch=self._paths,
            part=0,
            last=True,
            start=(self._number + 1) * self._step,
            period=self._period,
            committed=len(command),
            axis=(self._axis,),
            position=command,
            velocity=velocity,
            arc_length=np.append(0.0, np.cumsum(np.abs(np.diff(command)))),
        )
        self.say('trajectory', part)
        self._merger.advance((self._number + 1) * self._step - 1)
        for item in self.component.health():
            if item.name == 'command':
                raise ValueError(
                    f'LinuxCNC moves {self._axis} as no servo_controller: {item.message}'
                )

    def step(self, reference: float, reading: float, duty: float) -> list[Record]:
        """Take a period.

        Parameters
        ----------
        reference, reading : float
            Where the axis is to be, and where it reads [m].
        duty : float
            What came out of LinuxCNC's thread [-].

        Returns
        -------
        list of Record
            What the component says, with its own duty.
        """
        stamp = (self._number + 1) * self._step
        state = AxisState(
            stamp=stamp,
            frame_id=self.component.frame('machine'),
            axis=(self._axis,),
            reference=np.array([reference]),
            position=np.array([reading]),
            velocity=np.array([np.nan]),
        )
        self._hear('axis_state', state)
        self._number += 1
        said = self._merger.advance(stamp)
        for emission in said:
            if isinstance(emission.record, AxisCommand):
                self._bag(emission.output, replace(emission.record, duty=np.array([duty])))
            elif isinstance(emission.record, ServoTrialState):
                self._bag(emission.output, emission.record)
                self._said = [*self._said[:3], emission.output]
        return [emission.record for emission in said]

    def _request(self, name: str, state: str) -> None:
        component, stamp = self.component, self._merger.time
        for emission in component.on_request(name, {}, stamp).emissions:
            self._bag(emission.output, emission.record)
        self._bag('node_event', event_record(component, stamp, name, {}))
        self._bag('node_configuration', configuration_record(component, stamp, state))

    def _hear(self, topic: str, record: Record) -> None:
        self._bag(topic, record)
        self._merger.push(topic, record)


def axis_config(machine: MachineData, axis: str, controller: str) -> ServoControllerConfig:
    """Return the parameters of a node that drives an axis by a controller."""
    plant = machine.axes[axis].known_plant()
    own = machine.axes[axis].controller == controller
    return ServoControllerConfig(
        axes=(f'{axis}:{FROM_FILE}',),
        axis_controller=FROM_FILE if own else controller,
        period=plant.period,
        **node_parameters(machine)['servo_controller'],
    )
