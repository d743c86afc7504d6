# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A path followed live at 1 ms: the same as in one process, and a scheduler that dies."""

import numpy as np
import pytest
from live_graph import ANSWER_TIMEOUT, KILL_TIMEOUT

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.runtime.records import (
    AxisState,
    ContourError,
    TrajectoryState,
)
from fuzzycnc_ros.studies.contour.contouring import ContouringLog, run_contouring
from fuzzycnc_ros.studies.published_bag import PublishedBag

pytestmark = pytest.mark.ros

OUTPUTS = (
    'tool_path',
    'trajectory',
    'feed_schedule',
    'trajectory_state',
    'axis_state',
    'contour_error',
)
SCHEDULER = {'tolerance': 1e-4, 'settle': 0.25}


def start(graph, *, bag=None, **machine):
    """Start the scheduler, a recorder and the machine, which loads the trident."""
    scheduler = graph.start(
        'feedrate_scheduler', {'lockstep': True, 'autostart': True, **SCHEDULER}
    )
    if bag is not None:
        graph.start('recorder', {'lockstep': True, 'output': str(bag)})
    machine = graph.start(
        'simulated_machine',
        {
            'duties': [''],
            'paths': ['trident'],
            'lockstep': True,
            'lockstep_nodes': ['feedrate_scheduler'],
            'lockstep_recorder': bag is not None,
            'answer_timeout': ANSWER_TIMEOUT,
            **machine,
        },
    )
    return scheduler, machine


@pytest.mark.slow
def test_live_and_replayed_equal_in_process(graph, tmp_path):
    """The contour error of the bag is that of the run in one process, and so is all else."""
    _, machine = start(graph, bag=tmp_path / 'live')
    assert machine.wait() == 0
    assert machine.outcome['degraded'] is False
    graph.stop()
    with PublishedBag(tmp_path / 'alone') as bag:
        alone = run_contouring(('trident',), FeedrateSchedulerConfig(**SCHEDULER), sink=bag)
    live, expected = (topic_hashes(tmp_path / name) for name in ('live', 'alone'))
    for topic in OUTPUTS:
        assert live[f'/mill/{topic}'] == expected[f'/mill/{topic}'], topic
    (followed,) = ContouringLog.from_bag(tmp_path / 'live').paths()
    assert followed.finished
    assert followed.error_max == alone[0].error_max <= 1.05e-4
    assert followed.duration == alone[0].duration
    report = replay(tmp_path / 'live')
    assert report.identical, report.topics


@pytest.mark.slow
def test_machine_rests_on_the_path_when_the_scheduler_dies(graph, observer):
    """Killed in mid-path: the axes follow the tail of the newest part to rest, and say so."""
    axes = observer.records('axis_state', AxisState)
    states = observer.records('trajectory_state', TrajectoryState)
    errors = observer.records('contour_error', ContourError)
    scheduler, machine = start(graph, answer_timeout=KILL_TIMEOUT, path_timeout=2.0)

    def midway():
        return bool(states) and states[-1].arc_length > 0.05

    observer.until(midway, 'the middle of the path')
    graph.kill(scheduler)
    observer.until_ended(machine)
    assert machine.outcome['degraded'] is True
    assert any(item.status == TrajectoryStatus.STARVED for item in states)
    position = np.array([item.position for item in axes])
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1)
    period = np.diff([item.stamp for item in axes])
    config = SimulatedMachineConfig()
    fast = period == round(1e9 * config.axis_interpolation_period)
    assert speed[fast].max() <= config.axis_velocity_max * config.axis_interpolation_period * 1.01
    assert np.array_equal(axes[-1].velocity, np.zeros(3)) or np.abs(axes[-1].velocity).max() < 1e-6
    # it never left the path, not even while it came to rest
    assert max(item.error.max() for item in errors) <= 1.05e-4
