# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc soft`: demo, train and learn, and what they refuse."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from foam_bags import Run, sample_run, write_bag

from fuzzycnc_ros.cli.soft.command import COMMANDS
from fuzzycnc_ros.core.deformation.model import read_model, write_model
from fuzzycnc_ros.core.deformation.offset_file import read_offsets
from fuzzycnc_ros.core.deformation.regression import no_correction
from fuzzycnc_ros.runtime.enums import PrimitiveKind
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack
from fuzzycnc_ros.studies.soft.foam_records import COLUMNS, array_samples
from fuzzycnc_ros.studies.soft.foam_training import _chosen, train_model

TRACK = FoamTrack.parallelogram(np.radians(45.0))


def write_samples(path, x, s, sheets=None):
    header = [*COLUMNS, *([] if sheets is None else ['sheet'])]
    lines = [','.join(header)]
    for number, row in enumerate(np.column_stack([x, s])):
        cells = [f'{value:.6g}' for value in row]
        lines.append(','.join([*cells, *([] if sheets is None else [sheets[number]])]))
    path.write_text('\n'.join(lines) + '\n')


@pytest.fixture(scope='module')
def samples():
    return foam_samples(1)


@pytest.fixture
def model(fuzzycnc, tmp_path, samples):
    from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork

    text = write_model(TSFuzzyNetwork(ridge=0.03).fit(*samples).model_)
    (tmp_path / 'model.json').write_text(text)
    return read_model(text)


@pytest.mark.parametrize('name', COMMANDS)
def test_every_manual_has_an_example_on_a_line_of_its_own(fuzzycnc, name):
    outcome = fuzzycnc('soft', name, '--help')
    assert outcome.code == 0
    lines = [line.strip() for line in outcome.out.splitlines()]
    assert any(line.startswith(f'fuzzycnc soft {name}') for line in lines)


@pytest.mark.slow
def test_demo(fuzzycnc, tmp_path):
    outcome = fuzzycnc('soft', 'demo', '--runs', '2', '--json', 'out.json', '--report', 'p.html')
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    assert document['runs'] == 2
    assert len(document['tracks']) == 5
    for track in document['tracks']:
        none, after = track['methods']['none'], track['methods']['nts']
        assert after['angle_error'] <= 0.25 * none['angle_error']
        assert after['straightness'] <= 0.65 * none['straightness']
        assert after['max_deviation'] <= 0.4 * none['max_deviation']
        ramp = track['methods']['published']
        assert ramp['angle_error'] < none['angle_error']
        assert ramp['max_deviation'] > 0.85 * none['max_deviation']
        assert none['commanded'] == track['nominal']
        assert len(track['learning']['none']) == 4
        assert track['learning']['none'][3]['angle_error'] <= 0.2 * none['angle_error']
    assert (
        f'{np.degrees(document["tracks"][0]["methods"]["nts"]["angle_error"]):.2f}' in outcome.out
    )
    assert '5.09' in outcome.out
    assert (tmp_path / 'p.html').read_text().count('<figure ') == 3


@pytest.mark.slow
def test_train_on_a_table(fuzzycnc, tmp_path, samples):
    keep = (samples.x[:, 4] > 5.0) & (samples.x[:, 4] < 25.0)
    write_samples(tmp_path / 's.csv', samples.x[keep], samples.s[keep])
    outcome = fuzzycnc(
        'soft', 'train', 's.csv', '--out', 'm.json', '--json', 'out.json', '--report', 'p.html'
    )
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    rms = {name: item['rms'] for name, item in document['errors'].items()}
    assert document['method'] == 'gaussian_process'
    used = rms['Gaussian process']
    assert used <= 0.02 * 0.4
    assert used < 0.75 * rms['plain ridge regression']
    assert set(rms) == {
        'no correction', 'ridge regression', 'Gaussian process', 'hidden layer (NTS)',
        'linear rules (STS)', 'plain ridge regression', 'MLP, 32 and 32 nodes',
        'gradient boosting',
    }  # fmt: skip
    by_thickness = document['errors']['gradient boosting']['by_thickness']
    assert [float(key) for key in by_thickness] == pytest.approx([0.015, 0.02])
    assert sum(item['lines'] + item['arcs'] for item in document['coverage']) == keep.sum()
    assert f'{50.0 * used:.3f}' in outcome.out
    model = read_model((tmp_path / 'm.json').read_text())
    assert np.sqrt(np.mean((model.predict(samples.x[keep]) - samples.s[keep]) ** 2)) < 0.3
    assert not model.accepts(samples.x[~keep]).any()
    assert '<figure ' in (tmp_path / 'p.html').read_text()


@pytest.mark.slow
def test_samples_of_one_sheet_stay_together(fuzzycnc, tmp_path, samples):
    x, s = samples.x[:106:2], samples.s[:106:2]
    write_samples(tmp_path / 's.csv', x, s, [f's{number % 7}' for number in range(len(x))])
    options = ('--out', 'm.json', '--no-baselines', '--consequent', 'sts', '--json', 'out.json')
    outcome = fuzzycnc('soft', 'train', 's.csv', *options)
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    assert document['groups'] == 7
    assert '53 samples in 7 groups of one sheet' in outcome.out
    assert list(document['errors']) == [
        'no correction', 'ridge regression', 'Gaussian process', 'linear rules (STS)',
        'hidden layer (NTS)',
    ]  # fmt: skip
    assert read_model((tmp_path / 'm.json').read_text()).network.inner is None


def test_train_on_bags_is_as_on_the_samples_in_them(fuzzycnc, tmp_path, samples):
    lines = samples.x[samples.x[:, 2] == 2.0][53::3]
    write_bag(tmp_path / 'a', *(sample_run(row, n) for n, row in enumerate(lines[:20])))
    write_bag(
        tmp_path / 'b', *(sample_run(row, n) for n, row in enumerate(lines[20:])), Run(cut=9)
    )
    options = ('--out', 'm.json', '--no-baselines', '--method', 'network', '--json', 'out.json')
    outcome = fuzzycnc('soft', 'train', 'a', 'b', *options)
    assert outcome.code == 0, outcome.err
    assert f'{len(lines)} samples from fresh starts, 0 by the fading' in outcome.out
    assert 'left out: 1 paths that were not stitched to their end' in outcome.out
    assert 'kind is constant and was left out' in outcome.out
    document = json.loads((tmp_path / 'out.json').read_text())
    assert document['method'] == 'network'
    assert document['errors']['hidden layer (NTS)']['rms'] <= 0.02 * 0.3


def test_adapt_brings_a_model_to_another_friction(fuzzycnc, tmp_path, model):
    write_bag(tmp_path / 'monday', Run(friction=0.35 * 1.3, seed=3))
    outcome = fuzzycnc(
        'soft', 'train', 'monday', '--adapt', 'model.json', '--out', 'm.json', '--json', 'out.json'
    )
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    assert document['samples'] == 4
    assert document['rms'] < 0.7 * document['rms_before']
    adapted = read_model((tmp_path / 'm.json').read_text())
    assert adapted.gain.value.tolist() == document['gain']
    assert (model.gain.value == 1.0).all()
    write_bag(tmp_path / 'tuesday', Run(friction=0.35 * 5.0, seed=3))
    outcome = fuzzycnc('soft', 'train', 'tuesday', '--adapt', 'model.json', '--out', 'n.json')
    assert outcome.code == 0, outcome.err
    assert 'gain of X: 1.000 -> 2.000, at its limit: train the model anew' in outcome.out


def test_learn_straightens_a_track_in_three_cycles(fuzzycnc, tmp_path):
    offset, errors = None, []
    for cycle in range(4):
        stitched = FoamSheet(15e-3, (0.15, 0.1)).stitch(
            TRACK.points + (0.0 if offset is None else offset), 6e-3
        )
        errors.append(np.degrees(TRACK.measure(stitched).angle_error))
        write_bag(tmp_path / f'run{cycle}', Run(offset=offset, seed=cycle))
        outcome = fuzzycnc(
            'soft', 'learn', f'run{cycle}', '--out', 'offsets.json', '--force', '--json', 'o.json'
        )
        assert outcome.code == 0, outcome.err
        found = read_offsets((tmp_path / 'offsets.json').read_text())
        assert (found.path_id, found.material) == ('track', 'foam')
        np.testing.assert_array_equal(found.nominal, TRACK.points)
        offset = found.offset
    assert errors[0] > 5.0
    assert errors[3] <= 0.5
    document = json.loads((tmp_path / 'o.json').read_text())
    assert document['runs'] == 1
    assert document['max_deviation'] < 1e-3


def test_learn_takes_the_stitches_of_a_bag_and_no_jumps(fuzzycnc, tmp_path):
    """A track, a jump to its start, and the track again with a stop at its end."""
    once = Run().nominal
    nominal = np.concatenate([once, once, once[-1:]])
    kind = np.zeros(len(nominal) - 1, np.uint8)
    kind[[len(once) - 1, -1]] = PrimitiveKind.JUMP, PrimitiveKind.STOP
    sides = np.cumsum(kind != 0)
    write_bag(tmp_path / 'bag', Run(nominal=nominal, primitive=sides, kind=kind))
    fuzzycnc('soft', 'learn', tmp_path / 'bag', '--out', tmp_path / 'offsets.json')
    learnt = read_offsets((tmp_path / 'offsets.json').read_text())
    np.testing.assert_allclose(learnt.nominal, nominal[:-1], atol=1e-12)
    half = len(once)
    np.testing.assert_allclose(learnt.offset[half:], learnt.offset[:half], atol=1e-4)
    assert np.abs(learnt.offset[half + 1 : half + 20]).max() > 1e-3


def test_learn_takes_the_mean_of_the_runs_of_a_cycle(fuzzycnc, tmp_path):
    write_bag(tmp_path / 'a', Run(seed=1), Run(seed=2))
    write_bag(tmp_path / 'b', Run(seed=3), Run(path_id='other'))
    outcome = fuzzycnc(
        'soft', 'learn', 'a', 'b', '--path', 'track', '--gain', '1', '--out', 'o.json'
    )
    assert outcome.code == 0, outcome.err
    assert '3 runs of 81 points' in outcome.out
    stitched = [
        FoamSheet(15e-3, (0.15, 0.1)).stitch(TRACK.points, 6e-3, rng=np.random.default_rng(seed))
        for seed in (1, 2, 3)
    ]
    found = read_offsets((tmp_path / 'o.json').read_text())
    mean = TRACK.points - np.mean(stitched, axis=0)
    true = TRACK.points - FoamSheet(15e-3, (0.15, 0.1)).stitch(TRACK.points, 6e-3)
    # smoothed over neighbours, it is nearer to the truth than the mean is
    assert 0.0 < np.abs(found.offset - mean).max() < 1e-4
    assert np.mean((found.offset - true) ** 2) < 0.8 * np.mean((mean - true) ** 2)


def write_stitches(path, nominal, stitched):
    rows = np.hstack([1e3 * nominal, 1e3 * stitched]).round(4).tolist()
    lines = ['x_mm,y_mm,stitched_x_mm,stitched_y_mm', *(','.join(map(str, row)) for row in rows)]
    path.write_text('\n'.join(lines) + '\n')


OF_CIRCLE = ('--path', 'circle', '--material', 'foam', '--thickness', '15mm')


def test_a_sheet_that_does_not_give_way_gets_no_correction(fuzzycnc, tmp_path):
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    circle = 0.075 + 0.025 * np.column_stack([np.cos(angle), np.sin(angle)])
    noise = np.random.default_rng(0).normal(0.0, 1e-4, circle.shape)
    write_stitches(tmp_path / 'run.csv', circle, circle + noise)
    outcome = fuzzycnc('soft', 'learn', 'run.csv', *OF_CIRCLE, '--out', 'o.json')
    assert outcome.code == 0, outcome.err
    assert 'no correction: held-out stitches show no deformation' in outcome.out
    assert not read_offsets((tmp_path / 'o.json').read_text()).offset.any()


def test_a_run_given_twice_is_no_proof_that_its_noise_repeats(refused, tmp_path):
    noise = np.random.default_rng(0).normal(0.0, 1e-4, TRACK.points.shape)
    for name in ('run.csv', 'copy.csv'):
        write_stitches(tmp_path / name, TRACK.points, TRACK.points + noise)
    naming = ['copy.csv', 'another run than run.csv']
    refused('soft', 'learn', 'run.csv', 'copy.csv', *OF_CIRCLE, '--out', 'o.json', naming=naming)
    assert not (tmp_path / 'o.json').exists()


def test_stitches_far_off_their_neighbours_are_named_and_left_out(fuzzycnc, tmp_path):
    sheet = FoamSheet(15e-3, (0.15, 0.1))
    stitched = sheet.stitch(TRACK.points, 6e-3)
    true = TRACK.points - stitched
    stitched[[11, 40, 70]] += [[2e-3, 0.0], [0.0, -3e-3], [4e-3, 4e-3]]
    write_stitches(tmp_path / 'run.csv', TRACK.points, stitched)
    outcome = fuzzycnc(
        'soft', 'learn', 'run.csv', *OF_TABLE, '--gain', '1', '--out', 'o.json', '--json', 'j.json'
    )
    assert outcome.code == 0, outcome.err
    named = [f'run.csv: stitch {number}' for number in (12, 41, 71)]
    assert ', '.join(named) in ' '.join(outcome.out.split())
    assert json.loads((tmp_path / 'j.json').read_text())['outliers'] == named
    found = read_offsets((tmp_path / 'o.json').read_text())
    assert np.abs(found.offset - true).max() < 5e-5


def test_noise_trains_no_model(fuzzycnc, tmp_path, samples):
    x = samples.x[::4]
    write_samples(tmp_path / 's.csv', x, np.random.default_rng(0).normal(0.0, 1.0, (len(x), 2)))
    options = ('--out', 'm.json', '--no-baselines', '--json', 'out.json')
    outcome = fuzzycnc('soft', 'train', 's.csv', *options)
    assert outcome.code == 0, outcome.err
    assert json.loads((tmp_path / 'out.json').read_text())['method'] == 'none'
    assert 'no correction: held-out samples show no deformation' in outcome.out
    model = read_model((tmp_path / 'm.json').read_text())
    assert not model.corrects
    assert not model.predict(samples.x).any()


def test_samples_that_contradict_the_others_are_named(fuzzycnc, tmp_path, samples):
    x, s = samples.x[::4], samples.s[::4].copy()
    wrong = [30, 45, 60]
    s[wrong] += [[9.0, 0.0], [0.0, -9.0], [-7.0, 7.0]]
    write_samples(tmp_path / 's.csv', x, s)
    options = ('--out', 'm.json', '--no-baselines', '--json', 'out.json')
    outcome = fuzzycnc('soft', 'train', 's.csv', *options)
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    assert set(document['outliers']) >= {f'line {number + 2}' for number in wrong}
    assert len(document['outliers']) <= len(wrong) + 2
    assert f'left out: {len(document["outliers"])} of {len(x)} samples' in outcome.out


@pytest.mark.parametrize(
    ('runs', 'options', 'naming'),
    [
        ([Run(), Run(path_id='circle')], (), ['circle, track', 'choose one path']),
        ([Run()], ('--path', 'circle'), ['path: expected', "'circle'", 'track']),
        ([Run(), Run(name='felt')], (), ["'foam'", "'felt'", 'track at 21.000 s']),
        ([Run(), Run(thickness=20e-3)], (), ['offsets for a sheet of 15 mm, not of 20 mm']),
        ([Run(), Run(depth=5e-3)], (), ['feed depth of 6 mm, not of 5 mm']),
        ([Run(), Run(nominal=TRACK.points + 1e-4)], (), ['other points', 'um']),
        ([Run(), Run(offset=np.full((81, 2), 1e-3))], (), ['by up to 1.000 mm', 'last cycle']),
        ([Run(cut=1)], (), ['stitched to its end', 'paths that were not stitched to their end']),
        ([Run()], ('--gain', '0'), ['--gain', 'at most 1 but found 0']),
        ([Run()], ('--gain', '1.5'), ['--gain', '1.5']),
    ],
)
def test_learn_refuses_what_is_not_one_track(refused, tmp_path, runs, options, naming):
    write_bag(tmp_path / 'bag', *runs)
    refused('soft', 'learn', 'bag', '--out', 'o.json', *options, naming=naming)
    assert not (tmp_path / 'o.json').exists()


def write_run(path, run):
    """Write a run as a table: commanded places with their offsets, and stitches."""
    records = {name: record for name, record in run.records(0)}
    nominal, offset = (
        np.reshape(getattr(records['compensated_path'], name), (-1, 2))
        for name in ('nominal', 'offset')
    )
    stitched = np.reshape(records['stitched_path'].stitched, (-1, 2))
    header = 'x_mm,y_mm,offset_x_mm,offset_y_mm,flag,stitched_x_mm,stitched_y_mm'
    flag = np.zeros((len(nominal), 1))
    rows = 1e3 * np.hstack([nominal + offset, offset, flag, stitched])
    lines = [','.join(map(repr, row)) for row in rows.tolist()]
    path.write_text('\n'.join([header, *lines]) + '\n')


OF_TABLE = ('--path', 'track', '--material', 'foam', '--thickness', '15mm', '--size', '150x100mm')


def test_learn_from_tables_equals_that_from_a_bag(fuzzycnc, tmp_path):
    runs = [Run(seed=1, offset=np.full((81, 2), 2e-4)), Run(seed=2, offset=np.full((81, 2), 2e-4))]
    write_bag(tmp_path / 'bag', *runs)
    for number, run in enumerate(runs):
        write_run(tmp_path / f'{number}.csv', run)
    assert fuzzycnc('soft', 'learn', 'bag', '--out', 'bag.json').code == 0
    outcome = fuzzycnc('soft', 'learn', '0.csv', '1.csv', '--out', 'csv.json', *OF_TABLE)
    assert outcome.code == 0, outcome.err
    assert '2 runs of 81 points' in outcome.out
    one, other = (read_offsets((tmp_path / f'{name}.json').read_text()) for name in ('bag', 'csv'))
    assert (one.path_id, one.material) == (other.path_id, other.material)
    np.testing.assert_allclose(one.nominal, other.nominal, atol=1e-15)
    np.testing.assert_allclose(one.offset, other.offset, atol=1e-12)


@pytest.mark.parametrize(
    ('text', 'options', 'naming'),
    [
        ('1,1,1,1\n2,2,2,2', (), ['--path, --material, --thickness', '.csv']),
        ('1,1,1,1\n2,2,2,2', OF_TABLE[:4], ['--thickness', 'found none']),
        ('1,1,1,1\n2,2,2,2', (*OF_TABLE[:4], '--thickness', '15'), ['--thickness', '15mm']),
        ('1,1,1,1', OF_TABLE, ['two points', 'found 1']),
        ('', OF_TABLE, ['rows below the header']),
        ('1,1,1,1\n2,2,2,x', OF_TABLE, ['run.csv: line 3', 'finite numbers']),
        ('1,1,1,1\n2,2,2000,2', OF_TABLE, ['line 3', '50 mm', 'units and origin']),
        ('1;1;1;1', OF_TABLE, ['line 2', 'finite numbers']),
        ('1,1,1,nan', OF_TABLE, ['line 2', 'finite numbers', 'nan']),
        ('.001,.001,.001,.001\n.004,.001,.004,.001', OF_TABLE, ['0.003 mm apart', 'millimetres']),
    ],
)
def test_learn_refuses_tables_that_are_none(refused, tmp_path, text, options, naming):
    header = 'x_mm,y_mm,stitched_x_mm,stitched_y_mm'
    (tmp_path / 'run.csv').write_text(f'{header}\n{text}\n')
    refused('soft', 'learn', 'run.csv', '--out', 'o.json', *options, naming=naming)
    assert not (tmp_path / 'o.json').exists()


@pytest.mark.parametrize(
    ('header', 'naming'),
    [
        ('x_mm,y_mm,stitched_x_mm', ['line 1', 'found no stitched_y_mm']),
        ('x_mm;y_mm;stitched_x_mm;stitched_y_mm', ['line 1', 'parted by semicolons', 'commas']),
        ('x_mm,y_mm,stitched_x_mm,stitched_y_mm,offset_x_mm', ['both offset_x_mm and']),
        ('1,2,3,4', ['line 1', 'expected the columns x_mm']),
    ],
)
def test_learn_names_what_the_header_lacks(refused, tmp_path, header, naming):
    (tmp_path / 'run.csv').write_text(f'{header}\n1,1,1,1,0\n4,1,4,1,0\n')
    refused('soft', 'learn', 'run.csv', '--out', 'o.json', *OF_TABLE, naming=naming)


def test_learn_takes_bags_or_tables_and_what_belongs_to_them(refused, tmp_path):
    write_bag(tmp_path / 'bag', Run())
    write_run(tmp_path / 'run.csv', Run())
    wide = ('soft', 'learn', 'bag', '--out', 'o.json')
    refused('soft', 'learn', 'bag', 'run.csv', '--out', 'o.json', naming=['run.csv', 'found both'])
    refused(*wide, '--material', 'foam', naming=['--material', 'a bag holds it'])


@pytest.mark.parametrize(
    ('factors', 'naming'),
    [
        ({'thickness_mm': 1e-3}, ['thickness_mm', '0.005 to 0.035', 'look like metres']),
        ({'step_mm': 1e-3}, ['step_mm', 'look like metres', 'multiply by 1000']),
        ({'depth_mm': 1e-3, 'thickness_mm': 1e-3}, ['depth_mm', 'look like metres']),
        ({'depth_mm': 1e3, 'thickness_mm': 1e3}, ['depth_mm', 'look like micrometres']),
    ],
)
def test_lengths_in_other_units_are_suspected(refused, tmp_path, samples, factors, naming):
    x, s = samples
    scale = [factors.get(name, 1.0) for name in COLUMNS[:5]]
    write_samples(tmp_path / 's.csv', x * scale, s)
    refused('soft', 'train', 's.csv', '--out', 'm.json', naming=naming)


@pytest.mark.slow
@pytest.mark.parametrize('factor', [1e-3, 1e3])
def test_compensations_in_other_units_are_doubted(fuzzycnc, tmp_path, samples, factor):
    x, s = samples
    write_samples(tmp_path / 's.csv', x, s * factor)
    adapt = ('--consequent', 'sts', '--no-baselines')
    outcome = fuzzycnc('soft', 'train', 's.csv', '--out', 'm.json', *adapt)
    assert outcome.code == 0, outcome.err
    assert 'note: s_x_mm and s_y_mm are' in outcome.out
    assert 'if they are m' in outcome.out


@pytest.mark.parametrize('rows', [1, 2, 3, 5, 9])
def test_few_rows_give_one_sentence(refused, tmp_path, samples, rows):
    x, s = samples
    write_samples(tmp_path / 's.csv', x[:rows], s[:rows])
    naming = ['at least 10 that differ', f'found {rows}; record more']
    refused('soft', 'train', 's.csv', '--out', 'm.json', naming=naming)


def test_few_samples_are_judged_without_the_network(fuzzycnc, tmp_path, samples):
    x, s = samples
    write_samples(tmp_path / 's.csv', x[:14], s[:14])
    outcome = fuzzycnc('soft', 'train', 's.csv', '--out', 'm.json', '--json', 'o.json')
    assert outcome.code == 0, outcome.err
    assert 'no network: it takes 19 samples that differ' in outcome.out
    assert json.loads((tmp_path / 'o.json').read_text())['method'] in ('none', 'ridge')


def test_groups_that_leave_a_network_too_few_samples_cost_no_training(fuzzycnc, tmp_path):
    x, s = (part[:20] for part in foam_samples(2))
    write_samples(tmp_path / 's.csv', x, s, [f's{number // 3}' for number in range(20)])
    outcome = fuzzycnc('soft', 'train', 's.csv', '--out', 'm.json', '--json', 'o.json')
    assert outcome.code == 0, outcome.err
    assert 'no network: it takes 19 samples' in outcome.out
    assert 'found 20 in 7' in outcome.out
    assert json.loads((tmp_path / 'o.json').read_text())['method'] == 'ridge'


def test_a_network_is_trained_on_what_outliers_leave(samples):
    x, s = samples.x[:20], samples.s[:20].copy()
    s[[3, 11]] += [20.0, -15.0]
    found = train_model(array_samples(x, s), {'ridge': 0.03}, 'network')
    assert found.method == 'network'
    assert {'row 3', 'row 11'} <= set(found.outliers)
    assert found.judged.folds == found.judged.groups


def test_a_model_whose_large_errors_are_larger_is_not_chosen():
    s, groups = np.zeros((40, 2)), np.arange(40)
    near = np.repeat([[2.0, 0.0], [6.0, 0.0]], [30, 10], axis=0)
    for worst, best in ((1.0, 0), (-0.5, 1)):
        changed = near + np.repeat([[-1.0, 0.0], [worst, 0.0]], [30, 10], axis=0)
        rms = [float(np.sqrt((found**2).mean())) for found in (near, changed)]
        pairs = zip((near, changed), rms, strict=True)
        errors = [SimpleNamespace(predicted=p, rms=r) for p, r in pairs]
        assert _chosen(SimpleNamespace(errors=errors), s, groups, 2) == best


def test_enough_rows_in_too_few_groups_are_named(refused, tmp_path):
    x, s = foam_samples(2)
    write_samples(tmp_path / 's.csv', x[:30], s[:30], sheets=['a'] * 28 + ['b', 'c'])
    naming = ['30 samples in 3 groups', 'record more sheets']
    refused('soft', 'train', 's.csv', '--out', 'm.json', naming=naming)


@pytest.mark.parametrize(
    ('column', 'value', 'naming'),
    [
        ('depth_mm', '12.1', ['s.csv: line 3', 'at most 0.8', 'through the sheet']),
        ('depth_mm', '0', ['line 3', 'depth more than 0 mm']),
        ('type', '3', ['line 3', '1 (arc) or 2 (line)', 'found 3']),
        ('step_mm', '-3', ['line 3', 'step more than 0 mm']),
        ('thickness_mm', '0', ['line 3', 'thickness more than 0 mm']),
        ('s_x_mm', 'nan', ['line 3', 'finite numbers', 'nan']),
        ('s_y_mm', '', ['line 3', 'finite numbers']),
        ('s_y_mm', '9' * 200_000, ['s.csv: expected a CSV file as text', 'field']),
    ],
)
def test_train_refuses_bad_rows(refused, tmp_path, column, value, naming):
    row = dict(zip(COLUMNS, ('45', '6', '2', '3', '15', '2.5', '1.9'), strict=True))
    lines = [','.join(COLUMNS), ','.join(row.values()), ','.join((row | {column: value}).values())]
    (tmp_path / 's.csv').write_text('\n'.join(lines) + '\n')
    refused('soft', 'train', 's.csv', '--out', 'm.json', naming=naming)
    assert not (tmp_path / 'm.json').exists()


@pytest.mark.parametrize(
    ('arguments', 'naming'),
    [
        (('train', 'no.csv', '--out', 'm.json'), ['no.csv', 'nothing is there']),
        (('train', 'no', '--out', 'm.json'), ['no', 'nothing is there']),
        (('train', 'few.csv', '--out', 'm.json'), ['at least 10 that differ', 'found 1;']),
        (('train', 'few.csv', 'few.csv', '--out', 'm.json'), ['one .csv alone']),
        (('train', 'odd.csv', '--out', 'm.json'), ['odd.csv: line 1', 'depth_mm']),
        (('train', 'empty.csv', '--out', 'm.json'), ['rows below the header']),
        (('train', 'few.csv', '--out', 'odd.csv'), ['odd.csv', 'exists', '--force']),
        (('train', 'few.csv', '--out', 'm.json', '--consequent', 'x'), ['--consequent', "'x'"]),
        (('train', 'few.csv', '--out', 'm.json', '--features', 'x'), ['--features', 'physical']),
        (('train', 'few.csv', '--out', 'm.json', '--adapt', 'no.json'), ['no.json', 'model file']),
        (
            ('train', 'few.csv', '--out', 'm.json', '--adapt', 'few.csv'),
            ['few.csv: model file: expected JSON'],
        ),
        (
            ('train', 'few.csv', '--out', 'm.json', '--adapt', 'x', '--report', 'r.html'),
            ['--report', '--adapt'],
        ),
        (('train',), ['fuzzycnc soft train --help']),
        (('demo', '--runs', '0'), ['--runs', '1 or more']),
        (('demo', '--seed', '-1'), ['--seed', '0 or more']),
        (('learn', 'no', '--out', 'o.json'), ['no', 'nothing is there']),
        (('learn', 'few.csv', '--out', 'no/o.json'), ['no/o.json', 'folder']),
    ],
)
def test_bad_input_is_refused(refused, tmp_path, arguments, naming):
    (tmp_path / 'few.csv').write_text(','.join(COLUMNS) + '\n' + '45,6,2,3,15,2.5,1.9\n' * 3)
    (tmp_path / 'odd.csv').write_text('direction_deg,type\n45,2\n')
    (tmp_path / 'empty.csv').write_text(','.join(COLUMNS) + '\n')
    refused('soft', *arguments, naming=naming)
    assert not (tmp_path / 'm.json').exists()


def test_adapt_refuses_samples_that_the_model_is_not_for(refused, tmp_path, model):
    write_samples(tmp_path / 's.csv', [[80.0, 6.0, 2.0, 3.0, 15.0]], [[1.0, 2.0]])
    refused(
        'soft', 'train', 's.csv', '--adapt', 'model.json', '--out', 'm.json',
        naming=['model.json', 'found none among 1'],
    )  # fmt: skip


def test_adapt_refuses_a_model_that_holds_no_correction(refused, tmp_path, samples):
    (tmp_path / 'model.json').write_text(write_model(no_correction(*samples)))
    write_samples(tmp_path / 's.csv', *samples)
    options = ('s.csv', '--adapt', 'model.json', '--out', 'm.json')
    refused('soft', 'train', *options, naming=['model.json', 'no correction', 'train it anew'])
    assert not (tmp_path / 'm.json').exists()


def test_a_track_beside_the_sheet_is_not_learnt(refused, tmp_path):
    write_run(tmp_path / 'run.csv', Run())
    naming = ['run.csv', 'clamped area of 20 x 20 mm', 'at index 0']
    options = ('--out', 'o.json', *OF_TABLE[:-1], '20x20mm')
    refused('soft', 'learn', 'run.csv', *options, naming=naming)
    assert not (tmp_path / 'o.json').exists()
