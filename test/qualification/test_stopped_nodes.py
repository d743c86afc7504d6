# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc up` whose nodes stand still for a minute each or longer, with compensation at work."""

import os
import signal
from contextlib import suppress

import numpy as np
import pytest
from supervised_shift import Up, check_steps

from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.graph.bring_up import NODE_STOP, RestartPolicy
from fuzzycnc_ros.runtime.enums import CompensationState

pytestmark = [pytest.mark.ros, pytest.mark.qualify, pytest.mark.realtime]

RATE = 20.0
"""Machine time per wall time: a stop is 20 min of the machine."""
STOP = 60.0
"""Wall time of a stop [s]."""
HANG = RestartPolicy.silence_max + NODE_STOP + 5.0
"""Wall time of a stop [s] in which a node is asked to end, and killed."""


@pytest.fixture
def supervised(graph, observer, model_file, tmp_path):
    """A shift under supervision, with a page."""
    folder = tmp_path / 'up'
    folder.mkdir()
    return Up(graph, observer, model_file, folder, RATE, '--page=0')


def stand_still(supervised, observer, duration, *nodes):
    """Stop nodes for some wall time [s]; return who was stopped."""
    pids = [supervised.pid(node) for node in nodes]
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    try:
        observer.spin_for(duration)
    finally:
        for pid in pids:
            with suppress(ProcessLookupError):  # it was ended meanwhile
                os.kill(pid, signal.SIGCONT)
    return pids


def stopped(supervised, observer, *nodes):
    """Stop nodes for a minute; return what was told and applied in the meantime."""
    told, applied = len(supervised.told), len(supervised.applied)
    output = len(supervised.process.output)
    stand_still(supervised, observer, STOP, *nodes)
    named = supervised.process.output[output:]
    assert all(f'{node}: silent' in named for node in nodes), named
    return supervised.told[told:], supervised.applied[applied:]


def test_every_node_may_stand_still_for_a_minute(supervised, observer):
    """All recover by themselves, no offset steps, and none stays without its owner."""

    def works_again():
        since = supervised.applied[-1].stamp
        observer.until(lambda: supervised.at_work(since), 'compensates again')

    observer.until(supervised.at_work, 'compensates')

    # What moves nothing may stand still, all of it at once.
    told, applied = stopped(supervised, observer, 'sensor_selector', 'recorder', 'dashboard')
    assert {item.state for item in told} == {CompensationState.ACTIVE}
    assert {item.status for item in applied} == {OffsetStatus.FOLLOWING}

    for node in ('temperature_acquisition', 'thermal_predictor'):
        told, applied = stopped(supervised, observer, node)
        states = [item.state for item in told]
        assert CompensationState.HOLDING in states
        assert states[-1] != CompensationState.ACTIVE
        assert not np.any(applied[-1].offset), 'held, then back to zero'
        works_again()

    told, applied = stopped(supervised, observer, 'compensator')
    assert not told
    assert not np.any(applied[-1].offset), 'the machine itself goes back to zero'
    works_again()

    stopped(supervised, observer, 'simulated_machine')  # time stands still with it
    works_again()

    # Who stands still for longer than nodes wait for one another is started anew.
    (pid,) = stand_still(supervised, observer, HANG, 'compensator')
    assert 'compensator said nothing for' in supervised.process.output
    works_again()
    assert supervised.pid('compensator') != pid

    assert supervised.process.interrupt(signal.SIGTERM) in (0, 1), supervised.process.output
    assert supervised.living() == []
    check_steps(supervised.told, supervised.applied)
