# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of thermal tests whose ranges, times and tilts are known exactly."""

import json

import numpy as np

from fuzzycnc_ros.runtime.host import NodeEvent
from fuzzycnc_ros.runtime.records import (
    SECOND,
    CompensationApplied,
    Displacement,
    MachineState,
    Temperatures,
)
from fuzzycnc_ros.studies.published_bag import PublishedBag

CHANNELS = ('X1', 'X2', 'Y1', 'Y2', 'Z')
AXES = ('X', 'X', 'Y', 'Y', 'Z')
APPLIED = ('X', 'Y', 'Z')
INTERVAL = 10.0
HOUR = 3600.0
BEGIN = 1_772_442_847
"""Wall time of the first displacement [s]."""

MARKS = ((0.0, 'environment'), (2 * HOUR, 'spindle 6000'), (6 * HOUR, 'cooling'))
END = 8 * HOUR
DRIFT = np.array([0.5e-6, 0.4e-6, -0.6e-6, -0.6e-6, 1.0e-6])
"""Linear drift of each probe in the environment's two hours [m]."""
RISE = np.array([12e-6, 7e-6, -20e-6, -26e-6, 30e-6])
TIME_CONSTANT = np.array([1500.0, 1500.0, 2400.0, 2400.0, 3600.0])
COOLING = 3000.0
REMOVED = {'X': 0.5, 'Y': 0.75, 'Z': 0.9}
"""Share of the first probe's displacement that the offset of an axis takes away."""


def displacements(time):
    """Return the displacements without compensation, shape (n, 5) [m]."""
    drifted = DRIFT * np.minimum(time, 2 * HOUR)[:, np.newaxis] / (2 * HOUR)
    heated = np.clip(time - 2 * HOUR, 0.0, 4 * HOUR)[:, np.newaxis]
    cooled = np.maximum(time - 6 * HOUR, 0.0)[:, np.newaxis]
    return drifted + RISE * (1 - np.exp(-heated / TIME_CONSTANT)) * np.exp(-cooled / COOLING)


def offsets(bare):
    """Return the offsets of X, Y and Z, shape (n, 3) [m]."""
    return -np.array([REMOVED[axis] for axis in APPLIED]) * bare[:, [0, 2, 4]]


def write_test(
    path,
    *,
    includes=False,
    compensation=True,
    marks=MARKS,
    speed=False,
    temperatures=True,
    silent_after=END,
    spoilt=lambda time, measured: (time, measured),
):
    """Write a bag of a thermal test.

    Parameters
    ----------
    path : path
        The bag.
    includes, compensation : bool
        Whether displacements are measured with the offsets in force; whether offsets are told.
    marks : sequence of (float, str)
        When phases begin [s].
    speed : bool or callable
        Whether the machine tells its spindle speed, which rises for half a minute; or what it
        tells at a time [rad/s].
    temperatures : bool
        Whether there are some.
    silent_after : float
        When offsets are no longer told [s].
    spoilt : callable
        Changes times and displacements.
    """
    time = np.arange(0.0, END + INTERVAL / 2, INTERVAL)
    bare = displacements(time)
    applied = offsets(bare)
    measured = bare + applied[:, [0, 0, 1, 1, 2]] if includes else bare
    told = list(time)
    time, measured = spoilt(time, measured)
    records = [('node_event', mark(at, phase)) for at, phase in marks]
    records += [
        ('displacement', displacement(at, row, includes=includes))
        for at, row in zip(time, measured, strict=True)
    ]
    for at, row in zip(told, applied, strict=True):
        if compensation and at <= silent_after:
            records.append(('compensation_applied', in_force(at, row)))
        if callable(speed):
            records.append(('machine_state', state(at, speed(at))))
        elif speed:
            turning = np.clip((at - 2 * HOUR) / 30.0, 0.0, 1.0) * 100.0 * np.pi
            records.append(('machine_state', state(at, turning if at < 6 * HOUR else 0.0)))
        if temperatures:
            warmth = 20.0 + 2.0 * at / END
            records.append(('temperatures', warm(at, np.array([warmth, 30.0]))))
    with PublishedBag(path) as bag:
        for topic, record in sorted(records, key=lambda item: item[1].stamp):
            bag(topic, record)
    return path


def stamp(at):
    return round((BEGIN + at) * SECOND)


def mark(at, phase, by='anna'):
    return NodeEvent(
        stamp=stamp(at),
        frame_id='mill/machine',
        node='operator',
        name='mark',
        request=json.dumps({'phase': phase, 'by': by}),
    )


def displacement(at, values, *, includes):
    return Displacement(
        stamp=stamp(at),
        frame_id='mill/workpiece',
        axis=AXES,
        channel=CHANNELS,
        displacement=values,
        standard_deviation=np.full(len(CHANNELS), np.nan),
        includes_compensation=includes,
    )


def in_force(at, offset):
    return CompensationApplied(
        stamp=stamp(at),
        frame_id='mill/machine',
        epoch=1,
        status=1,
        reason='',
        axis=APPLIED,
        offset=offset,
        at_limit=np.zeros(3, bool),
    )


def state(at, speed):
    return MachineState(
        stamp=stamp(at),
        frame_id='mill/machine',
        state=3,
        homed=True,
        offsets_allowed=True,
        cold_since=0,
        spindle_speed=speed,
        axis=APPLIED,
        position=np.zeros(3),
    )


def warm(at, values):
    return Temperatures(
        stamp=stamp(at),
        frame_id='mill/machine',
        sensor=('ambient', 'bearing'),
        temperature=values,
        status=np.zeros(2, np.uint8),
        readings=1,
    )
