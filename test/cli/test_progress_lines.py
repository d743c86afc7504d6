# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import io
import threading
from types import SimpleNamespace

import pytest
from rich.console import Console

from fuzzycnc_ros.cli import progress_lines as module
from fuzzycnc_ros.cli.console import progress_bar
from fuzzycnc_ros.cli.demo.steps import progress_of
from fuzzycnc_ros.cli.progress_lines import PERIOD, ProgressLines


class Clock:
    """A clock that goes when it is told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def written():
    return []


def test_a_line_every_ten_seconds_says_what_and_how_many_of_how_many(clock, written):
    lines = ProgressLines('comparing', written.append, clock)
    for second in range(35):
        clock.now = 100.0 + second
        lines.tell(f'run {second // 10}', second // 10, 4)
    assert PERIOD == 10.0
    assert written == [
        'comparing: run 1, 1 of 4, 10 s so far',
        'comparing: run 2, 2 of 4, 20 s so far',
        'comparing: run 3, 3 of 4, 30 s so far',
    ]


def test_work_that_tells_nothing_is_named_all_the_same(clock, written):
    lines = ProgressLines('fitting', written.append, clock)
    clock.now += 9.9
    lines.look()
    assert written == []
    clock.now += 0.2
    lines.look()
    lines.look()
    assert written == ['fitting, 10 s so far']
    lines.tell('fitting', 0, 2)
    clock.now += 60.0
    lines.look()
    assert written[1:] == ['fitting, 0 of 2, 70 s so far']


def test_of_a_large_total_the_share_is_told_and_pieces_stand_in_one_line(clock, written):
    lines = ProgressLines('judging', written.append, clock)
    lines.tell('a (1 of 2): mlp\nb (2 of 2): arma', 1234, 2000)
    clock.now += PERIOD
    lines.look()
    assert written == ['judging: a (1 of 2): mlp; b (2 of 2): arma, 62 %, 10 s so far']


@pytest.fixture
def each_at_once(monkeypatch):
    """Each line is due, no other thread writes, and the clock stands on a busy computer too."""
    monkeypatch.setattr(module, 'PERIOD', 0.0)
    monkeypatch.setattr(module, 'LOOK', 60.0)
    monkeypatch.setattr(module, 'time', SimpleNamespace(monotonic=lambda: 0.0))


@pytest.mark.usefixtures('each_at_once')
def test_a_command_in_a_pipe_writes_its_lines_to_standard_error(capsys):
    with progress_bar('training') as tell:
        tell('mlp', 3, 8)
        tell('arma', 4, 8)
    out, err = capsys.readouterr()
    assert out == ''
    assert err.splitlines()[:2] == [
        'training: mlp, 3 of 8, 0 s so far',
        'training: arma, 4 of 8, 0 s so far',
    ]
    assert 'progress' not in [thread.name for thread in threading.enumerate()]


def test_lines_come_while_the_work_is_silent(monkeypatch):
    seen = threading.Event()
    monkeypatch.setattr(module, 'PERIOD', 0.0)
    monkeypatch.setattr(module, 'LOOK', 1e-3)
    monkeypatch.setattr(module, '_write', lambda line: seen.set())
    with progress_bar('training'):
        assert seen.wait(60.0)


@pytest.mark.usefixtures('each_at_once')
def test_steps_of_a_demo_tell_the_same_way(capsys):
    console = Console(file=io.StringIO())
    with progress_of(console) as steps, steps.step('trained models') as bar:
        bar.update(2, 5)
    assert 'trained models' in console.file.getvalue()
    assert capsys.readouterr().err.splitlines()[0] == 'trained models, 2 of 5, 0 s so far'
