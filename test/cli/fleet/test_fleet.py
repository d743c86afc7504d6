# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc fleet`: from bags of several machines to models, a table and a page."""

import contextlib
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from command_lines import read_json
from fleet_bags import DAY, FIRST_DAY, warm_up, write_bag
from processes import HANG, children, start, wait_for

from fuzzycnc_ros.studies.fleet.cache import FILE


@pytest.fixture
def here(monkeypatch):
    """Work in this process: starting others costs more than the work on such small bags."""
    for module in ('evaluate', 'machines'):
        monkeypatch.setattr(
            f'fuzzycnc_ros.cli.fleet.{module}.crew_of', lambda *options: nullcontext()
        )


@pytest.fixture
def archive(fuzzycnc, here):
    """Three bags of each of two machines, in a folder for each, and one that is none."""
    for number in range(6):
        machine = f'mill_{number % 2 + 1}'
        path = Path('archive', machine, f'day_{number // 2}')
        write_bag(warm_up(number, samples=60), path, FIRST_DAY + number * DAY, machine)
    Path('archive/mill_1/torn').mkdir()
    Path('archive/mill_1/torn/torn_0.mcap').write_bytes(b'no bag')


def test_from_bags_to_a_page(fuzzycnc, archive):
    quick = ('--models', 'static_ridge,lag_ridge')
    trained = fuzzycnc('fleet', 'train', 'archive', '--out', 'models', *quick, '--json', 't.json')
    assert trained.code == 1
    assert 'left out torn: archive/mill_1/torn/torn_0.mcap:' in trained.out
    assert sorted(path.name for path in Path('models').iterdir()) == ['mill_1.json', 'mill_2.json']
    document = read_json('t.json')
    assert document['machines']['mill_2']['runs'] == [f'mill_2/day_{day}' for day in range(3)]
    assert [item['name'] for item in document['left_out']] == ['torn']
    shutil.rmtree('archive/mill_1/torn')
    again = fuzzycnc('fleet', 'train', 'archive', '--out', 'models')
    assert again.code == 0
    assert again.out.count('stays as it is; --force trains it anew') == 2

    arguments = ('archive', '--model', 'models', '--out', 'shop.parquet', '--json', 'e.json')
    judged = fuzzycnc('fleet', 'evaluate', *arguments)
    assert judged.code == 0, judged
    assert judged.out.splitlines() == [
        '6 bags: 6 judged now, 0 known from before',
        'shop.parquet: written, 12 rows',
    ]
    document = read_json('e.json')
    assert (document['rows'], document['left_out']) == (12, [])
    known = fuzzycnc('fleet', 'evaluate', *arguments)
    assert known.out.startswith('6 bags: 0 judged now, 6 known from before\n')

    shown = fuzzycnc('fleet', 'report', 'shop.parquet', '--out', 'shop.html', '--json', 'r.json')
    assert shown.code == 0, shown
    assert 'fewer than 8 bags' in shown.out
    assert len(read_json('r.json')['drifts']) == 4
    assert 'The machines of a shop' in Path('shop.html').read_text()


def test_models_are_compared_on_each_machine(fuzzycnc, archive):
    shutil.rmtree('archive/mill_1/torn')
    arguments = ('archive', '--models', 'static_ridge,lag_ridge', '--runs', '2')
    found = fuzzycnc('fleet', 'compare', *arguments, '--json', 'c.json')
    assert found.code == 0, found
    machines = read_json('c.json')['machines']
    assert list(machines) == ['mill_1', 'mill_2']
    # The oldest and the newest.
    assert machines['mill_1']['runs'] == ['mill_1/day_0', 'mill_1/day_2']
    assert set(machines['mill_1']['pooled']) >= {'uncompensated', 'static_ridge', 'default'}
    assert found.out.count('mill_2') == 2


def test_bad_bags_are_named_and_end_with_1(fuzzycnc, archive):
    fuzzycnc('fleet', 'train', 'archive/mill_2', '--out', 'models', '--models', 'lag_ridge')
    arguments = ('archive', '--model', 'models/mill_2.json', '--model', 'gone.json')
    found = fuzzycnc('fleet', 'evaluate', *arguments, '--out', 'o.parquet', '--json', 'o.json')
    assert found.code == 1
    left_out = {item['name']: item['reason'] for item in read_json('o.json')['left_out']}
    assert list(left_out) == ['gone.json', 'torn']
    assert left_out['gone.json'].startswith('gone.json: expected a file but nothing is there')


@pytest.mark.parametrize(
    ('options', 'naming'),
    [
        (('--workers', '0'), ('--workers: expected 1 or more',)),
        (('--workers', '2', '--dask', 'tcp://127.0.0.1:1'), ('--dask: expected no --workers',)),
        (('--machine-by', 'name'), ('--machine-by: expected bag or folder',)),
        (('--model', 'gone.json'), ('gone.json: expected a file but nothing is there',)),
        (('--out', 'nowhere/shop.parquet'), ('expected an existing folder but found no nowhere',)),
    ],
)
def test_what_is_refused(refused, monkeypatch, options, naming):
    model = ('--model', 'mill.json') if '--model' not in options else ()
    if model:
        monkeypatch.setattr(
            'fuzzycnc_ros.studies.fleet.evaluation.read_models', lambda places: ((), [])
        )
    refused('fleet', 'evaluate', 'bags', '--out', 'shop.parquet', *model, *options, naming=naming)


def test_a_missing_dask_is_named(refused, monkeypatch):
    monkeypatch.setitem(sys.modules, 'distributed', None)
    monkeypatch.setattr(
        'fuzzycnc_ros.studies.fleet.evaluation.read_models', lambda places: ((), [])
    )
    arguments = ('bags', '--model', 'm.json', '--out', 'o.parquet', '--dask', 'tcp://127.0.0.1:1')
    refused(
        'fleet', 'evaluate', *arguments,
        naming=('needs distributed', "pip install 'fuzzycnc_ros[fleet]'"),
    )  # fmt: skip


@pytest.mark.parametrize('address', ['nonsense', 'zzz://127.0.0.1:1'])
def test_an_address_that_is_none_is_refused(refused, monkeypatch, address):
    pytest.importorskip('distributed')
    monkeypatch.setattr(
        'fuzzycnc_ros.studies.fleet.evaluation.read_models', lambda places: ((), [])
    )
    arguments = ('bags', '--model', 'm.json', '--out', 'o.parquet', '--dask', address)
    refused('fleet', 'evaluate', *arguments, naming=(f'at {address} but this is no address',))


def test_a_table_that_is_none_is_refused(refused):
    Path('shop.parquet').write_text('no table')
    refused(
        'fleet', 'report', 'shop.parquet', '--out', 'o.html',
        naming=('shop.parquet: expected a Parquet file',),
    )  # fmt: skip


# With processes

BAGS = 60

CLUSTER = """
import sys
from distributed import LocalCluster

if __name__ == '__main__':
    cluster = LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=':0', host='127.0.0.1'
    )
    print(cluster.scheduler_address, *[worker.pid for worker in cluster.workers.values()])
    sys.stdout.flush()
    sys.stdin.read()
    cluster.close()
"""


@pytest.fixture
def large(archive, fuzzycnc):
    """Enough bags to interrupt the work on them, and the table of one process."""
    shutil.rmtree('archive/mill_1/torn')
    fuzzycnc('fleet', 'train', 'archive', '--out', 'models', '--models', 'static_ridge')
    for number in range(6, BAGS):
        machine = f'mill_{number % 2 + 1}'
        path = Path('archive', machine, f'day_{number // 2}')
        write_bag(warm_up(number, samples=60), path, FIRST_DAY + number * DAY, machine)
    outcome = fuzzycnc(*words('alone'))
    assert outcome.code == 0, outcome
    return Path('alone.parquet').read_bytes()


def words(name, *options):
    return (
        'fleet', 'evaluate', 'archive', '--model', 'models', '--out', f'{name}.parquet',
        '--cache', f'cache_{name}', *options,
    )  # fmt: skip


def begin(root, *command):
    """Start a command in a process group of its own."""
    return start(
        [sys.executable, '-c', 'from fuzzycnc_ros.cli.main import main; main()', *command],
        env={**os.environ, 'PYTHONPATH': str(root)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def kept(name):
    """Return how many bags a cache has."""
    file = Path(f'cache_{name}', FILE)
    if not file.exists():
        return 0
    with contextlib.closing(sqlite3.connect(file, timeout=HANG)) as base:
        try:
            return base.execute('select count(*) from bags').fetchone()[0]
        except sqlite3.OperationalError:
            return 0  # its tables are not there yet


def ended(process):
    out, err = process.communicate(timeout=HANG)
    assert process.returncode == 0, err
    return out


@pytest.mark.slow
def test_a_command_that_was_killed_goes_on_where_it_was(large, root):
    process = begin(root, *words('killed', '--workers', '2'))
    wait_for(lambda: kept('killed') >= 5, 'some bags were judged')
    process.kill()
    process.communicate()
    done = kept('killed')
    assert not Path('killed.parquet').exists()
    out = ended(begin(root, *words('killed', '--workers', '2')))
    known = int(re.search(r'(\d+) known from before', out).group(1))
    assert done <= known < BAGS
    assert Path('killed.parquet').read_bytes() == large


@pytest.mark.slow
def test_an_interrupt_ends_clean(large, root):
    process = begin(root, *words('stopped', '--workers', '2'))
    wait_for(lambda: kept('stopped') >= 3, 'some bags were judged')
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=HANG)
    assert (process.returncode, out) == (130, '')
    assert err.endswith('interrupted\n')
    assert 'Traceback' not in err
    assert not list(Path().glob('*stopped.parquet*'))


@pytest.mark.slow
def test_two_runs_at_once_share_a_cache(large, root):
    """Both finish, with the same table."""
    processes = [begin(root, *words('shared', '--workers', '1')) for _ in range(2)]
    for process in processes:
        ended(process)
    assert Path('shared.parquet').read_bytes() == large
    assert kept('shared') == BAGS


@pytest.mark.slow
def test_a_killed_worker_of_its_own_loses_nothing(large, root):
    process = begin(root, *words('worker', '--workers', '2'))
    wait_for(lambda: kept('worker') >= 3, 'some bags were judged')
    workers = children(process.pid, 'spawn_main')
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    assert f'{BAGS} bags: {BAGS} judged now' in ended(process)
    assert Path('worker.parquet').read_bytes() == large
    # What is known needs nobody.
    assert f'{BAGS} known from before' in ended(begin(root, *words('worker', '--workers', '1')))
    assert Path('worker.parquet').read_bytes() == large


@pytest.mark.slow
def test_a_killed_worker_of_dask_loses_nothing(large, root):
    Path('cluster.py').write_text(CLUSTER)
    environment = {**os.environ, 'PYTHONPATH': str(root), 'OMP_NUM_THREADS': '1'}
    cluster = start(
        [sys.executable, 'cluster.py'], env=environment, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    try:
        address, first, _ = cluster.stdout.readline().split()
        process = begin(root, *words('dask', '--dask', address))
        wait_for(lambda: kept('dask') >= 5, 'some bags were judged')
        os.kill(int(first), signal.SIGKILL)
        assert f'{BAGS} bags: {BAGS} judged now' in ended(process)
        assert Path('dask.parquet').read_bytes() == large
        quick = ('archive', '--runs', '2', '--models', 'static_ridge')
        compared = begin(root, 'fleet', 'compare', *quick, '--dask', address)
        assert 'mill_2' in ended(compared)
    finally:
        cluster.stdin.close()
        cluster.stdout.close()
        cluster.wait(HANG)
    # What is known needs nobody.
    assert f'{BAGS} known from before' in ended(begin(root, *words('dask', '--workers', '1')))
