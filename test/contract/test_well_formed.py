# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Arrays that a definition calls parallel are held to it where records come in."""

import re
from dataclasses import fields, replace
from operator import attrgetter

import interfaces
import numpy as np
import pytest
from each_case import for_each

from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.runtime.merge import EPOCH_MAX, PARALLEL, misfit
from fuzzycnc_ros.runtime.records import (
    AxisCommand,
    CompensationApplied,
    SensorCluster,
    SensorSelection,
    Temperatures,
    TrajectoryState,
)

ANSWERED = {
    'AxisCommand',
    'CompensatedPath',
    'Compensation',
    'PositionCommand',
    'StitchPattern',
    'ToolPath',
}
"""Messages whose taker says itself what is wrong with them."""


def declared(name: str) -> dict[str, set[str]]:
    """Return the parallel arrays of a message by the array that they belong to."""
    found: dict[str, set[str]] = {}
    for item in interfaces.fields(name):
        for first in re.findall(r'parallel to `(\w+)`', item.comment):
            found.setdefault(first, set()).add(item.name)
    return found


@for_each(PARALLEL, attrgetter('__name__'))
def test_what_is_checked_is_what_the_definition_says(record):
    name = record.TYPE.rsplit('/')[-1]
    checked = {first: set(others) for first, others in PARALLEL[record].items()}
    for first, others in declared(name).items():
        assert others <= checked.get(first, set()), f'{name}: {first}'


def test_every_input_with_parallel_arrays_is_checked():
    inputs = {item.record for kind in COMPONENTS.values() for item in kind.INPUTS}
    known = {record.__name__ for record in PARALLEL} | ANSWERED
    missing = {item.__name__ for item in inputs if declared(item.TYPE.rsplit('/')[-1])} - known
    assert not missing


def test_clusters_of_a_selection_are_checked_too():
    cluster = SensorCluster(
        member=('T1', 'T2'),
        score=np.ones(2),
        chosen='T1',
        substitute=('T2',),
        gain=np.ones(1),
        correlation=np.ones(1),
    )
    selection = SensorSelection(
        stamp=1,
        method='correlation',
        cluster=(cluster,),
        partition_coefficient=1.0,
        xie_beni=0.1,
        dropped=(),
        calibration=(),
    )
    assert misfit(selection) == ''
    bad = replace(selection, cluster=(cluster, replace(cluster, gain=np.ones(3))))
    assert misfit(bad) == (
        "cluster of 'T1': gain: expected 1 values, parallel to substitute, but found 3"
    )


@pytest.mark.parametrize('field', ['temperature', 'status'])
def test_uneven_arrays_are_named(field):
    good = Temperatures(
        stamp=1, sensor=('T1', 'T2'), temperature=np.zeros(2), status=np.zeros(2, np.uint8)
    )
    assert misfit(good) == ''
    bad = replace(good, **{field: getattr(good, field)[:1]})
    assert misfit(bad) == f'{field}: expected 2 values, parallel to sensor, but found 1'


@pytest.mark.parametrize('record', [AxisCommand, CompensationApplied, TrajectoryState])
def test_owner_without_a_possible_successor_is_refused(record):
    """Whoever followed one of the highest epoch could never be commanded by another again."""
    empty = {item.name: () for item in fields(record)}
    told = record(**{**empty, 'stamp': 0, 'epoch': EPOCH_MAX})
    assert misfit(told) == ''
    assert 'no owner could follow' in misfit(replace(told, epoch=EPOCH_MAX + 1))
