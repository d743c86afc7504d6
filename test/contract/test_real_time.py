# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Tests in real time are judged only where time is kept, and then they are."""

from types import SimpleNamespace

import pytest
import real_time
from processes import wait_for
from real_time import PROCESSES, WORK, Deadlines

SLOW, QUICK = Deadlines(80, 100), Deadlines(95, 100)


@pytest.fixture
def item(monkeypatch):
    """A test in real time, on a machine that keeps the deadlines of a list in turn."""
    machine = []
    monkeypatch.setattr(real_time, 'measure', lambda: machine.pop(0))
    monkeypatch.setattr(real_time, 'held_still', real_time.contextlib.nullcontext)
    return SimpleNamespace(
        machine=machine,
        location=('test_x.py', 3, 'test_x'),
        get_closest_marker=lambda name: name == 'realtime',
    )


def report(outcome, when='call'):
    """Return a report as pytest makes it."""
    return SimpleNamespace(
        failed=outcome == 'failed', when=when, outcome=outcome, longrepr='why', sections=[]
    )


def test_a_slow_machine_is_named_before(item):
    item.machine.append(SLOW)
    with pytest.raises(pytest.skip.Exception, match='this machine keeps 80 of 100 deadlines'):
        real_time.before(item)
    item.machine.append(QUICK)
    real_time.before(item)


def test_a_failure_on_a_quick_machine_stays_one(item):
    item.machine.append(QUICK)
    found = report('failed')
    real_time.after(item, found)
    assert found.outcome == 'failed'
    assert found.longrepr == 'why'
    assert '95 of 100' in found.sections[0][1]


def test_a_failure_on_a_slow_machine_is_not_judged(item):
    item.machine.append(SLOW)
    found = report('failed')
    real_time.after(item, found)
    assert found.outcome == 'skipped'
    assert found.longrepr[2].startswith('Skipped: not judged: this machine keeps 80 of 100')


def test_nothing_else_is_touched(item):
    for found in (report('passed'), report('failed', 'setup'), report('failed', 'teardown')):
        real_time.after(item, found)
        assert found.longrepr == 'why'
    item.get_closest_marker = lambda name: None
    found = report('failed')
    real_time.after(item, found)
    assert found.outcome == 'failed'
    real_time.before(item)


@pytest.mark.parametrize('work', [0, 400 * WORK])
def test_deadlines_are_counted(monkeypatch, work):
    """With nothing to do by them some are kept on any machine, with far too much none."""
    script = real_time.SCRIPT.replace(f'range({WORK})', f'range({work})')
    monkeypatch.setattr(real_time, 'SCRIPT', script)
    found = real_time.measure()
    assert found.passed == PROCESSES * real_time.DEADLINES
    if work:
        assert found.kept == 0
    else:  # a busy machine may begin too late for all of them
        wait_for(lambda: real_time.measure().kept > 0, 'a deadline that is kept')
    assert not Deadlines(0, found.passed).enough


def test_processes_stand_still_while_it_is_measured():
    with real_time.subprocess.Popen(['sleep', '600']) as process:
        try:
            with real_time.held_still():
                wait_for(lambda: state(process) == 'T', 'it stands')
            wait_for(lambda: state(process) != 'T', 'it goes on')
        finally:
            process.kill()


def state(process):
    """Return the state of a process."""
    with open(f'/proc/{process.pid}/stat') as file:
        return file.read().rpartition(')')[2].split()[0]
