# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc servo tune --on-machine` on running nodes: held, let go, killed, and replayed."""

import os
import subprocess
import sys
import threading
from contextlib import contextmanager, suppress

import pytest
from processes import HANG

from fuzzycnc_ros.machine_file.parameters import node_parameters
from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.runtime.enums import ServoStatus, TrialStatus
from fuzzycnc_ros.runtime.records import ServoState, ServoTrialState

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.realtime]

MACHINE_FILE = """\
axes:
  Y:
    limits: {travel_low: 0 mm, travel_high: 40 mm, velocity: 50 mm/s, load: 20 %}
    plant: {model: lags, gain: 150 mm/s, velocity_lag: 30 ms}
    controller: {name: cascade, settings: {bandwidth: 3.0}}
"""
RATE = 0.2
"""Pace at which a busy computer keeps a kilohertz."""


class Terminal:
    """A terminal in which the command runs, and a key that is held or not."""

    def __init__(self, graph, log, *words):
        self._master, slave = os.openpty()
        output = log.open('wb')
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(graph.domain), 'OMP_NUM_THREADS': '1'}
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'fuzzycnc_ros.cli.main', 'servo', 'tune', *words],
            stdin=slave,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=environment,
            cwd=graph.tree,
            start_new_session=True,
        )
        os.close(slave)
        output.close()

    @contextmanager
    def held(self):
        """Hold the space bar, which repeats itself."""
        over = threading.Event()

        def press():
            with suppress(OSError):  # nobody is at the terminal any more
                while not over.wait(0.03):
                    os.write(self._master, b' ')

        thread = threading.Thread(target=press)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def close(self):
        """Take the terminal away, as one that is closed."""
        os.close(self._master)


@pytest.fixture
def machine(graph, observer, tmp_path):
    """Drive an axis of a machine file that is asked for nothing, and record it."""
    file = tmp_path / 'my.yaml'
    file.write_text(MACHINE_FILE)
    data = node_parameters(read_machine_file(file))
    axis = ['Y:machine_file']
    graph.start(
        'servo_controller',
        {
            **data['servo_controller'],
            'axes': axis,
            'autostart': True,
            'use_sim_time': True,
            'realtime_priority': 20 if os.geteuid() == 0 else 0,
        },
    )
    graph.start('recorder', {'output': str(tmp_path / 'bag'), 'use_sim_time': True})
    graph.start(
        'simulated_machine',
        {
            **data['simulated_machine'],
            'duties': [''],
            'servo_axes': axis,
            'moves': ['Y:0.01'],
            'move_time': 600.0,
            'rate': RATE,
        },
    )
    states = observer.records('servo_state', ServoState)
    observer.until(
        lambda: (
            states and states[-1].status == ServoStatus.RESTING and states[-1].reference[0] == 0.01
        ),
        timeout=HANG,
    )
    return file


def test_held_trials_are_made_and_those_of_a_lost_operator_end(machine, graph, observer, tmp_path):
    told = observer.records('servo_trial_state', ServoTrialState)
    every = observer.records('servo_trial_state', ServoTrialState)
    states = observer.records('servo_state', ServoState)
    log = tmp_path / 'log'
    words = ['--on-machine', '--machine-file', str(machine), '--trials', '1']

    def until(condition):
        observer.until(condition, timeout=HANG)

    def back():
        return states[-1].status == ServoStatus.RESTING and states[-1].reference[0] == 0.01

    first = Terminal(graph, log, *words, '--out', str(tmp_path / 'one.yaml'))
    with first.held():
        until(lambda: told and told[-1].status == TrialStatus.RUNNING)
    until(lambda: told[-1].reason == 'its operator has ended it')
    until(back)
    with first.held():  # the same one anew, and those at other gains
        until(lambda: first.process.poll() is not None)
    assert first.process.returncode == 0, log.read_text()
    assert sum(item.status == TrialStatus.DONE for item in told) == 3
    assert read_machine_file(tmp_path / 'one.yaml').axes['Y'].controller == 'cascade'
    until(back)
    for lose in ('kill', 'close'):
        told.clear()
        lost = Terminal(graph, log, *words, '--out', str(tmp_path / 'two.yaml'))
        with lost.held():
            until(lambda: told and told[-1].status == TrialStatus.RUNNING)
            if lose == 'kill':
                lost.process.kill()
        if lose == 'close':
            lost.close()
        until(lambda: told[-1].status == TrialStatus.ENDED)
        until(back)
        assert lost.process.wait(HANG) != 0
        assert not (tmp_path / 'two.yaml').exists()
    graph.stop()
    report = replay(tmp_path / 'bag')
    (trials,) = (item for item in report.topics if item.topic.endswith('servo_trial_state'))
    assert trials.recorded == trials.recomputed > 6
    # Of late axis states the node answers the newest alone: it counts the others as missed, and
    # nothing repeats that.
    heard = max(state.stamp for state in states if not state.missed)
    assert trials.identical >= sum(item.stamp <= heard for item in every)
    assert trials.equal or states[-1].missed, trials
