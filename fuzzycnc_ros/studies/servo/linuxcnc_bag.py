# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""An axis that LinuxCNC moved, as a bag that `replay` repeats with the controller in Python."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
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
from fuzzycnc_ros.runtime.records import AxisCommand, AxisState, Record, Trajectory, nanoseconds
from fuzzycnc_ros.studies.published_bag import PublishedBag

UNIT = 1e-3
"""Length of a unit of LinuxCNC [m], as the component has it."""


def write_axis_bag(
    path: Path, machine: MachineData, axis: str, controller: str, samples: Mapping[str, Array]
) -> None:
    """Write what LinuxCNC commanded, read and gave out up to the last rest of its first enable.

    Readings are in `axis_state`, commands are a trajectory, and `axis_command` has the duties that
    came out of LinuxCNC's thread.  What else a `servo_controller` says LinuxCNC does not.

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
    component = ServoController(_config(machine, axis, controller))
    component.machine = machine.name
    merger = Merger(component)
    with PublishedBag(path, machine=machine.name) as bag:
        bag('node_configuration', configuration_record(component, 0, 'inactive'))
        component.on_request('activate', {}, 0)
        bag('node_event', event_record(component, 0, 'activate', {}))
        bag('node_configuration', configuration_record(component, 0, 'active'))
        for topic, record, duty in _inputs(component, axis, rows):
            bag(topic, record)
            merger.push(topic, record)
            for emission in merger.advance(record.stamp):
                if isinstance(emission.record, AxisCommand):
                    bag(emission.output, replace(emission.record, duty=np.array([duty])))
        space = f'/{machine.name}'
        topics = ('trajectory', 'axis_state', 'axis_command')
        said = {f'{space}/{topic}': [f'{space}/linuxcnc'] for topic in topics}
        bag.attach(REPORT_NAME, json.dumps({'topics': {}, 'publishers': said}))


def _config(machine: MachineData, axis: str, controller: str) -> ServoControllerConfig:
    plant = machine.axes[axis].known_plant()
    own = machine.axes[axis].controller == controller
    return ServoControllerConfig(
        axes=(f'{axis}:{FROM_FILE}',),
        axis_controller=FROM_FILE if own else controller,
        period=plant.period,
        **node_parameters(machine)['servo_controller'],
    )


def _inputs(
    component: ServoController, axis: str, rows: Mapping[str, Array]
) -> Iterator[tuple[str, Record, float]]:
    """Yield topic, record and the duty of LinuxCNC of all that the component gets."""
    period = component.configuration.period
    step = nanoseconds(period)
    command, velocity, reading = (
        UNIT * rows[name] for name in ('command', 'command-deriv', 'feedback')
    )
    frame = component.frame('machine')
    for number, (place, duty) in enumerate(zip(reading[:-1], rows['output'], strict=False)):
        stamp = (number + 1) * step
        if number == 1:
            # A command is for the end of its period: the first one for the beginning of this one.
            yield (
                'trajectory',
                Trajectory(
                    stamp=stamp - step // 2,
                    frame_id=frame,
                    path_id='linuxcnc',
                    epoch=1,
                    part=0,
                    last=True,
                    start=stamp,
                    period=period,
                    committed=len(command),
                    axis=(axis,),
                    position=command,
                    velocity=velocity,
                    arc_length=np.append(0.0, np.cumsum(np.abs(np.diff(command)))),
                ),
                0.0,
            )
        yield (
            'axis_state',
            AxisState(
                stamp=stamp,
                frame_id=frame,
                axis=(axis,),
                reference=np.array([command[max(number - 1, 0)]]),
                position=np.array([place]),
                velocity=np.array([np.nan]),
            ),
            float(duty),
        )
