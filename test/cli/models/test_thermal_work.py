# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What each command does when all is well."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from benches import predictor_bench
from command_lines import read_json
from small_recordings import warm_up

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.recorder import REPORT_NAME
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.cli.models.simulate import median_figures, median_table
from fuzzycnc_ros.cli.models.train import candidate_table, problem_lines
from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.core.thermal.candidate import SPEED_SUFFIX, STANDARD
from fuzzycnc_ros.core.thermal.fit import evaluate
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.runtime.arithmetic import arithmetic

SHORT = ('--duties', 'T2', '--train', 'D0,T1')


# import-csv


def test_import_with_options_and_with_a_mapping_file_are_equal(fuzzycnc, table):
    file = table()
    options = ('--time', 't', '--temperature', 't1,t2', '--displacement', 'dz=-Z:um')
    assert fuzzycnc('import-csv', file, '--out', 'a', *options, '--machine', 'm').code == 0
    Path('log.yaml').write_text(
        'time: t\ntemperatures: [t1, t2]\ndisplacements: dz=-Z:um\nmachine: other\n'
    )
    outcome = fuzzycnc(
        'import-csv', file, '--out', 'b', '--mapping', 'log.yaml', '--machine', 'm',
        '--json', 'i.json',
    )  # fmt: skip
    assert outcome.code == 0, outcome
    assert read_json('i.json')['sensors'] == ['t1', 't2']
    assert topic_hashes('a') == topic_hashes('b')
    run = read_run('b')
    assert run.displacement[59, 0] < -9e-6
    assert run.channel == ('dz',)


def test_import_of_some_rows_with_other_names(fuzzycnc, table):
    outcome = fuzzycnc(
        'import-csv', table(), '--out', 'b', '--time', 't', '--temperature', 't*',
        '--displacement', 'dz=Z:um', '--rows', '10:29', '--rename', 't1=spindle,t2=head',
        '--json', 'i.json',
    )  # fmt: skip
    assert outcome.code == 0, outcome
    assert read_json('i.json')['samples'] == 20
    assert read_run('b').sensor == ('spindle', 'head', 't3')


def test_import_of_a_german_table(fuzzycnc):
    lines = ['Zeit;Vorn [°C];Hinten [°C];Z [µm];Drehzahl']
    for row in range(60):
        rise = f'{0.2 * row:.2f}'.replace('.', ',')
        lines.append(
            f'12.03.2026 {8 + row // 60:02d}:{row % 60:02d}:00;2{row % 10},5;21;{rise};600'
        )
    Path('Export.csv').write_bytes('\r\n'.join(lines).encode('cp1252'))
    options = (
        '--time', 'Zeit', '--temperature', 'Vorn*,Hinten*', '--displacement', 'Z [µm]=Z:um',
        '--speed', 'Drehzahl', '--encoding', 'cp1252', '--decimal', ',',
    )  # fmt: skip
    outcome = fuzzycnc('import-csv', 'Export.csv', '--out', 'a', *options, '--json', 'i.json')
    assert outcome.code == 0, outcome
    remark, zone = read_json('i.json')['remarks']
    assert remark == "times of 'Zeit' read as %d.%m.%Y %H:%M:%S"
    assert 'the zone of this computer; --time-zone names another' in zone
    assert f'{remark}\n' in outcome.out
    Path('log.yaml').write_text(
        'time: Zeit\ntime_format: dd.mm.yyyy hh:mm:ss\ntemperatures: ["Vorn*", "Hinten*"]\n'
        'displacements: "Z [µm]=Z:um"\nspindle_speed: Drehzahl\nencoding: cp1252\n'
        'header: true\ndecimal: ","\n'
    )
    outcome = fuzzycnc('import-csv', 'Export.csv', '--out', 'b', '--mapping', 'log.yaml')
    assert outcome.code == 0, outcome
    assert topic_hashes('a') == topic_hashes('b')


def test_import_without_a_header_warns_of_what_looks_wrong(fuzzycnc, table):
    file = table(columns={'0': warm_up()['t'] / 60.0} | dict(list(warm_up().items())[1:]))
    file.write_text(file.read_text().partition('\n')[2])
    options = ('--time', 'c1', '--temperature', 'c[234]', '--displacement', 'c5=Z:um')
    outcome = fuzzycnc(
        'import-csv', file, '--no-header', '--out', 'b', *options, '--json', 'i.json'
    )
    assert outcome.code == 0, outcome
    (warning,) = read_json('i.json')['warnings']
    assert warning.endswith('import with --time-unit min')
    assert f'warning: {warning}\n' in outcome.out


# train, evaluate


def test_train_writes_a_model_and_says_what_it_holds(fuzzycnc, bag):
    outcome = fuzzycnc(
        'train', bag('one'), bag('two', rows=90), '--out', 'm.json', '--json', 't.json'
    )
    assert outcome.code == 0, outcome
    model = load_model(Path('m.json'))
    figures = read_json('t.json')
    assert figures['hash'] == text_hash(Path('m.json').read_text())
    assert figures['runs'] == ['one', 'two']
    assert figures['sensors'] == list(model.inputs)
    assert figures['default'] == {'dz': model.default[0]}
    without_speed = {name for name in STANDARD if not name.endswith(SPEED_SUFFIX)}
    named = set(figures['candidates']) | set(figures['omitted'])
    assert named == {'uncompensated', *without_speed}
    assert figures['uncompensated'] == figures['worse_than_none'] == []
    assert 'Static ridge' in outcome.out
    assert ', '.join(model.inputs) in outcome.out
    assert 'm.json: written' in outcome.out


def test_train_uses_the_asked_window_model_and_interval(fuzzycnc, bag):
    fuzzycnc(
        'train', bag('fast', rows=600, interval=10.0), '--out', 'm.json', '--end', '3000',
        '--model', 'static_ridge', '--interval', '30', '--sensors', 'clusters', '--clusters', '2',
    )  # fmt: skip
    model = load_model(Path('m.json'))
    assert model.default == ('static_ridge',)
    assert model.interval == pytest.approx(30.0)
    assert len(model.inputs) == 2


def test_what_is_not_to_be_trusted_is_said(model):
    trained = load_model(model)
    flagged = replace(trained.candidates['classical_grey'], problems=('a = -0.1 is bad',))
    trained = replace(
        trained,
        candidates={**trained.candidates, 'classical_grey': flagged},
        omitted={'lag_ridge': 'too short'},
    )
    assert problem_lines(trained) == [
        'Classical GM(1,N) is not to be trusted: a = -0.1 is bad',
        'LagRidge was left out: too short',
    ]
    shown = [row[0] for row in candidate_table(trained).rows]
    assert 'Classical GM(1,N) *' in shown
    assert 'Static ridge' in shown


def test_train_considers_the_asked_models(fuzzycnc, bag):
    outcome = fuzzycnc(
        'train',
        bag(),
        '--out',
        'm.json',
        '--models',
        'anfis,static_ridge',
        '--models',
        'lag_ridge',
    )
    assert outcome.code == 0, outcome
    model = load_model(Path('m.json'))
    assert list(model.candidates) == ['uncompensated', 'static_ridge', 'lag_ridge', 'anfis']
    assert set(model.default) <= set(model.candidates)
    assert 'spindle speed: not used' in outcome.out


@pytest.mark.parametrize('option', ['--model', '--models'])
def test_train_refuses_what_is_only_compared(fuzzycnc, bag, option):
    outcome = fuzzycnc('train', bag(), '--out', 'm.json', option, 'mlp')
    assert outcome.code == 2
    assert f"{option}: expected a model that runs on machines but found 'mlp'" in outcome.err
    assert 'fuzzycnc compare --models mlp' in outcome.err
    assert not Path('m.json').exists()


def test_evaluate_prints_what_the_core_finds(fuzzycnc, bag, model):
    held_out = bag('held_out', rows=100)
    outcome = fuzzycnc(
        'evaluate', held_out, '--model', model, '--start', '1800', '--end', '4800',
        '--json', 'e.json', '--report', 'e.html',
    )  # fmt: skip
    assert outcome.code == 0, outcome
    expected = evaluate(load_model(model), read_run(held_out), start=1800.0, stop=4800.0)
    figures = read_json('e.json')
    assert figures['samples'] == {'held_out': {'dz': expected.samples[0]}}
    for name, channels in figures['runs']['held_out'].items():
        for column, channel in enumerate(expected.channel):
            rms = 1e6 * expected.rms[name][column]
            found = channels[channel]['rms_um']
            assert found == (pytest.approx(rms) if np.isfinite(rms) else None)
    assert re.search(r'Uncompensated +\d', outcome.out)
    assert 'class="chart"' in Path('e.html').read_text()


@pytest.mark.slow
def test_evaluate_judges_several_bags(fuzzycnc, bag, model):
    outcome = fuzzycnc('evaluate', bag('a'), bag('b', rows=100), '--model', model)
    assert outcome.code == 0, outcome
    assert 'Residual thermal error of 2 runs' in outcome.out


# simulate, replay


def test_simulate_writes_table_figures_and_report(fuzzycnc):
    outcome = fuzzycnc('simulate', *SHORT, '--json', 's.json', '--report', 'r.html')
    assert outcome.code == 0, outcome
    figures = read_json('s.json')
    rows = figures['runs']['T2']
    assert set(rows) == {'uncompensated', *STANDARD, 'default', 'applied'}
    assert rows['uncompensated']['y']['max_um'] == pytest.approx(38.5, abs=1.0)
    assert rows['default']['y']['max_um'] < 8.0
    assert figures['seeds'] == [{'seed': 0, 'runs': figures['runs']}]
    page = Path('r.html').read_text()
    assert page.count('class="chart"') >= 5
    assert 'T2 Y max' in outcome.out


@pytest.mark.slow
def test_simulate_gives_the_median_over_seeds(fuzzycnc):
    outcome = fuzzycnc('simulate', *SHORT, '--seed', '3', '--seeds', '3', '--json', 's.json')
    assert outcome.code == 0, outcome
    figures = read_json('s.json')
    assert [item['seed'] for item in figures['seeds']] == [3, 4, 5]
    found = [item['runs']['T2']['default']['z']['rms_um'] for item in figures['seeds']]
    assert len(set(found)) == 3
    assert figures['runs']['T2']['default']['z']['rms_um'] == pytest.approx(np.median(found))
    assert 'median of 3 noise seeds' in outcome.out


def document(value):
    return {'T2': {'lag_ridge': {'y': {'max_um': value}}}}


@pytest.mark.parametrize(
    ('values', 'expected'),
    [
        ([3.0, 1.0, 2.0], 2.0),
        ([1.0, 4.0], 2.5),
        ([1.0, None, None], None),
        ([1.0, None, 2.0], 2.0),
        ([None, 2.0], None),
    ],
)
def test_median_counts_divergence_as_worst(values, expected):
    assert median_figures([document(value) for value in values]) == document(expected)


def test_medians_are_shown_in_micrometres():
    figures = [{'max_um': value, 'rms_um': None} for value in (30.0, 10.0, 20.0)]
    runs = (SimpleNamespace(name='T2', channel=('Y',)),)
    table = median_table([{'T2': {'lag_ridge': {'y': item}}} for item in figures], runs)
    assert [row[1:] for row in table.rows] == [('20.0', 'diverged')]


@pytest.mark.slow
def test_simulate_twice_gives_the_same_bag_and_replay_gives_the_same_outputs(fuzzycnc):
    for name in ('a', 'b'):
        outcome = fuzzycnc('simulate', *SHORT, '--seed', '2', '--out', f'{name}/shift')
        assert outcome.code == 2  # the folder has to be there
        Path(name).mkdir()
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(name)
            outcome = fuzzycnc('simulate', *SHORT, '--seed', '2', '--out', 'shift')
        assert outcome.code == 0, outcome
    first, second = (Path(name, 'shift', 'shift_0.mcap').read_bytes() for name in 'ab')
    assert first == second
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir('a')
        outcome = fuzzycnc('replay', 'shift', '--json', 'r.json')
        figures = read_json('r.json')
        hashed = fuzzycnc('replay', 'shift', '--hash', '--json', 'h.json')
        hashes = read_json('h.json')
    assert outcome.code == hashed.code == 0, outcome
    assert figures['identical'] is True
    assert f'all topics together: {hashes["hash"]}' in hashed.out
    for topic, found in figures['topics'].items():
        assert hashes['topics'][topic] == found['hash'], topic
        assert found['hash'] in hashed.out
    assert f'identical, hash {figures["hash"]}' in outcome.out
    assert '/mill/compensation' in figures['topics']
    assert '/mill/sensor_selection' in figures['topics']


CHANGED = '/mill/thermal_error'


def copy_with_another_error(source: str, target: str, change) -> None:
    """Copy a bag with one message changed, at machine time 30000 s."""
    with BagReader(source) as reader, BagWriter(target) as writer:
        for topic, item in reader.connections.items():
            writer.add_topic(topic, item.type, item.profiles)
        for topic, _, time, message in reader.messages():
            if topic == CHANGED and message.header.stamp.sec == 30_000:
                message = replace(message, error=change(message.error))
            writer.write_message(topic, message, time)


def test_replay_finds_a_changed_message_and_ends_with_1(fuzzycnc):
    Path('m.json').write_text(predictor_bench.model_text())
    ready = ('--duties', 'T2', '--model', 'm.json')
    assert fuzzycnc('simulate', *ready, '--out', 'shift').code == 0
    copy_with_another_error('shift', 'changed', lambda error: error + 1e-12)
    outcome = fuzzycnc('replay', 'changed', '--json', 'r.json')
    assert outcome.code == 1, outcome
    assert 'DIFFERENT' in outcome.out
    topics = read_json('r.json')['topics']
    assert topics[CHANGED]['first_difference'] == 'differs, at machine time 30000.000 s'
    assert topics[CHANGED]['identical'] == topics[CHANGED]['recorded'] - 1


@pytest.mark.slow
def test_replay_accepts_the_rounding_of_another_processor_and_says_so(fuzzycnc, monkeypatch):
    assert fuzzycnc('simulate', *SHORT, '--out', 'shift').code == 0
    copy_with_another_error('shift', 'rounded', lambda error: error * (1.0 + 1e-13))
    assert fuzzycnc('replay', 'rounded').code == 1, 'the same arithmetic has no excuse'
    elsewhere = f'{arithmetic()} AVX9'
    monkeypatch.setattr('fuzzycnc_ros.replay.replay.arithmetic', lambda: elsewhere)
    outcome = fuzzycnc('replay', 'rounded', '--json', 'r.json')
    assert outcome.code == 0, outcome
    assert 'equal up to rounding' in outcome.out
    figures = read_json('r.json')
    assert (figures['identical'], figures['equivalent']) == (False, True)
    assert 0.0 < figures['topics'][CHANGED]['largest_difference'] < 1e-12
    assert fuzzycnc('replay', 'rounded', '--exact').code == 1


@pytest.mark.slow
def test_simulate_with_a_model_file(fuzzycnc):
    assert fuzzycnc('simulate', *SHORT, '--out', 'shift', '--json', 'a.json').code == 0
    with BagReader('shift') as reader:
        Path('m.json').write_bytes(reader.attachments()['model.json'].data)
    outcome = fuzzycnc('simulate', '--duties', 'T2', '--model', 'm.json', '--json', 'b.json')
    assert outcome.code == 0, outcome
    assert read_json('b.json')['runs'] == read_json('a.json')['runs']


@pytest.mark.slow
def test_simulate_with_fault_and_parameter(fuzzycnc):
    options = ('--param', 'compensator.offset_max=20e-6', '--param', 'sensor_selector.clusters=5')
    assert fuzzycnc('simulate', *SHORT, *options, '--json', 'limited.json').code == 0
    limited = read_json('limited.json')['runs']['T2']
    # 38.5 um of error less 20 um of compensation stay.
    assert limited['applied']['y']['max_um'] == pytest.approx(18.5, abs=1.0)
    assert limited['default']['y']['max_um'] < 8.0
    faults = [word for n in range(1, 77) for word in ('--fault', f'T{n}:dead:5000')]
    assert (
        fuzzycnc('simulate', *SHORT, *faults, '--json', 'dead.json', '--report', 'r.html').code
        == 0
    )
    dead = read_json('dead.json')['runs']['T2']
    assert dead['applied']['y']['max_um'] > 30.0


# info


def test_info_counts_and_names_everything(fuzzycnc, bag):
    outcome = fuzzycnc('info', bag(), '--json', 'i.json')
    assert outcome.code == 0, outcome
    figures = read_json('i.json')
    assert figures['messages'] == 241
    assert figures['duration_s'] == pytest.approx(119 * 60.0)
    assert figures['topics']['/machine/temperatures'] == {
        'messages': 120,
        'promised': 120,
        'type': 'fuzzycnc_msgs/msg/Temperatures',
    }
    assert figures['problems'] == []
    assert re.search(r'/machine/thermal_reference +1 +1 +\S+ +latched', outcome.out)


def test_info_says_what_the_recorder_lost(fuzzycnc):
    counted = {'received': 5, 'written': 3, 'missing': 4, 'dropped': 2, 'publishers': 1}
    whole = dict(counted, missing=0, dropped=0)
    with BagWriter('lossy') as writer:
        writer.attach(REPORT_NAME, json.dumps({'topics': {'/a': counted, '/b': whole}}))
    outcome = fuzzycnc('info', 'lossy', '--json', 'i.json')
    assert outcome.code == 0, outcome
    assert 'lost while recording: 6 messages of /a\n' in outcome.out
    assert read_json('i.json')['lost_while_recording'] == {'/a': 6}


def test_info_says_which_samples_are_missing(fuzzycnc):
    holes = {'/a': {'count': 3, 'longest_s': 468.0, 'at_s': 1234.5}}
    with BagWriter('holed') as writer:
        writer.attach(REPORT_NAME, json.dumps({'topics': {}, 'holes': holes}))
    outcome = fuzzycnc('info', 'holed', '--json', 'i.json')
    text = '3 holes, the longest of 468 s at 1234.5 s'
    assert f'holes while recording: /a has {text}\n' in outcome.out
    assert read_json('i.json')['holes_while_recording'] == {'/a': text}


@pytest.mark.parametrize(
    'report',
    [
        '[]',
        '{"topics": {"/a": {"missing": Infinity, "dropped": 0}}}',
        '{"topics": {}, "holes": {"/a": 3}}',
        '{"topics": {}, "holes": {"/a": {"count": "no", "longest_s": 1, "at_s": 2}}}',
        '{"topics": {}, "gaps": 3}',
        '{"topics": {}, "gaps": [{"messages": Infinity, "from_s": 1, "to_s": 2, "cause": ""}]}',
    ],
)
def test_info_of_a_damaged_loss_report(refused, report):
    with BagWriter('odd') as writer:
        writer.attach(REPORT_NAME, report)
    refused('info', 'odd', naming=[REPORT_NAME, 'recorder'])


def without(bag, name, *windows):
    """Return a copy of a bag without the messages of some times [s] from its first."""
    with BagReader(bag) as reader, BagWriter(name) as writer:
        for topic, item in reader.connections.items():
            writer.add_topic(topic, item.type)
        for item in reader.messages(raw=True):
            time = 1e-9 * (item.log_time - reader.start)
            if not any(low <= time <= high for low, high in windows):
                writer.write(item.topic, item.log_time, item.log_time, item.message)
    return Path(name)


def test_train_tells_of_holes(fuzzycnc, bag):
    holed = without(bag(), 'holed', (1200.0, 1600.0), (3000.0, 3000.0))
    words = '2 holes, the longest of 480 s at 1140 s'
    whole = bag('whole', rows=130)
    outcome = fuzzycnc('train', holed, whole, '--out', 'm.json', '--json', 'figures.json')
    assert outcome.code == 0, outcome
    told = [line for line in outcome.out.splitlines() if line.startswith(('holed: ', 'whole: '))]
    assert told == [f'holed: {words}, filled by straight lines; record it anew for a better model']
    assert read_json('figures.json')['holes'] == {'holed': words, 'whole': ''}


@pytest.mark.parametrize('target', [(), ('whole',)])
def test_repair_writes_a_whole_bag_and_says_what_was_lost(fuzzycnc, bag, target):
    torn = bag('torn', rows=1200)
    file = torn / 'torn_0.mcap'
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    before = file.read_bytes()
    outcome = fuzzycnc('info', torn, '--repair', *target, '--json', 'i.json')
    assert outcome.code == 0, outcome
    assert file.read_bytes() == before
    name = target[0] if target else 'torn_repaired'
    figures = read_json('i.json')
    assert figures['path'] == name
    kept = figures['repair']['topics']['/machine/temperatures']['kept']
    assert 100 < kept < 1200
    assert len(read_run(name).time) == kept
    assert 'messages kept' in outcome.out
    assert 'cut off at byte' in outcome.out
    assert fuzzycnc('train', name, '--out', 'm.json').code == 0


def test_info_repair_does_not_overwrite(refused, bag):
    whole = bag()
    shutil.copytree(whole, 'copy')
    refused('info', whole, '--repair', 'copy', naming=['copy', 'exists'])
