# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bad input ends with code 2 and one line that names the thing and the remedy."""

from pathlib import Path

import numpy as np
import pytest

from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.studies.shift import thermal_shift

HELLO = b'\x00\x01\x00\x00\x03\x00\x00\x00hi\x00'
IMPORT = ('--time', 't', '--temperature', 't*', '--displacement', 'dz=Z:um')


def truncate(bag: Path) -> None:
    file = bag / f'{bag.name}_0.mcap'
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 6 // 10])


def commands(bag, model: Path = Path('any.json')):
    """Every command that reads the runs of a bag."""
    return [('train', bag, '--out', 'new.json'), ('evaluate', bag, '--model', model)]


# Bags


def test_no_bag(refused, model):
    for command in [*commands('gone', model), ('replay', 'gone'), ('info', 'gone')]:
        refused(*command, naming=['gone', 'nothing is there'])


def test_empty_bag(refused, fuzzycnc, model):
    BagWriter('empty').close()
    for command in commands('empty', model):
        refused(*command, naming=['empty', 'temperatures', 'no messages at all'])
    refused('replay', 'empty', naming=['empty', 'node_configuration'])
    assert fuzzycnc('info', 'empty').code == 0


def test_truncated_bag(refused, bag, model):
    torn = bag('torn')
    truncate(torn)
    for command in [*commands(torn, model), ('replay', torn), ('info', torn)]:
        refused(*command, naming=['torn_0.mcap: truncated', 'fuzzycnc info', '--repair'])


def test_bag_without_the_topics(refused, model):
    with BagWriter('chat') as writer:
        writer.add_topic('/chatter', 'std_msgs/msg/String')
        writer.write('/chatter', 1, 1, HELLO)
    for command in commands('chat', model):
        refused(*command, naming=['chat', 'temperatures', '/chatter (1)'])
    refused('replay', 'chat', naming=['chat', 'node_configuration'])


def test_bag_whose_index_promises_more_than_it_yields(refused, fuzzycnc, bag, model):
    lying = bag('lying')
    metadata = lying / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace('message_count: 120', 'message_count: 125'))
    for command in commands(lying, model):
        refused(*command, naming=['125 messages', '120', '--repair'])
    shown = fuzzycnc('info', lying)
    assert shown.code == 0
    assert 'problem: lying: expected 125 messages' in shown.out


def test_replay_of_a_bag_that_was_only_imported(refused, bag):
    refused('replay', bag(), naming=['node_configuration', 'record all topics'])


# CSV


def test_csv_with_a_missing_column(refused, table):
    refused(
        'import-csv', table(), '--out', 'b', '--time', 't', '--temperature', 't*',
        '--displacement', 'dx=X:um', naming=['log.csv', "'dx'", 't1, t2, t3, dz'],
    )  # fmt: skip
    assert not Path('b').exists()


def test_csv_with_text_in_a_number(refused, table):
    file = table()
    lines = file.read_text().splitlines()
    lines[5] = lines[5].replace(lines[5].split(',')[2], 'warm')
    file.write_text('\n'.join(lines))
    refused('import-csv', file, '--out', 'b', *IMPORT, naming=['log.csv', '6', "'warm'", 't2'])


def test_csv_with_uneven_time(refused, table, tmp_path):
    file = table()
    lines = file.read_text().splitlines()
    file.write_text('\n'.join(lines[:40] + lines[42:]))
    refused('import-csv', file, '--out', 'b', *IMPORT, naming=['log.csv', '--resample'])


def test_csv_with_duplicate_sensor_names(refused, table):
    file = table()
    file.write_text(file.read_text().replace('t,t1,t2', 't,t1,t1', 1))
    refused('import-csv', file, '--out', 'b', *IMPORT, naming=['log.csv', 't1', 'once'])


def test_csv_in_mm_instead_of_um(refused, table):
    options = [*IMPORT[:-1], 'dz=Z:mm']
    naming = ['log.csv', "'dz'", '500 µm', 'in um']
    refused('import-csv', table(), '--out', 'b', *options, naming=naming)


def test_csv_that_is_not_there(refused):
    refused('import-csv', 'gone.csv', '--out', 'b', *IMPORT, naming=['gone.csv'])


@pytest.mark.parametrize(
    ('content', 'naming'),
    [
        ('time: [t', ['log.yaml', 'YAML']),
        ('- t\n', ['log.yaml', 'settings']),
        ('tiem: t\n', ['log.yaml', 'unknown setting tiem', 'time_unit']),
        ('rows: [0]\n', ['log.yaml', 'rows', '[first, last]']),
        ('resample: often\n', ['log.yaml', 'resample', "'often'"]),
        ('zero: 3\n', ['log.yaml', 'zero', 'true or false']),
        ('rename: t1\n', ['log.yaml', 'rename', 'column: name']),
    ],
)
def test_damaged_mapping_file(refused, table, content, naming):
    Path('log.yaml').write_text(content)
    refused('import-csv', table(), '--out', 'b', '--mapping', 'log.yaml', naming=naming)


@pytest.mark.parametrize(
    ('options', 'naming'),
    [
        (('--rows', 'all'), ['--rows', 'FIRST:LAST', "'all'"]),
        (('--rename', 't1'), ['--rename', 'COLUMN=NAME', "'t1'"]),
        (('--displacement', 'dz'), ['COLUMN=AXIS:UNIT', "'dz'"]),
        (('--displacement', 'dz=Q:um'), ["'Q'", 'axis']),
        (('--time-unit', 'days'), ['time_unit', "'days'"]),
        (('--machine', '1'), ['machine', "'1'"]),
    ],
)
def test_import_options(refused, table, options, naming):
    refused('import-csv', table(), '--out', 'b', *IMPORT, *options, naming=naming)


# Models


def test_model_trained_on_other_sensors(refused, bag, model):
    other = bag('other', '--rename', 't1=spindle')
    refused('evaluate', other, '--model', model, naming=['t1', 'spindle'])


def test_model_trained_at_another_interval(refused, bag, model):
    slow = bag('slow', interval=300.0)
    refused('evaluate', slow, '--model', model, naming=['60 s', '300 s'])


def test_model_of_other_channels(refused, bag, model):
    other = bag('other', '--rename', 'dz=probe')
    refused('evaluate', other, '--model', model, naming=['dz', 'probe'])


@pytest.mark.parametrize(
    ('content', 'naming'),
    [
        ('{"schema": 1', ['JSON']),
        ('{"schema": "other"}', ['schema', 'other']),
        ('', ['JSON']),
    ],
)
def test_file_that_is_no_model(refused, bag, content, naming):
    Path('bad.json').write_text(content)
    refused('evaluate', bag(), '--model', 'bad.json', naming=['bad.json', *naming])
    refused('simulate', '--model', 'bad.json', naming=['bad.json', *naming])


def test_model_file_that_exists_is_kept(refused, fuzzycnc, bag, model):
    before = model.read_text()
    refused('train', bag(), '--out', model, naming=['model.json', '--force'])
    assert model.read_text() == before
    assert fuzzycnc('train', bag('again'), '--out', model, '--force').code == 0


def test_training_that_fails_leaves_no_file(refused, bag):
    refused('train', bag(), '--out', 'm.json', '--model', 'magic', naming=["'magic'", 'lag_ridge'])
    refused('train', bag('b'), '--out', 'm.json', '--end', '60', naming=['8', '2'])
    refused('train', bag('c'), '--out', 'm.json', '--start', '1e6', naming=['1000000', '7140'])
    assert not list(Path().glob('*m.json*'))


def test_a_machine_that_stayed_cold(refused, table, fuzzycnc):
    columns = {'t': 60.0 * np.arange(60), 't1': np.full(60, 20.0), 'dz': np.zeros(60)}
    file = table('cold.csv', columns)
    assert fuzzycnc('import-csv', file, '--out', 'cold', *IMPORT).code == 0
    refused('train', 'cold', '--out', 'm.json', naming=['0.5 K', 'cold'])


# Parameters


@pytest.mark.parametrize(
    ('options', 'naming'),
    [
        (('--duties', 'T9'), ['duties', 'T9', 'D0b']),
        (('--duties', ''), ['duties', 'none']),
        (('--train', 'D0,warm'), ['duties', 'warm']),
        (('--seed', '-1'), ['--seed', '-1']),
        (('--seeds', '0'), ['--seeds', '0']),
        (('--fault', 'T99:dead:0'), ['T99', 'T1 to T76']),
        (('--fault', 'T18:cold:0'), ["'cold'", 'drift']),
        (('--fault', 'T18'), ["'T18'", 'T18:drift:3600:2.0']),
        (('--param', 'offset_max=1'), ['--param', 'NODE.NAME=VALUE']),
        (('--param', 'spindle.speed=1'), ["'spindle'", 'compensator']),
        (('--param', 'compensator.ofset_max=1'), ['ofset_max', 'offset_max']),
        (('--param', 'compensator.offset_max=2.0'), ['offset_max = 2.0', '[0.0, 0.001] m']),
        (
            ('--param', 'compensator.offset_max=much'),
            ['offset_max', 'a length in mm, um, m or inch', "'much'"],
        ),
        (('--param', 'compensator.axes=[Q]'), ['axes', 'Q']),
    ],
)
def test_a_shift_with_bad_settings_does_not_begin(refused, monkeypatch, options, naming):
    monkeypatch.setattr(thermal_shift, 'judged_graph', lambda *_: pytest.fail('it began'))
    refused('simulate', *options, naming=naming)


def test_negative_duration(refused):
    refused('record', '--out', 'b', '--duration', '-1', naming=['--duration', '-1'])


def test_outputs_that_exist(refused):
    Path('shift').mkdir()
    refused('simulate', '--out', 'shift', naming=['shift', 'another'])
    refused('record', '--out', 'shift', naming=['shift', 'another'])
    Path('second_calibration').mkdir()
    refused('simulate', '--out', 'second', naming=['second_calibration', 'another'])


def test_two_bags_for_info(refused, bag):
    refused('info', bag(), 'other', naming=['other', '--repair'])
