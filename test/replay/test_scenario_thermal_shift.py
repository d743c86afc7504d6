# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The thermal shift in one process: what it gives, and that its bag gives the same again."""

import numpy as np
import pytest
from kept import kept

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.bags.errors import BagExistsError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.core.thermal.run import ThermalDataError
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.shift.shift_log import ShiftLog, compensation_runs
from fuzzycnc_ros.studies.shift.shift_report import shift_report
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration, run_shift

OFFSET_MAX = 50e-6


@pytest.fixture(scope='module')
def calibration(tmp_path_factory):
    """Recorded calibration runs."""
    return record_calibration(('D0', 'D0b', 'T1'), folder=tmp_path_factory.mktemp('calibration'))


@kept
def model_of_the_mill():
    return train_model(record_calibration(('D0', 'D0b', 'T1')).runs).to_json()


@pytest.fixture(scope='module')
def model_text():
    """A model trained on them."""
    return model_of_the_mill()


@pytest.fixture(scope='module')
def shift(calibration, model_text, tmp_path_factory):
    """A shift with its bag: runs, path."""
    path = tmp_path_factory.mktemp('shift') / 'bag'
    with PublishedBag(path) as bag:
        runs = run_shift(model_text, calibration, sink=bag)
    return runs, path


def same(first, second) -> bool:
    return np.array_equal(first, second, equal_nan=True)


def test_calibration_runs_equal_those_in_their_bags(calibration):
    assert [run.name for run in calibration.runs] == ['D0', 'D0b', 'T1']
    for run, path in zip(calibration.runs, calibration.bags, strict=True):
        read = read_run(path)
        assert (read.name, read.sensor, read.channel) == (run.name, run.sensor, run.channel)
        assert same(read.time, run.time)
        assert same(read.temperature, run.temperature)
        assert same(read.displacement, run.displacement)


def test_calibration_without_bags_gives_the_same_runs(calibration):
    again = record_calibration()
    assert again.bags == ('D0', 'D0b', 'T1')
    for run, other in zip(calibration.runs, again.runs, strict=True):
        assert same(run.temperature, other.temperature)


@pytest.mark.slow
def test_noise_differs_between_seeds_duties_and_shift(calibration, shift):
    other = record_calibration(('D0',), seed=1).runs[0]
    noise = calibration.runs[0].temperature - other.temperature
    assert 0.03 < noise.std() < 0.1  # five readings with 0.1 K, twice
    truth = record_calibration(('T1', 'T1')).runs
    assert 0.03 < (truth[0].temperature - truth[1].temperature).std() < 0.1


def test_samples_are_means_of_five_readings(calibration):
    with BagReader(calibration.bags[0]) as reader:
        for _, _, _, message in reader.messages(['/mill/temperatures']):
            assert message.readings == 5


def test_an_unseen_shift_is_compensated(shift):
    runs, _ = shift
    assert [run.name for run in runs] == ['T2', 'T3']
    for run in runs:
        scores = run.scores()
        for before, after in zip(scores['uncompensated'], scores['applied'], strict=True):
            assert after.max < before.max / 2
            assert after.rms < before.rms / 2


@pytest.mark.paper
@pytest.mark.slow
def test_default_on_t2_within_the_published_figures_median_of_5_seeds():
    found = []
    for seed in range(5):
        calibration = record_calibration(seed=seed)
        text = train_model(calibration.runs).to_json()
        (run,) = run_shift(text, calibration, ('T2',), seed)
        found.append([score.max for score in run.scores()['default']])
    y, z = np.median(found, axis=0)
    assert y <= 4.8e-6
    assert z <= 4.6e-6


@pytest.mark.paper
@pytest.mark.slow
@pytest.mark.parametrize('seeds', [5, pytest.param(12, marks=pytest.mark.qualify)])
def test_lag_ridge_on_t3_median_of_seeds(seeds):
    found = []
    for seed in range(seeds):
        calibration = record_calibration(seed=seed)
        text = train_model(calibration.runs, candidates=('lag_ridge',)).to_json()
        (run,) = run_shift(text, calibration, ('T3',), seed)
        found.append([score.max for score in run.scores()['lag_ridge']])
    y, z = np.median(found, axis=0)
    assert y <= 5.5e-6
    assert z <= 5.0e-6


def test_the_published_prediction_is_that_of_the_models_own_candidate(shift, model_text):
    model = load_model(model_text)
    for run in shift[0]:
        published = run.predicted['default']
        known = np.isfinite(published).all(axis=1)
        assert known[2:].all()  # the reference takes three samples
        for column, name in enumerate(model.default):
            np.testing.assert_allclose(
                published[known, column], run.predicted[name][known, column], rtol=0, atol=1e-15
            )


def test_offsets_stay_within_their_limit_and_follow_the_prediction(shift):
    for run in shift[0]:
        assert np.nanmax(np.abs(run.offset)) <= run.offset_limit
        settled = np.abs(run.applied + run.predicted['default'])[10:]
        assert np.median(settled) < 1e-6


def test_the_bag_gives_the_same_runs(shift, model_text):
    runs, path = shift
    log = ShiftLog.from_bag(path)
    again = compensation_runs(log, load_model(model_text), ('T2', 'T3'), offset_max=OFFSET_MAX)
    for run, other in zip(runs, again, strict=True):
        assert same(run.temperature, other.temperature)
        assert same(run.residual(), other.residual())
        assert same(run.offset, other.offset)
        assert run.predicted.keys() == other.predicted.keys()
        assert all(same(run.predicted[name], other.predicted[name]) for name in run.predicted)


@pytest.mark.replay
def test_the_bag_replays_to_the_same_outputs(shift):
    report = replay(shift[1])
    assert report.notes == []
    assert report.identical, [item for item in report.topics if not item.equal]
    assert {item.topic for item in report.topics} == {
        '/mill/thermal_reference',
        '/mill/temperatures',
        '/mill/sensor_selection',
        '/mill/thermal_error',
        '/mill/predictor_state',
        '/mill/compensation',
    }


@pytest.mark.slow
@pytest.mark.replay
def test_the_bag_replays_with_faults_and_other_parameters(calibration, model_text, tmp_path):
    model = load_model(model_text)
    first, second = model.inputs[:2]
    parameters = {
        'compensator': {'offset_max': 15e-6, 'hold_time': 60.0},
        'temperature_acquisition': {'interval': 60.0, 'stuck_time': 300.0},
    }
    with PublishedBag(tmp_path / 'bag') as bag:
        runs = run_shift(
            model_text,
            calibration,
            ('T2',),
            seed=3,
            faults=[f'{first}:dead:3600', f'{second}:stuck:5000', f'{second}:open:9000'],
            parameters=parameters,
            sink=bag,
        )
    assert np.nanmax(np.abs(runs[0].offset)) == pytest.approx(15e-6)
    report = replay(tmp_path / 'bag')
    assert report.identical, [item for item in report.topics if not item.equal]


@pytest.mark.slow
def test_equal_runs_give_equal_bags(calibration, model_text, tmp_path):
    for name in ('a', 'b'):
        (tmp_path / name).mkdir()
        with PublishedBag(tmp_path / name / 'bag') as bag:
            run_shift(model_text, calibration, ('T2',), sink=bag)
    first, second = (tmp_path / name / 'bag' / 'bag_0.mcap' for name in 'ab')
    assert first.read_bytes() == second.read_bytes()


def test_a_sink_changes_nothing(calibration, model_text):
    seen = []
    plain = run_shift(model_text, calibration, ('T2',))
    watched = run_shift(
        model_text, calibration, ('T2',), sink=lambda topic, record: seen.append(topic)
    )
    assert same(plain[0].residual(), watched[0].residual())
    turns = {topic for topic in seen if topic.startswith('machine_tick/')}
    assert turns == {
        'machine_tick/temperature_acquisition',
        'machine_tick/sensor_selector',
        'machine_tick/thermal_predictor',
        'machine_tick/compensator',
    }


def test_a_dead_sensor_is_substituted_and_no_candidate_is_fed_a_gap(model_text, calibration):
    chosen = load_model(model_text).inputs[0]
    (run,) = run_shift(model_text, calibration, ('T2',), faults=[f'{chosen}:dead:3600'])
    assert np.isnan(run.temperature[70, run.sensor.index(chosen)])
    for name, values in run.predicted.items():
        if name != 'classical_grey':  # may diverge by itself
            assert np.isfinite(values[3:]).all(), name
    assert run.scores()['default'][0].max < 8e-6


def test_without_any_sensor_predictions_end_and_offsets_go_to_zero(model_text):
    dead = [f'T{number}:dead:5000' for number in range(1, 77)]
    (run,) = run_shift(model_text, None, ('T2',), faults=dead)
    lost = run.time > 5100.0
    assert all(np.isnan(values[lost]).all() for values in run.predicted.values())
    assert not run.in_domain[lost].any()
    assert not run.offset[-1].any()
    assert not run.applied[-1].any()


def test_states_of_the_compensator_in_the_bag(shift):
    with BagReader(shift[1]) as reader:
        messages = reader.messages(['/mill/compensation'])
        states = [CompensationState(message.state) for _, _, _, message in messages]
    assert CompensationState.ACTIVE in states
    assert max(states.count(state) for state in states) == states.count(CompensationState.ACTIVE)


def test_log_times_never_go_back_and_start_at_the_first_tick(shift):
    with BagReader(shift[1]) as reader:
        times = [message.log_time for message in reader.messages(raw=True)]
        kept = {topic: item.profiles[0] for topic, item in reader.connections.items()}
    assert times == sorted(times)
    assert times[0] == (6 * 3600 + 12) * 10**9
    latched = {name for name, profile in kept.items() if profile['depth'] == 1}
    assert latched == {
        f'/mill/{name}'
        for name in (
            'node_configuration',
            'predictor_state',
            'sensor_selection',
            'thermal_reference',
        )
    }


def test_report_holds_the_curve_and_the_provenance(shift, calibration, model_text):
    model = load_model(model_text)
    data = shift_report(
        shift[0], model, model_text, calibration=calibration.runs, facts={'Machine': 'mill'}
    )
    assert data.sensor_count_curve.run == 'T2'
    assert data.sensor_count_curve.chosen_count == len(model.inputs)
    assert data.facts['Machine'] == 'mill'
    assert data.facts['Training runs'] == 'D0, D0b, T1'
    assert shift_report(shift[0], model, model_text).sensor_count_curve is None


def test_an_interrupted_run_leaves_a_readable_bag(model_text, tmp_path):
    def interrupt(text, done, total):
        if done >= 200:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), PublishedBag(tmp_path / 'bag') as bag:
        run_shift(model_text, None, ('T2',), sink=bag, progress=interrupt)
    with BagReader(tmp_path / 'bag') as reader:
        assert reader.connections['/mill/sensor_readings'].message_count == 200


def test_progress_is_told_with_the_duty():
    told = []
    record_calibration(('D0',), progress=lambda *state: told.append(state))
    assert told[0] == ('calibrating on D0', 50, 1000)
    assert told[-1] == ('calibrating on D0', 1000, 1000)


@pytest.mark.parametrize(
    ('parameters', 'text'),
    [
        ({'recorder': {}}, "expected a node of .* but found 'recorder'"),
        ({'compensator': {'offset': 1.0}}, 'unknown parameter offset of compensator'),
        ({'compensator': {'offset_max': 1.0}}, r'offset_max = 1.0 is outside \[0.0, 0.001\] m'),
    ],
)
def test_wrong_parameters_are_refused(model_text, parameters, text):
    with pytest.raises(ValueError, match=text):
        run_shift(model_text, parameters=parameters)


def test_a_bag_that_exists_is_refused(tmp_path):
    with pytest.raises(BagExistsError, match='expected a new directory'):
        PublishedBag(tmp_path)
    (tmp_path / 'D0').mkdir()
    with pytest.raises(BagExistsError, match='D0'):
        record_calibration(('D0',), folder=tmp_path)


def test_names_must_fit_the_duties_of_the_log(shift, model_text):
    log = ShiftLog.from_bag(shift[1])
    with pytest.raises(ValueError, match=r'expected 2 duties .* but found T2'):
        compensation_runs(log, load_model(model_text), ('T2',), offset_max=OFFSET_MAX)


def test_an_empty_log_holds_no_run():
    with pytest.raises(ThermalDataError, match="run 'T2': expected temperatures and displace"):
        ShiftLog().thermal_run('T2')


@pytest.mark.replay
def test_calibration_bags_replay(calibration):
    for path in calibration.bags:
        assert replay(path).identical
        assert '/mill/temperatures' in topic_hashes(path)
