# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Work by executors: bounded, and nothing lost when a process is killed."""

from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing import get_context

import pytest
from fleet_bags import doubled_or_killed

from fuzzycnc_ros.studies.fleet import in_flight
from fuzzycnc_ros.studies.fleet.in_flight import (
    Crew,
    InFlight,
    Killed,
    LostWorkersError,
    only,
)


class Slow(Executor):
    """Does nothing by itself; what it has been given is done when somebody waits for it."""

    def __init__(self):
        self.most, self._waiting = 0, []

    def submit(self, work, /, *arguments, **named):
        future = Future()
        self._waiting.append((future, work, arguments))
        self.most = max(self.most, len(self._waiting))
        if len(self._waiting) == 3:
            for held, task, given in self._waiting:
                held.set_result(task(*given))
            self._waiting.clear()
        return future


@pytest.fixture
def one_by_one(monkeypatch):
    monkeypatch.setattr(in_flight, 'TOGETHER', 1)


def test_no_more_than_a_bound_is_under_way(one_by_one):
    taken = []

    def items():
        for number in range(30):
            taken.append(number)
            yield number, ''

    executor = Slow()
    done = InFlight(doubled_or_killed, Crew(only(executor), in_flight=3)).done(items())
    first = next(done)
    assert len(taken) == 3
    results = dict([first, *done])
    assert results == {(number, ''): 2 * number for number in range(30)}
    assert executor.most == 3


def test_one_crew_does_one_work_after_another(one_by_one):
    crew = Crew(only(Slow()), in_flight=3)
    for first in (0, 3):
        items = [(number, '') for number in range(first, first + 3)]
        found = dict(InFlight(doubled_or_killed, crew).done(items))
        assert found == {item: 2 * item[0] for item in items}


class Immediate(Executor):
    """Does at once what it is given, unless a deadly piece is among it."""

    def __init__(self):
        self.given = 0

    def submit(self, work, /, *arguments, **named):
        self.given += 1
        future = Future()
        if any(fate == 'killed' for _, fate in arguments[-1]):
            future.set_exception(KilledError())
        else:
            future.set_result(work(*arguments))
        return future


class KilledError(Exception):
    """What the executor raises for what ended all its workers."""


def test_quick_pieces_are_handed_out_together():
    executor = Immediate()
    items = [(number, '') for number in range(400)]
    found = dict(InFlight(doubled_or_killed, Crew(only(executor), in_flight=4)).done(items))
    assert found == {item: 2 * item[0] for item in items}
    assert executor.given < 50


def test_of_a_lot_with_a_deadly_piece_all_others_are_done():
    items = [(number, 'killed' if number == 77 else '') for number in range(100)]
    crew = Crew(only(Immediate()), in_flight=4, killed=(KilledError,))
    found = dict(InFlight(doubled_or_killed, crew).done(items))
    assert found.pop((77, 'killed')) == Killed()
    assert found == {item: 2 * item[0] for item in items if item[0] != 77}


@pytest.fixture
def pools():
    """Start pools of two processes; end them with the test."""
    made = []

    def start():
        made.append(ProcessPoolExecutor(2, get_context('spawn')))
        return made[-1]

    yield start, made
    for pool in made:
        pool.shutdown(cancel_futures=True)


@pytest.mark.slow
def test_a_killed_worker_loses_nothing_and_a_deadly_piece_is_found(pools, tmp_path):
    start, made = pools
    fates = {3: str(tmp_path / 'once'), 7: 'killed'}
    items = [(number, fates.get(number, '')) for number in range(12)]
    found = dict(InFlight(doubled_or_killed, Crew(start, in_flight=4)).done(items))
    assert len(made) >= 3
    assert {item for item, result in found.items() if result == Killed()} == {(7, 'killed')}
    assert all(found[item] == 2 * item[0] for item in items if item[0] != 7)


@pytest.mark.slow
def test_without_other_workers_the_loss_is_said():
    with ProcessPoolExecutor(1, get_context('spawn')) as pool:
        work = InFlight(doubled_or_killed, Crew(only(pool), in_flight=2))
        with pytest.raises(LostWorkersError, match='repeat the command'):
            list(work.done([(1, ''), (2, 'killed')]))
