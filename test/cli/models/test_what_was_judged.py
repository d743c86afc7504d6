# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Windows, training rows and losses: commands say what was judged, and when no model is best."""

from pathlib import Path

import numpy as np
import pytest
from command_lines import read_json
from small_recordings import IMPORT, warm_up
from tiers import rest_slow

ROWS = 240


def said(outcome, start):
    """Return the one line that begins with a text."""
    (line,) = [line for line in outcome.out.splitlines() if line.startswith(start)]
    return line


@pytest.fixture
def lagging(fuzzycnc, table):
    """Return a bag whose displacement follows the temperatures with a lag, from a cold start."""

    def record(name='run', seed=0, change=None):
        columns = warm_up(ROWS)
        rng = np.random.default_rng(seed)
        rise = columns['t1'] - 20.0
        lagged = np.zeros(ROWS)
        for k in range(1, ROWS):
            lagged[k] = lagged[k - 1] + (1.0 - np.exp(-60.0 / 1200.0)) * (rise[k] - lagged[k - 1])
        columns['dz'] = 3.0 * lagged + 0.05 * rng.standard_normal(ROWS)
        if change is not None:
            change(columns, seed)
        file = table(f'{name}.csv', columns)
        outcome = fuzzycnc('import-csv', file, '--out', name, *IMPORT)
        assert outcome.code == 0, outcome
        return Path(name)

    return record


def unrelated(columns, seed):
    """Let the displacement wander, the other way in the next run, whatever the heat does."""
    noise = np.random.default_rng(seed).standard_normal(ROWS)
    columns['dz'] = (-1.0) ** seed * 10.0 * np.sin(np.arange(ROWS) / 17.0) + noise


@pytest.mark.parametrize(
    'words', [('m.json', '--model', 'run'), ('m.json', 'run'), ('run', 'm.json')]
)
def test_a_model_among_the_bags_is_named_with_the_line_to_type(refused, words):
    refused('evaluate', *words, naming=['m.json', '`fuzzycnc evaluate run --model m.json`'])


def test_a_folder_is_no_model(refused, tmp_path):
    (tmp_path / 'run').mkdir()
    naming = ['run: expected a model file', 'fuzzycnc train', 'found a folder']
    refused('evaluate', 'run', '--model', tmp_path / 'run', naming=naming)


# windows


@pytest.mark.parametrize('name', rest_slow(['lag_ridge', 'stable_grey'], 1))
def test_training_on_a_window_leaves_no_more_there_than_training_on_all(fuzzycnc, lagging, name):
    run, window = lagging(), ('--start', '4800')
    left = {}
    for file, options in (('all.json', ()), ('window.json', window)):
        trained = fuzzycnc('train', run, '--model', name, '--out', file, *options)
        assert trained.code == 0, trained
        judged = fuzzycnc('evaluate', run, '--model', file, *window, '--json', 'e.json')
        assert judged.code == 0, judged
        left[file] = read_json('e.json')['runs']['run']['default']['dz']['rms_um']
    assert left['window.json'] <= 1.05 * left['all.json']


@pytest.mark.usefixtures('here')
@pytest.mark.parametrize(
    ('command', 'options'),
    [('compare', ('--models', 'lag_ridge', '--jobs', '1')), ('curve', ('--counts', '1,2'))],
)
def test_what_is_held_out_of_a_window_lies_in_it(fuzzycnc, lagging, command, options):
    run = lagging()
    outcome = fuzzycnc(command, run, '--start', '4800', *options, '--json', 'c.json')
    assert outcome.code == 0, outcome
    held_out = ['run 9600-11478 s', 'run 11520-14340 s']
    assert list(read_json('c.json')['held_out']) == held_out


# training rows


def test_rows_that_were_trained_on_are_named_on_page_and_terminal(fuzzycnc, lagging):
    run = lagging()
    assert fuzzycnc('train', run, '--end', '7200', '--out', 'm.json').code == 0
    run.rename('copy')  # a name proves nothing
    options = ('--model', 'm.json', '--json', 'e.json', '--report', 'e.html')
    outcome = fuzzycnc('evaluate', 'copy', *options)
    assert outcome.code == bool(read_json('e.json')['false_band']), outcome
    words = 'about 50 % of the judged samples of copy were trained on (run): this is no test'
    assert said(outcome, 'about ') == words
    page = Path('e.html').read_text()
    assert words in page
    assert 'no model was trained on' not in page
    judged = read_json('e.json')['judged']['copy']
    assert judged['trained_on'] == pytest.approx({'run': 0.5}, abs=0.03)


def test_what_no_model_was_trained_on_is_said_with_its_window(fuzzycnc, lagging):
    run = lagging()
    assert fuzzycnc('train', run, '--end', '7200', '--out', 'm.json').code == 0
    options = ('--start', '9000', '--model', 'm.json', '--json', 'e.json', '--report', 'e.html')
    outcome = fuzzycnc('evaluate', run, *options)
    window = 'run: judged from 9000 to 14340 s, 90 samples; '
    none = 'run: no model was trained on these samples, but on others of a run of that name'
    assert said(outcome, 'run: judged').startswith(window)
    assert said(outcome, 'run: no model') == none
    page = Path('e.html').read_text()
    assert window in page
    assert none in page
    judged = read_json('e.json')['judged']['run']
    assert (judged['window_s'], judged['samples']) == ([9000.0, 14340.0], {'dz': 90})
    assert judged['trained_on'] == {}


def test_coverage_and_width_of_the_band_are_printed(fuzzycnc, lagging):
    assert fuzzycnc('train', lagging(), '--out', 'm.json').code == 0
    outcome = fuzzycnc(
        'evaluate', lagging('next', seed=1), '--model', 'm.json', '--json', 'e.json'
    )
    judged = read_json('e.json')['judged']['next']
    assert 0.0 <= judged['covered']['dz'] <= 1.0
    assert said(outcome, 'next: the band') == (
        'next: the band of two standard deviations holds '
        f'{100 * judged["covered"]["dz"]:.0f} % of dz (±{judged["half_width_um"]["dz"]:.1f} µm)'
    )


def grown(columns, seed):
    """Let the machine grow twice as far as it did in training."""
    columns['dz'] *= 2.0


def test_a_band_that_holds_far_less_than_it_promises_is_said_first_and_ends_with_1(
    fuzzycnc, lagging
):
    assert fuzzycnc('train', lagging(), '--out', 'm.json').code == 0
    options = ('--model', 'm.json', '--json', 'e.json')
    good = fuzzycnc('evaluate', lagging('good', 1), *options)
    assert good.code == 0, good
    assert read_json('e.json')['false_band'] == []
    outcome = fuzzycnc('evaluate', lagging('bad', 2, grown), *options, '--report', 'e.html')
    assert outcome.code == 1
    figures = read_json('e.json')
    assert figures['false_band'] == figures['judged']['bad']['false_band'] == ['dz']
    covered = figures['judged']['bad']['covered']['dz']
    assert covered < 0.9
    first = outcome.out.splitlines()[0]
    assert first.startswith(
        f'bad: the band of two standard deviations holds {100.0 * covered:.0f} % of dz'
    )
    assert 'it should cover 95 %, and chance does not explain so little of dz' in first
    assert outcome.out.count('it should cover 95 %') == 1
    judged = Path('e.html').read_text().split('<li')
    assert 'class="warning">bad: the band of two standard deviations holds' in judged[1]


def test_a_band_is_judged_over_all_runs_too(fuzzycnc, lagging):
    assert fuzzycnc('train', lagging(), '--out', 'm.json').code == 0
    bags = [lagging(f'bad{seed}', seed, grown) for seed in (1, 2)]
    outcome = fuzzycnc('evaluate', *bags, '--model', 'm.json', '--jobs', '1')
    assert outcome.code == 1
    (line,) = [line for line in outcome.out.splitlines() if line.startswith('over 2 runs')]
    assert line.startswith('over 2 runs the band holds')


def test_a_warm_start_is_told_in_one_line(fuzzycnc, lagging):
    def warm(columns, seed):
        columns['t2'] += 6.0

    assert fuzzycnc('train', lagging(), '--out', 'm.json').code == 0
    outcome = fuzzycnc(
        'evaluate', lagging('warm', 1, warm), '--model', 'm.json', '--json', 'e.json'
    )
    judged = read_json('e.json')['judged']['warm']
    line = said(outcome, 'warm: the machine was warm when the run began')
    assert f't2 {judged["warm_K"]["t2"]:+.1f} K; ' in line
    assert judged['in_domain'] == 0.0
    assert judged['warm_K']['t2'] == pytest.approx(6.0, abs=0.3)


# no compensation competes


def test_a_channel_that_no_model_improves_stays_uncompensated(fuzzycnc, lagging):
    run = lagging('noise', 2, unrelated)
    outcome = fuzzycnc('train', run, '--out', 'm.json', '--json', 't.json')
    assert outcome.code == 0, outcome
    assert said(outcome, 'in use: ') == 'in use: none'
    assert said(outcome, 'dz stays') == (
        'dz stays uncompensated, since no model was better beyond chance on held-out samples'
    )
    figures = read_json('t.json')
    assert (figures['uncompensated'], figures['worse_than_none']) == (['dz'], [])


def test_a_model_that_is_worse_than_none_is_called_so(fuzzycnc, lagging):
    run = lagging('noise', 2, unrelated)
    named = ('--model', 'least_squares', '--out', 'm.json', '--json', 't.json')
    outcome = fuzzycnc('train', run, *named)
    assert outcome.code == 0, outcome
    line = said(outcome, 'Static least squares is worse than no compensation on dz: ')
    for word in ('thermal_predictor refuses', 'force', '--force-model', '--model auto'):
        assert word in line
    assert read_json('t.json')['worse_than_none'] == ['dz']
    options = ('--model', 'm.json', '--json', 'e.json', '--report', 'e.html')
    judged = fuzzycnc('evaluate', lagging('other', 3, unrelated), *options)
    figures = read_json('e.json')
    assert judged.code == bool(figures['false_band']), judged
    assert figures['worse_than_none'] == figures['judged']['other']['worse_than_none'] == ['dz']
    rows = figures['runs']['other']
    words = (
        f'other: worse than no compensation on dz: {rows["default"]["dz"]["rms_um"]:.1f} µm '
        f'remain of {rows["uncompensated"]["dz"]["rms_um"]:.1f} µm'
    )
    assert said(judged, 'other: worse') == words
    assert f'! {rows["default"]["dz"]["rms_um"]:.1f}' in judged.out
    page = Path('e.html').read_text()
    assert f'<li class="warning">{words}</li>' in page
    assert 'class="key warning"' in page


@pytest.mark.slow
def test_the_best_candidate_may_be_none(fuzzycnc, lagging):
    runs = [lagging(name, seed, unrelated) for seed, name in enumerate('ab', start=4)]
    options = ('--models', 'least_squares,static_ridge', '--jobs', '1', '--json', 'c.json')
    outcome = fuzzycnc('compare', *runs, *options, '--report', 'c.html')
    assert outcome.code == 0, outcome
    assert said(outcome, 'best candidate: ') == 'best candidate: none'
    figures = read_json('c.json')
    assert figures['best'] == {'dz': 'uncompensated'}
    assert figures['worse_than_none'] == []
    assert 'trusted on every run, best candidate: none.' in Path('c.html').read_text()
