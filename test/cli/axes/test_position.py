# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc position`: figures, page, refusals."""

import json

import pytest


def figures(fuzzycnc, tmp_path, *arguments):
    outcome = fuzzycnc('position', *arguments, '--json', 'out.json')
    assert outcome.code == 0, outcome.err
    return json.loads((tmp_path / 'out.json').read_text()), outcome.out


@pytest.mark.parametrize('controller', ['variable_universe', 'cascade', 'pid'])
def test_a_heavy_load_is_no_runaway(fuzzycnc, tmp_path, controller):
    move = ('--to', '50mm', '--load', '40%', '--controller', controller)
    found, _ = figures(fuzzycnc, tmp_path, *move)
    assert found['fault'] == ''


def test_the_published_move(fuzzycnc, tmp_path):
    found, out = figures(fuzzycnc, tmp_path, '--axis', 'lathe', '--to', '-50mm')
    assert found['target'] == -0.05
    assert 0.4 < found['settle'] < 0.6
    assert found['overshoot'] < 1e-6
    assert found['steady_error'] < 1e-6
    assert f'{found["settle"]:.3f}' in out
    assert 'variable, observer (default)' in out


def test_units_and_signs_mean_the_same_way(fuzzycnc, tmp_path):
    found = [
        figures(fuzzycnc, tmp_path, '--to', to, '--duration', time)[0]
        for to, time in (('-2mm', '0.5s'), ('-2000 um', '500ms'))
    ]
    assert found[0] == found[1]


def test_what_is_set_of_the_axis_counts(fuzzycnc, tmp_path):
    move = ('--to', '3mm', '--duration', '1s')
    plain, _ = figures(fuzzycnc, tmp_path, *move)
    slow, _ = figures(fuzzycnc, tmp_path, *move, '--gain', '0.5')
    assert slow['settle'] != plain['settle']
    assert slow['settings']['gain_factor'] == 0.5
    off, _ = figures(fuzzycnc, tmp_path, *move, '--sensor', 'encoder')
    assert off['steady_error'] > 2e-6
    hard, _ = figures(fuzzycnc, tmp_path, *move, '--friction', '2', '--breakaway', '1.8')
    assert hard['settings']['breakaway'] == pytest.approx(0.072)
    pushed, out = figures(fuzzycnc, tmp_path, *move, '--load=-10%', '--load-at', '0.97s')
    assert pushed['settle'] is None
    assert 'not settled: ' in out


def test_without_model_the_published_controller_sticks(fuzzycnc, tmp_path):
    found, out = figures(
        fuzzycnc, tmp_path, '--to', '-50mm', '--controller', 'variable_universe_static'
    )
    assert found['settle'] is None
    assert found['steady_error'] == pytest.approx(156e-6, rel=0.02)
    assert 'published, floors raised' in out


def test_profile_and_page(fuzzycnc, tmp_path):
    found, _ = figures(fuzzycnc, tmp_path, '--to', '50mm', '--profile', '--report', 'page.html')
    assert 0.43 < found['settle'] < 0.7
    page = (tmp_path / 'page.html').read_text()
    assert 'class="chart"' in page
    assert 'jerk-limited profile' in page


def test_ballscrew_goes_by_profile(fuzzycnc, tmp_path):
    ball = ('--axis', 'ballscrew', '--to', '50mm')
    tuned, _ = figures(fuzzycnc, tmp_path, *ball)  # what won on it, a PID
    assert tuned['overshoot'] < 1e-5
    assert tuned['settle'] < 0.6
    ruled = (*ball, '--controller', 'variable_universe')
    found, _ = figures(fuzzycnc, tmp_path, *ruled)
    assert found['overshoot'] < 1e-6
    assert found['steady_error'] < 1e-6
    assert found['settle'] < 0.5  # the profile takes 0.43 s: it does not stick at its end
    step, _ = figures(fuzzycnc, tmp_path, *ruled, '--step')
    assert step['overshoot'] > 1e-3  # the drive cannot brake that fast
    free, _ = figures(fuzzycnc, tmp_path, *ruled, '--friction', '0')
    assert free['overshoot'] < 1e-6
    assert free['settle'] != found['settle']


def test_settings_of_a_file(fuzzycnc, tmp_path):
    (tmp_path / 'soft.yaml').write_text('settings: {output_gain: 1.2, rate_range: 0.6}\n')
    plain, _ = figures(fuzzycnc, tmp_path, '--to', '5mm')
    soft, _ = figures(fuzzycnc, tmp_path, '--to', '5mm', '--params', 'soft.yaml')
    assert soft['settle'] != plain['settle']
    assert soft['overshoot'] < 1e-6


@pytest.mark.parametrize(
    ('arguments', 'naming'),
    [
        (('--to', '50'), ['--to', 'expected a unit', "'50'"]),
        (('--to', '-50'), ['--to', 'expected a unit', "'-50'"]),
        (('--to', 'far'), ['--to', "'far'", 'mm']),
        (('--to', 'nanmm'), ['--to', "'nanmm'"]),
        (('--to', '300mm'), ['--to', '250 mm', 'travel', "'300mm'"]),
        (('--to', '0mm'), ['--to', '1 µm']),
        (('--to', '5mm', '--axis', 'mill'), ['--axis', 'lathe, ballscrew', "'mill'"]),
        (
            ('--to', '5mm', '--controller', 'magic'),
            ['--controller', 'variable_universe', "'magic'"],
        ),
        (
            ('--to', '5mm', '--axis', 'ballscrew', '--controller', 'cascade'),
            ['--controller', 'variable_universe or pid', 'ballscrew', 'cascade'],
        ),
        (('--to', '5mm', '--gain', '0'), ['--gain', '0.01 to 100', '0']),
        (('--to', '5mm', '--gain', 'nan'), ['--gain', 'nan']),
        (('--to', '5mm', '--friction', '-1'), ['--friction', '0 or more', '-1']),
        (('--to', '5mm', '--friction', '60'), ['--friction', 'coulomb', '1.2']),
        (('--to', '5mm', '--breakaway', '0.5'), ['--breakaway', '1 or more']),
        (('--to', '5mm', '--load', '10'), ['--load', 'expected %', "'10'"]),
        (('--to', '5mm', '--load', '-200%'), ['--load', '100%', "'-200%'"]),
        (('--to', '5mm', '--load-at', '2'), ['--load-at', 's, ms', "'2'"]),
        (('--to', '5mm', '--noise', '0.1'), ['--noise', 'expected a unit']),
        (('--to', '5mm', '--noise', '10mm'), ['--noise', '0.01', '0.001']),
        (('--to', '5mm', '--sensor', 'eye'), ['--sensor', 'grating', "'eye'"]),
        (('--to', '5mm', '--duration', '3'), ['--duration', 's, ms']),
        (('--to', '5mm', '--duration', '1000s'), ['--duration', '120 s', "'1000s'"]),
        (('--to', '5mm', '--seed', '-1'), ['--seed', '0 or more']),
        (('--to', '5mm', '--params', 'none.yaml'), ['none.yaml', 'nothing is there']),
        (('--to', '5mm', '--json', 'no/out.json'), ['no/out.json', 'folder']),
        (('--to', '5mm', '--report', 'no/page.html'), ['no/page.html', 'folder']),
        (('--to', '5ell'), ['--to', "'5ell'", 'mm']),
        (('--to', '-251mm', '--axis', 'ballscrew'), ['--to', '250 mm', 'travel', "'-251mm'"]),
        ((), ['--to', 'fuzzycnc position --help']),
    ],
)
def test_wrong_calls_are_refused_and_write_nothing(refused, tmp_path, arguments, naming):
    refused('position', *arguments, naming=naming)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ('content', 'naming'),
    [
        ('', ["'settings' or 'rules'"]),
        ('[1, 2]', ["'settings' or 'rules'"]),
        ('settings: {output_gian: 2}', ['output_gian', 'did you mean output_gain?']),
        ('settings: {output_gain: much}', ['output_gain', "'much'"]),
        ('settings: {output_gain: -1}', ['output_gain', 'positive', '-1']),
        ('settings: 3', ['settings', 'names and values', '3']),
        ('settings: {error_floor: 0.005}', ['expected settings with which the axis settles']),
        ('rules: {centres: [-1, 1], values: [[1, 2]]}', ['rules', '2 rows']),
        ('rules: {values: [[1, 2]]}', ['rules', 'centres']),
        ('axis: ballscrew\nsettings: {output_gain: 2}', ['lathe axis', 'ballscrew axis']),
        ('settings: {output_gain: 2', ['YAML']),
        ('settings: {output_gain: .nan}', ['output_gain', 'positive', 'nan']),
        ('rules: {centres: [-1, 0, 1], values: [[1, 1], [0, 0], [-1, -1]]}', ['rules', '3 rows']),
    ],
)
def test_wrong_settings_are_refused(refused, tmp_path, content, naming):
    (tmp_path / 'wrong.yaml').write_text(content)
    refused('position', '--to', '5mm', '--params', 'wrong.yaml', naming=['wrong.yaml', *naming])


def test_settings_are_for_some_controllers_alone(refused, tmp_path):
    (tmp_path / 's.yaml').write_text('settings: {output_gain: 2.5}\n')
    refused(
        'position', '--to', '5mm', '--params', 's.yaml', '--controller', 'pid',
        naming=['--params', 'variable_universe', 'pid'],
    )  # fmt: skip
    (tmp_path / 's.yaml').write_text('settings: {disturbance: 1e-3}\n')
    refused(
        'position', '--to', '5mm', '--params', 's.yaml',
        '--controller', 'variable_universe_model_free',
        naming=['s.yaml', 'disturbance', 'observer'],
    )  # fmt: skip


def test_a_controller_that_gave_up_is_code_1(fuzzycnc, tmp_path):
    # readings off by whole millimetres of noise are jumps
    outcome = fuzzycnc('position', '--to', '5mm', '--noise', '1mm', '--json', 'out.json')
    assert outcome.code == 1
    assert 'fault: ' in outcome.out
    assert json.loads((tmp_path / 'out.json').read_text())['fault'] in outcome.out
