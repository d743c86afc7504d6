# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of a graph of thermal compensation, made up record by record."""

import itertools

import numpy as np
from campaign.evidence import Evidence, Recorded, Window
from campaign.scenario import BY_MACHINE, Scenario
from campaign.verdict import judge

from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    ThermalError,
)

MICRO = 1e-6
TICK = 12 * SECOND
NAME = 'trial'
SCENARIO = Scenario(NAME, 'nothing is done', lambda live: None, BY_MACHINE)


def error(stamp, valid=True):
    """Return a thermal error."""
    return ThermalError(
        stamp=stamp,
        axis=('Y', 'Z'),
        channel=('Y', 'Z'),
        error=np.full(2, -5 * MICRO),
        standard_deviation=np.zeros(2),
        valid=valid,
        reason=0,
        in_domain=True,
        model='',
        substituted=(),
        substitute=(),
    )


def command(stamp, offset=5.0, state=CompensationState.ACTIVE, epoch=1):
    """Return a command of an offset [um]."""
    return Compensation(
        stamp=stamp,
        epoch=epoch,
        state=int(state),
        axis=('Y', 'Z'),
        offset=np.full(2, offset * MICRO),
        slope=np.zeros(2),
        reference_position=np.zeros(2),
        at_limit=np.zeros(2, bool),
        slewing=np.zeros(2, bool),
        valid_until=stamp + 180 * SECOND,
        source=(),
    )


def applied(stamp, offset=5.0, status=OffsetStatus.FOLLOWING):
    """Return a read-back of an offset [um]."""
    return CompensationApplied(
        stamp=stamp,
        epoch=1,
        status=int(status),
        reason='',
        axis=('Y', 'Z'),
        offset=np.full(2, offset * MICRO),
        at_limit=np.zeros(2, bool),
    )


def evidence_of(ticks, change=None):
    """Return what a graph that follows all the time would show; `change` may replace records."""
    found, place, number = Evidence(), itertools.count(1), itertools.count(1)
    for tick in range(1, ticks + 1):
        made = {
            'thermal_error': error(tick * TICK),
            'compensation': command(tick * TICK),
            'compensation_applied': applied(tick * TICK),
        }
        made.update(change(tick) if change else {})
        sequence = next(number)
        for topic, record in made.items():
            found.records[topic].append(Recorded(next(place), sequence, record))
    found.windows[NAME] = Window(10, next(place))
    return found


def judged(change=None, scenario=SCENARIO, ticks=60, **what):
    """Return the verdict on such a recording."""
    return judge(scenario, evidence_of(ticks, change), **what)
