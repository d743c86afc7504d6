# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc up` on a live graph whose nodes are killed."""

import json
import os
import signal
import time

import pytest
from supervised_shift import MICRO, Up, check_steps

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.runtime.component import LATCHED
from fuzzycnc_ros.runtime.convert import decode
from fuzzycnc_ros.runtime.host import NodeConfiguration, NodeEvent
from fuzzycnc_ros.runtime.records import (
    Compensation,
    CompensationApplied,
    MachineState,
    Temperatures,
    ThermalError,
)

pytestmark = pytest.mark.ros

RATE = 120.0
"""Two minutes of machine time a second of wall time."""


@pytest.fixture
def supervised(graph, observer, model_file, tmp_path):
    """A shift under supervision."""
    folder = tmp_path / 'up'
    folder.mkdir()
    return Up(graph, observer, model_file, folder, RATE)


def records(bag, name, kind):
    """Return the records of a topic in a bag."""
    with BagReader(bag) as reader:
        return [
            decode(kind, message)
            for topic, _, _, message in reader.messages()
            if topic == f'/mill/{name}'
        ]


GROWN = 100_000
"""Size of a bag in which more than its first messages are [byte]."""


@pytest.mark.slow
@pytest.mark.realtime  # two minutes of machine time a second, and readings may not be missing long
def test_killed_nodes_come_back_without_a_step(supervised, observer):
    """One after the other, with compensation at work; the whole bag is looked at."""
    heard = {
        'temperature_acquisition': observer.records('temperatures', Temperatures),
        'thermal_predictor': observer.records('thermal_error', ThermalError),
        'compensator': supervised.told,
    }
    lives = observer.records('node_configuration', NodeConfiguration, LATCHED)

    observer.until(supervised.at_work, 'compensates')
    back_after = {}
    for node in ('temperature_acquisition', 'sensor_selector', 'thermal_predictor', 'compensator'):
        known, begun = len(heard.get(node, ())), supervised.lives(node)
        told_lives = len(lives)
        since = supervised.applied[-1].stamp
        os.kill(supervised.pid(node), signal.SIGKILL)
        killed = time.monotonic()
        observer.until(lambda n=node, b=begun: supervised.lives(n) > b, f'{node} is started again')
        observer.until(
            lambda n=node, k=told_lives: any(item.node == n for item in lives[k:]),
            f'{node} says what it runs with',
        )
        if node in heard:
            observer.until(lambda h=heard[node], k=known: len(h) > k + 1, f'{node} is back')
        observer.until(lambda s=since: supervised.at_work(s), 'compensates again')
        back_after[node] = round(time.monotonic() - killed, 2)
    print(f'time until compensating again [s]: {back_after}')
    # Temperatures were missing while their node was away.
    assert supervised.process.interrupt(signal.SIGTERM) == 1, supervised.process.output
    assert supervised.living() == []
    outcome = json.loads((supervised.folder / 'outcome.json').read_text())
    assert outcome['restarts'] == {f'mill/{node}': 1 for node in back_after}
    assert outcome['given_up'] == []
    assert '/mill/temperatures has ' in outcome['lacking'][0]

    bag = supervised.folder / 'bag'
    commands = records(bag, 'compensation', Compensation)
    readings = records(bag, 'compensation_applied', CompensationApplied)
    steps = check_steps(commands, readings)
    print(f'largest steps [um]: applied {steps[0] / MICRO:.2f}, told {steps[1] / MICRO:.2f}')
    assert max(item.epoch for item in commands) > 1
    events = records(bag, 'node_event', NodeEvent)
    assert not [event for event in events if event.name == 'sources'], 'a restart is no stranger'


@pytest.mark.slow
def test_killed_recorder_goes_on_in_another_bag(supervised, observer):
    """The machine, which makes time, ends the run when it dies."""
    states = observer.records('machine_state', MachineState)
    observer.until(lambda: len(states) > 20, 'the machine runs')
    os.kill(supervised.pid('recorder'), signal.SIGKILL)
    again = supervised.folder / 'bag_again1'
    file = again / 'bag_again1_0.mcap'
    # What stands at its beginning is smaller: now it holds what came later.
    observer.until(lambda: file.exists() and file.stat().st_size > GROWN, 'another bag grows')
    count = len(states)
    observer.until(lambda: len(states) > count + 20, 'the machine runs on')
    os.kill(supervised.pid('simulated_machine'), signal.SIGKILL)
    assert supervised.process.wait() == 2
    assert 'mill/simulated_machine was killed by SIGKILL' in supervised.process.output
    assert supervised.living() == []
    assert len(records(again, 'machine_state', MachineState)) > 10
