# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Work in other processes: order, progress, errors, and that none is left behind."""

import itertools
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from processes import HANG, start, wait_for

from fuzzycnc_ros.cli.models.fit_progress import FitCounter

SCRIPT = """
import json, os, sys, time
from pathlib import Path
from fuzzycnc_ros.cli import workers
from fuzzycnc_ros.cli.workers import in_workers
from fuzzycnc_ros.ros.processes import interruptible

workers.END_PATIENCE = 240.0  # a busy machine takes its time

def work(piece, progress):
    if piece == 'bad':
        while len(list(Path().glob('*.pid'))) < 1:
            time.sleep(0.01)
        raise ValueError('piece is bad')
    if piece == 'endless':
        try:
            Path(f'{os.getpid()}.part').touch()
            os.rename(f'{os.getpid()}.part', f'{os.getpid()}.pid')
            time.sleep(600.0)
        finally:
            Path(f'{os.getpid()}.undone').touch()
    for step in range(3):
        progress('fit', 'mlp', step, 3)
        time.sleep(0.11)
    return piece, os.environ['OMP_NUM_THREADS'], os.getpid()

if __name__ == '__main__':
    told = []
    pieces = sys.argv[2:]
    try:
        with interruptible():
            done = in_workers(work, pieces, pieces, int(sys.argv[1]), lambda *n: told.append(n))
        print(json.dumps([done, told, os.environ.get('OMP_NUM_THREADS')]))
    except ValueError as error:
        print(error)
    except KeyboardInterrupt:
        sys.exit(130)
"""


@pytest.fixture
def script(tmp_path, root):
    """Start the script in a process group of its own: `script(jobs, *pieces)`."""
    Path(tmp_path, 'script.py').write_text(SCRIPT)
    environment = {**os.environ, 'PYTHONPATH': str(root)}
    started = []

    def begin(jobs, *pieces, interrupts='default'):
        process = start(
            [sys.executable, 'script.py', str(jobs), *pieces], interrupts=interrupts,
            cwd=tmp_path, env=environment,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        started.append(process)
        return process

    yield begin
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


def running(pid: int) -> bool:
    try:
        state = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
    except FileNotFoundError:
        return False
    return state != 'Z'


def test_results_keep_their_order_and_progress_never_goes_back(script):
    out, err = script(2, 'a', 'b', 'c').communicate(timeout=HANG)
    assert err == ''
    done, told, threads = json.loads(out)
    assert [piece for piece, *_ in done] == ['a', 'b', 'c']
    assert {count for _, count, _ in done} == {'1'}
    assert len({pid for *_, pid in done}) <= 2
    assert threads == os.environ.get('OMP_NUM_THREADS')
    steps = [step for _, step, _ in told]
    assert steps == sorted(steps)
    assert steps[-1] == told[-1][2]
    assert any('b (2 of 3): fitting mlp (2 of 3)' in text for text, *_ in told)


ENDS = itertools.product(
    ('process', 'group'), (signal.SIGINT, signal.SIGTERM, signal.SIGKILL), ('default', 'ignored')
)
EACH_ONCE = [
    ('process', signal.SIGINT, 'ignored'),
    ('process', signal.SIGKILL, 'default'),
    ('group', signal.SIGINT, 'default'),
    ('group', signal.SIGTERM, 'ignored'),
]
"""Each signal, receiver and beginning; the other ways to combine them are slow."""


@pytest.mark.parametrize(
    ('to', 'number', 'interrupts'),
    [pytest.param(*end, marks=[] if end in EACH_ONCE else [pytest.mark.slow]) for end in ENDS],
)
def test_nobody_is_left_behind(script, tmp_path, to, number, interrupts):
    """A terminal sends to the group, and so do those who end all of a service."""
    process = script(2, 'endless', 'endless', interrupts=interrupts)
    wait_for(lambda: len(list(tmp_path.glob('*.pid'))) == 2, 'both work')
    workers = [int(path.stem) for path in tmp_path.glob('*.pid')]
    assert all(running(pid) for pid in workers)
    os.kill(process.pid if to == 'process' else -process.pid, number)
    out, err = process.communicate(timeout=HANG)
    wait_for(lambda: not any(running(pid) for pid in workers), 'the workers end')
    if number != signal.SIGKILL:
        assert (process.returncode, out, err) == (130, '', '')
    if number != signal.SIGKILL or to == 'process':
        assert len(list(tmp_path.glob('*.undone'))) == 2


def test_an_error_ends_the_others_and_comes_through(script, tmp_path):
    process = script(2, 'endless', 'bad')
    out, err = process.communicate(timeout=HANG)
    assert (process.returncode, out.strip(), err) == (0, 'piece is bad', '')
    (worker,) = (int(path.stem) for path in tmp_path.glob('*.pid'))
    assert not running(worker)
    assert len(list(tmp_path.glob('*.undone'))) == 1


def test_fits_are_counted_per_candidate():
    phrase = FitCounter()
    assert phrase('select_sensors', 't3', 0, 9) == 'trying sensor t3'
    assert phrase('fit', 'mlp', 0, 2) == 'fitting mlp (1 of 2)'
    assert phrase('fit', 'mlp', 0, 2) == 'fitting mlp (1 of 2), 1 fit'
    assert phrase('fit', 'mlp', 0, 2) == 'fitting mlp (1 of 2), 2 fits'
    assert phrase('fit', 'arma', 1, 2) == 'fitting arma (2 of 2)'
    assert phrase('fit', 'arma', 2, 2) == 'fitting arma (2 of 2), 1 fit'
