# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded runs as they are on a shop floor: readings that are missing, probes taken in turn."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benches.predictor_bench import bench_with_model, errors_of, predict, recordings, trained
from command_lines import read_json
from small_recordings import IMPORT, warm_up

from fuzzycnc_ros.bags.finding import NamedBag
from fuzzycnc_ros.cli.models.evaluate import judge_bag
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.core.thermal.run import ThermalDataError
from fuzzycnc_ros.studies.thermal.missing_readings import LINE, MATES, as_predicted

QUICK = ('--models', 'static_ridge,lag_ridge')


@pytest.fixture
def recorded(fuzzycnc, tmp_path):
    """Return a bag of the small recording with some cells, rows by column, left empty."""

    def imported(name, lost, options=IMPORT, **warming):
        columns = warm_up(**warming)
        lines = [','.join(columns)]
        for row, values in enumerate(zip(*columns.values(), strict=True)):
            cells = (
                '' if row in lost.get(column, ()) else f'{value:.6f}'
                for column, value in zip(columns, values, strict=True)
            )
            lines.append(','.join(cells))
        file = tmp_path / f'{name}.csv'
        file.write_text('\n'.join(lines) + '\n')
        outcome = fuzzycnc('import-csv', file, '--out', name, *options)
        assert outcome.code == 0, outcome
        return Path(name)

    return imported


SHORT = {'t2': range(40, 44), 't1': (90,)}
LONG = {'t2': range(40, 70), 't3': range(60, 90)}
WORDS = 't1, t2 read nothing in 2 gaps, the longest of 4 min after 2340 s'


def gap_table(found, name='holed'):
    return [(gap['sensor'], gap['samples'], gap['start_s'], gap['by']) for gap in found[name]]


def test_short_gaps_are_bridged_and_said(fuzzycnc, here, recorded, bag):
    bags = recorded('holed', SHORT), bag('whole', rows=100)
    told = f'holed: {WORDS}; straight lines bridge them, as in the predictor\n'
    for command in (
        ('train', '--out', 'm.json', *QUICK),
        ('compare', *QUICK),
        ('curve', '--counts', '1,2'),
    ):
        outcome = fuzzycnc(*command, *bags, '--json', 'figures.json')
        assert outcome.code == 0, outcome
        assert outcome.out.count('read nothing') == 1
        assert told in outcome.out
        found = read_json('figures.json')['bridged']
        assert gap_table(found) == [('t1', 1, 5340.0, LINE), ('t2', 4, 2340.0, LINE)]
        assert found['whole'] == []


def test_a_model_of_a_gappy_run_is_that_of_the_whole_one_but_for_the_gap(fuzzycnc, recorded):
    found = {}
    for name, lost in (('holed', SHORT), ('whole', {})):
        out = f'{name}.json'
        outcome = fuzzycnc('train', recorded(name, lost), '--out', out, *QUICK)
        assert outcome.code == 0, outcome
        found[name] = load_model(Path(out)).candidates['lag_ridge'].held_out_rms[0]
    assert found['holed'] == pytest.approx(found['whole'], rel=0.1)


def remedies(line):
    """Return the options that a refusal offers, each as words of a command line."""
    drop, window = line.split('; leave ')[1].split(', or use the part with all readings')
    return drop.split(' out: ')[1].split(), window.split(': ')[1].split()


@pytest.mark.parametrize(
    'command',
    [
        ('train', '--out', 'm.json', *QUICK),
        ('compare', *QUICK),
        ('curve', '--counts', '1'),
    ],
)
def test_a_long_gap_is_named_and_each_remedy_ends_it(fuzzycnc, here, refused, recorded, command):
    bags = recorded('holed', LONG), recorded('other', {'t2': range(10, 35)}, rows=100)
    if command[0] == 'compare':
        bags = bags[:1]
    line = refused(
        *command, *bags,
        naming=['t2', "'holed'", 'from 2340 to 4200 s', 't3', 'from 3540 to 5400 s', '20 min'],
    )  # fmt: skip
    drop, window = remedies(line)
    assert drop == ['--drop-sensor', 't2,t3']
    assert window == ['--end', '2340' if len(bags) == 1 else '540']
    for options in (drop, window):
        outcome = fuzzycnc(*command, *bags, *options, '--json', 'figures.json')
        assert outcome.code == 0, outcome
        if command[0] == 'train':
            inputs = read_json('figures.json')['sensors']
            assert inputs == (['t1'] if options is drop else ['t1', 't2', 't3'])
            Path('m.json').unlink()


def test_rows_that_all_sensors_lack_leave_a_window_only(refused, fuzzycnc, recorded):
    lost = dict.fromkeys(('t1', 't2', 't3'), range(70, 100))
    line = refused(
        'train', recorded('holed', lost), '--out', 'm.json', naming=['t1', '4140', '--end 4140']
    )
    assert '--drop-sensor' not in line
    assert fuzzycnc('train', 'holed', '--out', 'm.json', '--end', '4140', *QUICK).code == 0


def test_a_bag_with_a_long_gap_leaves_the_others_to_compare(fuzzycnc, here, recorded, bag):
    bags = recorded('holed', LONG), bag('a'), bag('b', rows=100)
    outcome = fuzzycnc('compare', *bags, *QUICK, '--json', 'c.json')
    assert outcome.code == 1, outcome
    assert 'left out holed: runs: expected readings of every sensor' in outcome.out
    assert list(read_json('c.json')['held_out']) == ['a', 'b']


@pytest.mark.parametrize('command', [('train', '--out', 'm.json'), ('compare',), ('curve',)])
def test_a_dropped_sensor_must_be_there(refused, bag, command):
    refused(
        *command, bag('a'), '--drop-sensor', 't1,oil', '--drop-sensor', 'water',
        naming=['--drop-sensor', 't1, t2, t3', 'oil, water'],
    )  # fmt: skip
    refused(*command, 'a', '--drop-sensor', 't1,t2,t3', naming=['t1, t2, t3', 'left out'])
    refused(*command, 'gone', '--drop-sensor', 't1', naming=['gone', 'nothing is there'])


def test_a_sensor_that_one_run_lacks_can_be_dropped_from_the_others(fuzzycnc, recorded, bag):
    options = ('--time', 't', '--temperature', 't1,t3', '--displacement', 'dz=Z:um')
    bags = bag('a'), recorded('lacking', {}, options, rows=100)
    outcome = fuzzycnc('train', *bags, '--out', 'm.json', '--drop-sensor', 't2', *QUICK)
    assert outcome.code == 0, outcome
    assert load_model(Path('m.json')).inputs == ('t1', 't3')


def test_a_turned_run_and_a_single_value_are_named(fuzzycnc, here, table):
    bags = []
    for name, rows, sign in (('a', 120, 1.0), ('b', 100, -1.0), ('c', 110, 1.0)):
        columns = warm_up(rows)
        columns['dz'] = sign * columns['dz']
        if name == 'c':
            columns['t3'][50] += 7.0
        fuzzycnc('import-csv', table(f'{name}.csv', columns), '--out', name, *IMPORT)
        bags.append(name)
    for command in (('train', '--out', 'm.json'), ('compare',)):
        outcome = fuzzycnc(*command, *bags, *QUICK, '--json', 'figures.json')
        assert outcome.code == 0, outcome
        lone, turned = read_json('figures.json')['warnings']
        assert re.match(r'c: t3 is 29\.\d+ degC at 3000 s, alone between 22\.\d+ and 22\.', lone)
        assert re.match(
            r'b: dz moves against what the other runs predict \(correlation -[01]\.\d\d\); with '
            r'the other sign the temperatures explain (99|100) % of the motion of all runs, as '
            r'recorded [1-5]\d %; .* import b anew with the other sign of the axis',
            turned,
        )
        assert f'warning: {lone}\n' in outcome.out
        assert f'warning: {turned}\n' in outcome.out


def test_displacements_that_do_not_begin_at_zero_are_named(fuzzycnc, here, table):
    for name, rows, begin in (('a', 120, 0.0), ('b', 100, 9.0), ('c', 110, -7.0)):
        columns = warm_up(rows)
        columns['dz'] += begin
        outcome = fuzzycnc('import-csv', table(f'{name}.csv', columns), '--out', name, *IMPORT)
        said = "displacements begin at 'dz' at" in outcome.out
        assert said == (begin != 0.0), outcome
        assert ('import with --zero' in outcome.out) == said
    words = 'displacements do not begin at zero in b (dz at 9'
    for command in (('train', '--out', 'm.json', 'a', 'b', 'c'), ('compare', 'a', 'b', 'c')):
        outcome = fuzzycnc(*command, *QUICK, '--json', 'f.json')
        (line,) = (text for text in read_json('f.json')['warnings'] if words in text)
        assert ', c (dz at -' in line
        assert line.endswith('import anew with fuzzycnc import-csv --zero')
        assert f'warning: {line}\n' in outcome.out
    outcome = fuzzycnc('evaluate', 'a', 'b', '--model', 'm.json', '--json', 'e.json')
    (line,) = read_json('e.json')['warnings']
    assert words in line
    assert f'warning: {line}\n' in outcome.out
    options = (*IMPORT, '--zero')
    outcome = fuzzycnc('import-csv', 'c.csv', '--out', 'zeroed', *options)
    assert 'warning' not in outcome.out


# evaluate


def test_evaluate_needs_no_sensor_that_the_model_does_not_read(fuzzycnc, recorded, bag):
    options = ('--out', 'm.json', '--drop-sensor', 't2', *QUICK)
    assert fuzzycnc('train', bag('training'), *options).code == 0
    figures = []
    for name, lost in (('whole', {}), ('holed', {'t2': range(120)})):
        outcome = fuzzycnc('evaluate', recorded(name, lost), '--model', 'm.json', '--json', 'e')
        assert outcome.code == 0, outcome
        assert 'read nothing' not in outcome.out
        figures.append(read_json('e')['runs'][name])
    assert figures[0] == figures[1]


def test_evaluate_says_what_stands_in(fuzzycnc, recorded, model):
    run = recorded('holed', LONG)
    outcome = fuzzycnc('evaluate', run, '--model', model, '--json', 'e', '--report', 'e.html')
    assert outcome.code == 0, outcome
    assert (
        'holed: t2, t3 read nothing in 2 gaps, the longest of 30 min after 2340 s; '
        'other sensors stand in, as in the predictor\n'
    ) in outcome.out
    found = read_json('e')['bridged']
    assert gap_table(found) == [('t2', 30, 2340.0, MATES), ('t3', 30, 3540.0, MATES)]
    assert read_json('e')['runs']['holed']['default']['dz']['rms_um'] < 1.0


def test_samples_of_the_training_are_recognised_beside_their_gaps(fuzzycnc, recorded):
    path = recorded('holed', SHORT)
    assert fuzzycnc('train', path, '--out', 'm.json', *QUICK).code == 0
    options = {'start': None, 'end': None, 'probe_every': None, 'page': False}
    text = Path('m.json').read_text()
    bag = NamedBag(path, 'again')
    judged = judge_bag(bag, lambda *news: None, model_text=text, **options)
    assert len(judged.bridged) == 2
    assert judged.evaluation.trained_on == {'holed': 1.0}


def test_evaluate_refuses_what_the_predictor_could_not_read(fuzzycnc, refused, recorded, bag):
    options = ('--out', 'm.json', '--drop-sensor', 't2,t3', '--model', 'lag_ridge')
    assert fuzzycnc('train', bag('training'), *options).code == 0
    line = refused(
        'evaluate', recorded('holed', {'t1': range(40, 70)}), '--model', 'm.json',
        naming=["'holed'", 't1', 'from 2340 to 4200 s', 'a model that does without t1'],
    )  # fmt: skip
    end = line.split('--end ')[1].split(',')[0]
    assert fuzzycnc('evaluate', 'holed', '--model', 'm.json', '--end', end).code == 0


@pytest.mark.parametrize(
    'command',
    [
        ('train', '--out', 'm.json', *QUICK),
        ('compare', *QUICK),
        ('curve', '--counts', '1'),
    ],
)
def test_readings_every_few_minutes_are_taken_as_they_come(
    fuzzycnc, here, refused, recorded, command
):
    bags = [recorded(f'of{rows}', {}, rows=rows, interval=300.0) for rows in (80, 90)]
    line = refused(*command, *bags, '--interval', '60', naming=['every 60 s', 'one every 300 s'])
    remedy = line.split('train with an interval of 300 s: ')[1].split(';')[0].split()
    assert remedy == ['--interval', '300']
    for options in ((), remedy):
        outcome = fuzzycnc(*command, *bags, *options, '--json', 'figures.json')
        assert outcome.code == 0, outcome
        if command[0] == 'train':
            assert 'a sample every 300 s' in outcome.out
            judged = fuzzycnc('evaluate', 'of80', '--model', 'm.json')
            assert 'of80: judged from' in judged.out
            Path('m.json').unlink()


def test_a_remedy_that_a_command_has_no_option_for_stays_in_words(
    fuzzycnc, refused, recorded, bag
):
    assert fuzzycnc('train', bag('training'), '--out', 'm.json', *QUICK).code == 0
    slow = recorded('slow', {}, rows=80, interval=300.0)
    line = refused('evaluate', slow, '--model', 'm.json', naming=['one every 300 s'])
    assert line.endswith('record faster, or train with an interval of 300 s')
    assert '--' not in line


@pytest.fixture
def bed(table):
    """Return tables of a machine with a bed that is heated by 35 K/min, to 165 degC."""

    def recorded(name, rows):
        columns = warm_up(rows)
        columns['t3'] = 25.0 + np.minimum(35.0 * np.arange(rows), 140.0) + 0.01 * columns['t1']
        return table(f'{name}.csv', columns)

    return recorded


def test_a_heated_bed_passes_with_limits_of_its_own(fuzzycnc, refused, bed):
    refused(
        'import-csv', bed('one', 100), '--out', 'one', *IMPORT,
        naming=['expected -20 to 120 degC', '--sensor-limits'],
    )  # fmt: skip
    hot = ('--sensor-limits', 't3:range_high:200')
    for name, rows in (('one', 100), ('two', 110)):
        outcome = fuzzycnc('import-csv', bed(name, rows), '--out', name, *IMPORT, *hot)
        assert outcome.code == 0, outcome
    command = ('train', 'one', 'two', '--out', 'm.json', *QUICK)
    line = refused(*command, naming=['within -20 and 120 degC', '--drop-sensor t3'])
    assert line.endswith('--sensor-limits t3:range_high:140')
    line = refused(*command, *hot, naming=['at most 10 K per minute', "'t3'"])
    fast = line.split('give it limits of its own: ')[1].split()
    assert fast[0] == '--sensor-limits'
    outcome = fuzzycnc(*command, *hot, *fast)
    assert outcome.code == 0, outcome
    judged = fuzzycnc('evaluate', 'one', '--model', 'm.json', *hot)
    assert 'one: judged from' in judged.out


def holed_run(lost):
    run = recordings()['T2']
    temperature = run.temperature.copy()
    for name, rows in lost.items():
        temperature[list(rows), run.sensor.index(name)] = np.nan
    return replace(run, temperature=temperature)


def test_what_evaluate_judges_is_what_the_predictor_says():
    model = trained()
    whole = recordings()['T2']
    lost = {model.inputs[0]: range(60, 150), model.inputs[1]: (100, 101)}
    filled, gaps = as_predicted(model, holed_run(lost))
    assert {gap.by for gap in gaps} == {MATES}
    bench = bench_with_model()
    found = []
    for row in range(len(whole.time)):
        bad = [name for name, rows in lost.items() if row in rows]
        found += predict(bench, whole, [row], bad)
    said = 1e6 * model.predict(filled)
    assert np.abs(errors_of(found[3:]) - said[3:]).max() < 1e-6
    assert np.abs(said - 1e6 * model.predict(whole)).max() > 0.05


def test_a_line_goes_over_samples_that_all_sensors_lack():
    model = trained()
    run = recordings()['T2']
    rows = range(100, 119)
    filled, gaps = as_predicted(model, holed_run(dict.fromkeys(run.sensor, rows)))
    assert {gap.by for gap in gaps} == {LINE}
    bench = bench_with_model()
    found = predict(bench, run, (row for row in range(200) if row not in rows))
    assert len(found) == 181
    said = model.predict(filled)[[row for row in range(200) if row not in rows]] * 1e6
    assert np.abs(errors_of(found[3:]) - said[3:]).max() < 1e-6
    with pytest.raises(ThermalDataError, match='nor sensors that can stand in'):
        as_predicted(model, holed_run(dict.fromkeys(run.sensor, range(100, 121))))


# Probes taken in turn


@pytest.fixture
def in_turn(fuzzycnc, tmp_path):
    """Return a bag of a machine whose Y and Z are probed in turn, Y twice as often."""

    def imported(name, rows=120):
        columns = warm_up(rows)
        lines = ['t,t1,t2,t3,dy,dz']
        for row, values in enumerate(zip(*columns.values(), strict=True)):
            *head, dz = (f'{value:.6f}' for value in values)
            dy = f'{0.5 * values[-1] + 2.0 * np.sin(row / 20.0):.6f}'
            lines.append(','.join([*head, '' if row % 3 == 2 else dy, dz if row % 3 == 2 else '']))
        file = tmp_path / f'{name}.csv'
        file.write_text('\n'.join(lines) + '\n')
        channels = '--displacement', 'dy=Y:um,dz=Z:um'
        outcome = fuzzycnc('import-csv', file, '--out', name, *IMPORT[:4], *channels)
        assert outcome.code == 0, outcome
        return Path(name)

    return imported


def test_channels_that_are_probed_in_turn_are_judged_each_on_its_own(fuzzycnc, here, in_turn, bag):
    bags = in_turn('a'), in_turn('b', 99)
    clusters = '--sensors', 'clusters', '--clusters', '2'
    names = '--models', 'static_ridge,lag_ridge,stable_grey'
    train = fuzzycnc('train', *bags, '--out', 'm.json', *clusters, *names)
    assert train.code == 0, train
    options = ('--model', 'm.json', '--json', 'e.json')
    outcome = fuzzycnc('evaluate', 'a', *options)
    assert 'samples: 80 of dy, 40 of dz; ' in outcome.out
    found = read_json('e.json')
    assert found['samples'] == {'a': {'dy': 80, 'dz': 40}}
    assert found['runs']['a']['default']['dz']['rms_um'] < 0.3
    outcome = fuzzycnc('evaluate', 'a', 'b', *options)
    assert outcome.code == 0, outcome
    row, *_ = [line.split() for line in outcome.out.splitlines() if line.startswith('b ')]
    assert '66/33' in row
    compare = fuzzycnc('compare', *bags, *QUICK, '--json', 'c.json')
    assert compare.code == 0, compare
    assert read_json('c.json')['held_out']['b']['samples'] == {'dy': 66, 'dz': 33}
    assert fuzzycnc('curve', *bags, '--counts', '1,2').code == 0
