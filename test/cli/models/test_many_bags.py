# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Many bags on one command line: which are meant, and one bad one hides no other."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from command_lines import read_json
from small_recordings import IMPORT, warm_up

from fuzzycnc_ros.bags.finding import find_bags
from fuzzycnc_ros.cli.models.many_bags import cores, jobs_of


def names(*places):
    return [bag.name for bag in find_bags([Path(place) for place in places])]


def bag_at(path):
    """Make something that looks like a bag from outside."""
    folder = Path(path)
    folder.mkdir(parents=True)
    (folder / f'{folder.name}_0.mcap').touch()
    return folder


@pytest.fixture
def shop(tmp_path, monkeypatch):
    """Folders of bags of two machines."""
    monkeypatch.chdir(tmp_path)
    for path in ('mill/day_2', 'mill/day_1', 'mill/old/day_0', 'lathe/day_1'):
        bag_at(path)
    Path('mill/notes.txt').touch()
    Path('single.mcap').touch()
    Path('empty').mkdir()


@pytest.mark.parametrize(
    ('places', 'expected'),
    [
        (['mill/day_2', 'mill/day_1'], ['day_2', 'day_1']),  # as they are given
        (['mill'], ['day_1', 'day_2', 'day_0']),
        (['mill/day_*'], ['day_1', 'day_2']),
        (['mill/*'], ['day_1', 'day_2', 'day_0']),
        (['**/day_[01]'], ['lathe/day_1', 'mill/day_1', 'day_0']),
        (['*.mcap', 'mill/day_2'], ['single', 'day_2']),
        (['mill/**'], ['day_1', 'day_2', 'day_0']),
        (['lathe/**/*'], ['day_1']),
        (['.'], ['lathe/day_1', 'mill/day_1', 'day_2', 'day_0']),
        (['empty', 'gone'], ['empty', 'gone']),  # whoever reads them says so
    ],
)
def test_which_bags_are_meant(shop, places, expected):
    if places == ['.']:
        Path('single.mcap').unlink()  # else the folder itself is a bag
    assert names(*places) == expected


@pytest.mark.parametrize(
    'places', [['mill', 'mill/day_1'], ['lathe/day_1', './lathe/day_1'], ['mill/*', 'mill/day*']]
)
def test_a_bag_named_twice(shop, places):
    with pytest.raises(ValueError, match=r"'day_1' twice; give each once"):
        names(*places)


@pytest.mark.parametrize('pattern', ['drill/*', 'mill/*.txt', '[x]'])
def test_a_pattern_that_fits_nothing(shop, pattern):
    with pytest.raises(ValueError, match='expected a pattern that fits bags but it fits none'):
        names(pattern)


def test_bags_in_folders_of_equal_names_are_told_apart(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in ('a/x/run', 'b/x/run', 'c/run'):
        bag_at(path)
    assert names('.') == ['a/x/run', 'b/x/run', 'c/run']


def test_number_of_processes():
    assert jobs_of(None) == cores() >= 1
    assert jobs_of(3) == 3
    with pytest.raises(ValueError, match='--jobs'):
        jobs_of(0)


@pytest.fixture
def folder(bag, model):
    """A folder of three good bags and a torn one."""
    Path('runs').mkdir()
    for name, rows in (('a', 120), ('b', 100), ('c', 90), ('torn', 120)):
        shutil.move(bag(name, rows=rows), f'runs/{name}')
    file = Path('runs/torn/torn_0.mcap')
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    return Path('runs')


@pytest.mark.slow
def test_evaluate_shows_each_run_and_all_of_them_and_names_a_bad_one(fuzzycnc, folder, model):
    documents = []
    for jobs in ('1', '2'):
        options = ('--model', model, '--jobs', jobs, '--json', 'e.json')
        outcome = fuzzycnc('evaluate', folder, *options)
        assert outcome.code == 1, outcome
        documents.append(Path('e.json').read_text())
    assert documents[0] == documents[1]
    assert 'left out torn: ' in outcome.out
    assert 'torn_0.mcap: truncated' in outcome.out
    figures = read_json('e.json')
    assert list(figures['runs']) == ['a', 'b', 'c']
    assert list(figures['left_out']) == ['torn']
    found = [figures['runs'][name]['default']['dz']['rms_um'] for name in 'abc']
    overall = figures['overall']['default']['dz']
    assert overall['median_rms_um'] == pytest.approx(np.median(found))
    assert overall['worst_rms_um'] == pytest.approx(max(found))
    rows = [line.split()[0] for line in outcome.out.splitlines() if line]
    assert rows[3:8] == ['a', 'b', 'c', 'Median', 'Worst']
    # A run's figures do not depend on its company.
    assert fuzzycnc('evaluate', 'runs/b', '--model', model, '--json', 'b.json').code == 0
    assert read_json('b.json')['runs']['b'] == figures['runs']['b']


@pytest.mark.slow
def test_evaluate_of_good_bags_ends_with_0_and_writes_all_into_the_report(fuzzycnc, folder, model):
    outcome = fuzzycnc('evaluate', 'runs/[ab]', '--model', model, '--report', 'e.html')
    assert outcome.code == 0, outcome
    page = Path('e.html').read_text()
    assert page.count('class="chart"') >= 4


@pytest.mark.usefixtures('here')
def test_nothing_but_bad_bags(refused, folder, model):
    shutil.move('runs/torn', 'torn')
    bags = ('torn', 'gone')
    refused('evaluate', *bags, '--model', model, naming=['none of 2', 'truncated', 'gone'])
    refused('compare', *bags, naming=['none of 2', 'truncated', 'gone'])


@pytest.mark.slow
def test_compare_leaves_a_bad_bag_out_of_everything(fuzzycnc, folder):
    options = ('--models', 'static_ridge,lag_ridge', '--json')
    outcome = fuzzycnc('compare', folder, *options, 'c.json')
    assert outcome.code == 1, outcome
    assert 'left out torn: ' in outcome.out
    figures = read_json('c.json')
    assert list(figures['left_out']) == ['torn']
    shutil.rmtree('runs/torn')
    outcome = fuzzycnc('compare', folder, *options, 'd.json')
    assert outcome.code == 0, outcome
    assert read_json('d.json') == {**figures, 'left_out': {}}
    rows = figures['held_out'].values()
    worst = max(item['figures']['lag_ridge']['dz']['max_um'] for item in rows)
    assert figures['overall']['lag_ridge']['dz']['worst_max_um'] == pytest.approx(worst)
    assert 'Worst' in outcome.out


def test_compare_names_what_could_not_be_judged_and_shows_the_others(fuzzycnc, bag, monkeypatch):
    def in_workers(work, pieces, names, jobs, tell):
        return [work(piece, lambda *news: None) for piece in pieces]

    monkeypatch.setattr('fuzzycnc_ros.cli.workers.in_workers', in_workers)
    long = bag('long', rows=120)
    options = ('--hold-out', '0:1500', '--hold-out', '3600:7140', '--json', 'c.json')
    outcome = fuzzycnc('compare', long, '--models', 'static_ridge', *options)
    figures = read_json('c.json')
    assert len(figures['held_out']) + len(figures['left_out']) == 2
    assert outcome.code == (1 if figures['left_out'] else 0)


@pytest.mark.slow
def test_many_runs_are_not_shown_one_by_one(fuzzycnc, bag):
    outcome = fuzzycnc('compare', bag('a'), bag('b', rows=100), '--models', 'static_ridge')
    assert outcome.code == 0, outcome
    assert 'a: residual' not in outcome.out
    assert 'Residual thermal error of 2 runs' in outcome.out


@pytest.fixture
def odd_bags(fuzzycnc, bag, table):
    """Return good bags, and bad ones of which each alone stops a training."""
    good = [bag('a'), bag('b', rows=100)]
    bad = []
    for name in ('loose', 'silent', 'renamed'):
        columns = warm_up()
        if name == 'loose':
            columns['t2'][60:] += 25.0
        elif name == 'silent':
            columns['t2'][30:80] = np.nan
        else:
            columns['t4'] = columns.pop('t2')
        outcome = fuzzycnc('import-csv', table('t.csv', columns), '--out', name, *IMPORT)
        assert outcome.code == 0, outcome
        bad.append(Path(name))
    shutil.copytree(good[0], 'copied')
    return good, [*bad, Path('copied'), Path('gone')]


REASONS = {
    'loose': '10 K per minute',
    'silent': '--drop-sensor t2',
    'renamed': 'expected sensor t1, t2, t3 as in run',
    'copied': "expected another recording than 'a'",
    'gone': 'nothing is there',
}


def test_a_training_leaves_out_what_cannot_be_used_if_asked_to(fuzzycnc, refused, here, odd_bags):
    good, bad = odd_bags
    options = ('--model', 'lag_ridge', '--models', 'lag_ridge', '--out')
    for item in bad:
        refused('train', good[0], item, good[1], *options, 'x.json', naming=[])
        assert not Path('x.json').exists()
    bags = good[0], *bad, good[1]
    outcome = fuzzycnc('train', *bags, *options, 'm.json', '--skip-bad', '--json', 'f.json')
    assert outcome.code == 0, outcome
    left_out = read_json('f.json')['left_out']
    assert set(left_out) == set(REASONS)
    for name, reason in REASONS.items():
        assert reason in left_out[name]
        assert f'left out {name}: {left_out[name]}' in outcome.out
    assert fuzzycnc('train', *good, *options, 'n.json').code == 0
    assert Path('m.json').read_text() == Path('n.json').read_text()
    refused('train', *bad[-1:], *options, 'x.json', '--skip-bad', naming=['gone'])


def test_other_commands_leave_the_same_out(fuzzycnc, refused, here, odd_bags):
    good, bad = odd_bags
    naming = [REASONS['copied']]
    refused('curve', *good, Path('copied'), '--counts', '1', naming=naming)
    options = ('--counts', '1', '--skip-bad', '--json', 'c.json')
    outcome = fuzzycnc('curve', *good, *bad, *options)
    assert outcome.code == 0, outcome
    assert set(read_json('c.json')['left_out_bags']) == set(REASONS)
    outcome = fuzzycnc('compare', *good, *bad, '--models', 'static_ridge', '--json', 'c.json')
    assert outcome.code == 1, outcome
    figures = read_json('c.json')
    assert set(figures['left_out']) == set(REASONS)
    assert list(figures['held_out']) == ['a', 'b']
