# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Time of a sender of motion: the newest of records, deadlines, requests; it never goes back."""

from dataclasses import replace

import pytest
from benches.feedrate_rig import SMALL, Rig, path_of
from benches.joint_rig import JointRig

from fuzzycnc_ros.runtime.records import SECOND


def scheduler():
    """Return a scheduler that runs a path, and the time of its newest record."""
    rig = Rig()
    rig.run(path_of(SMALL), until=lambda: len(rig.records()) == 2)
    return rig.component, rig.time


def joint_bridge():
    """Return a bridge that follows a goal, and the time of its newest record."""
    rig = JointRig()
    rig.follow('a', (2.0, 4.0), ((0.01, 0.0, 0.0), (0.02, 0.01, 0.0)))
    rig.until(lambda: len(rig.parts()) == 5)
    return rig.component, rig.time


@pytest.mark.parametrize('sender', [scheduler, joint_bridge])
@pytest.mark.parametrize('ahead', [-SECOND, 0, 7_000_000])
def test_stop_that_is_asked_for_has_the_newest_time(sender, ahead):
    """The clock of a node may be behind the stamps of what it has read."""
    component, now = sender()
    answer = component.on_request('deactivate', {}, now + ahead)
    assert answer.success
    assert {item.record.stamp for item in answer.emissions} == {now + max(ahead, 0)}


@pytest.mark.parametrize('sender', [scheduler, joint_bridge])
def test_deadline_moves_the_time_forward(sender):
    """One may fall due before the next record comes, and a request may be older than it."""
    component, now = sender()
    due = component.next_deadline
    list(component.on_deadline(due))
    assert due > now
    answer = component.on_request('deactivate', {}, now)
    assert {item.record.stamp for item in answer.emissions} == {due}


@pytest.mark.parametrize('sender', [scheduler, joint_bridge])
def test_late_deadline_does_not_set_the_time_back(sender):
    """Records of other inputs may have come with later stamps."""
    component, now = sender()
    list(component.on_deadline(now - 1))
    answer = component.on_request('deactivate', {}, now - 1)
    assert {item.record.stamp for item in answer.emissions} == {now}


@pytest.mark.parametrize('sender', [scheduler, joint_bridge])
def test_late_record_does_not_set_the_time_back(sender):
    """Inputs come from several nodes, and a record may be older than that of another input."""
    component, now = sender()
    state = component.last(component.FOLLOWED)
    list(component.receive(component.FOLLOWED, replace(state, stamp=now - SECOND)))
    answer = component.on_request('deactivate', {}, now - SECOND)
    assert {item.record.stamp for item in answer.emissions} == {now}
