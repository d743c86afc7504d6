# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Temperature acquisition: averaging, verdicts on sensors, the thermal reference."""

from dataclasses import replace

import numpy as np
import pytest
from benches.component_bench import Bench, applied, machine_state, readings
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.components.thermal.temperature_acquisition import (
    TemperatureAcquisition,
    TemperatureAcquisitionConfig,
)
from fuzzycnc_ros.runtime.enums import Status
from fuzzycnc_ros.runtime.records import SECOND, nanoseconds

PERIOD = 12.0
"""Time between two sets of readings [s]; five make a sample."""


def bench_of(**changes) -> Bench:
    """Return an acquisition with some parameters set."""
    return Bench(TemperatureAcquisition(TemperatureAcquisitionConfig(**changes)))


def feed(bench: Bench, count: int, temperature, *, start: float = 0.0) -> list:
    """Give `count` readings every 12 s from `start` on; return the samples that came of them.

    `temperature` is a function of the machine time [s], or constants to which a little noise is
    added, as no real sensor repeats itself to the last bit.
    """
    rng = np.random.default_rng(5)
    before = len(bench.records('temperatures'))
    for number in range(1, count + 1):
        time = start + PERIOD * number
        if callable(temperature):
            values = temperature(time)
        else:
            values = np.array(temperature) + rng.normal(0.0, 1e-3, len(temperature))
        bench.give('sensor_readings', readings(time, values))
    return bench.records('temperatures')[before:]


def statuses(sample) -> list[Status]:
    """Return the verdicts of a sample as words."""
    return [Status(value) for value in sample.status]


def test_five_readings_are_averaged_into_one_sample():
    bench = bench_of()
    samples = feed(bench, 10, lambda time: [20.0 + time / 100.0, 30.0 - time / 100.0])
    assert [item.stamp for item in samples] == [60 * SECOND, 120 * SECOND]
    assert [item.readings for item in samples] == [5, 5]
    np.testing.assert_allclose(samples[0].temperature, [20.36, 29.64])
    np.testing.assert_allclose(samples[1].temperature, [20.96, 29.04])
    assert samples[0].sensor == ('T1', 'T2')
    assert samples[0].frame_id == 'mill/machine'
    assert statuses(samples[1]) == [Status.OK, Status.OK]


@given(
    st.lists(st.floats(min_value=4.0, max_value=100.0), min_size=5, max_size=5),
    st.floats(min_value=-3.0, max_value=3.0),
)
def test_sample_lies_within_its_readings_and_moves_with_them(values, shift):
    """The mean of what was read, whatever it is, and nothing of other sensors."""
    config = {'rate_max': 100.0, 'noise_band': 50.0}
    one, other = bench_of(**config), bench_of(**config)
    for number, value in enumerate(values, 1):
        one.give('sensor_readings', readings(12.0 * number, [value, 20.0 + number]))
        other.give('sensor_readings', readings(12.0 * number, [value + shift, 20.0 + number]))
    first, second = one.records('temperatures')[0], other.records('temperatures')[0]
    assert min(values) - 1e-9 <= first.temperature[0] <= max(values) + 1e-9
    assert second.temperature[0] - first.temperature[0] == pytest.approx(shift, abs=1e-9)
    assert second.temperature[1] == first.temperature[1]


def test_samples_lie_on_whole_intervals_wherever_the_readings_begin():
    bench = bench_of()
    samples = feed(bench, 12, [20.0], start=30.0)
    assert [item.stamp // SECOND for item in samples] == [66, 126]
    assert [item.readings for item in samples] == [3, 5]


def test_noise_is_averaged():
    rng = np.random.default_rng(1)
    bench = bench_of()
    noise = rng.normal(0.0, 0.1, (1000, 50))
    samples = feed(bench, 1000, lambda time: 20.0 + noise[round(time / PERIOD) - 1])
    spread = np.std([item.temperature for item in samples])
    assert spread == pytest.approx(0.1 / np.sqrt(5), rel=0.1)


def test_missing_readings_are_left_out_of_the_mean():
    bench = bench_of()
    values = {12.0: np.nan, 24.0: 21.0, 36.0: 22.0, 48.0: np.nan, 60.0: 23.0}
    (sample,) = feed(bench, 5, lambda time: [values[time], 30.0 + time / 1000])
    assert sample.temperature[0] == pytest.approx(22.0)
    assert statuses(sample) == [Status.OK, Status.OK]


def test_most_readings_of_a_sample_must_be_good():
    """Two of five do not stand for a minute, three do."""
    for missing, verdict in ((2, Status.OK), (3, Status.MISSING)):
        bench = bench_of()
        (sample,) = feed(
            bench, 5, lambda time, n=missing: [np.nan if time <= 12.0 * n else 21.0 + time / 1e4]
        )
        assert statuses(sample) == [verdict]


def test_sensor_that_is_mostly_missing_is_reported_missing():
    bench = bench_of()
    samples = feed(bench, 10, lambda time: [np.nan, 30.0 + time / 1000])
    assert statuses(samples[-1]) == [Status.MISSING, Status.OK]
    assert np.isnan(samples[-1].temperature[0])
    assert 'WARN sensors: bad sensors: T1 missing' in bench.health()
    feed(bench, 5, lambda time: [25.0 + time / 1000, 30.0 + time / 1000], start=120.0)
    assert 'OK sensors: 2 sensors good' in bench.health()


@pytest.mark.parametrize('value', [-20.5, 121.0, 1e9, -300.0])
def test_reading_out_of_range_is_refused(value):
    bench = bench_of()
    (sample,) = feed(bench, 5, lambda time: [value + time * 1e-4, 30.0 + time / 1000])
    assert statuses(sample) == [Status.OUT_OF_RANGE, Status.OK]
    assert sample.temperature[0] == pytest.approx(value, abs=0.1)


@pytest.mark.parametrize(
    ('value', 'text'),
    [
        (295.15, 'T1 out_of_range (reads 295.15 degC; that is 22.0 degC if in kelvin'),
        (215.0, '21.5 degC if in tenths of a degree'),
        (2150.0, '21.5 degC if in hundredths of a degree'),
    ],
)
def test_a_wrong_unit_is_named(value, text):
    bench = bench_of()
    feed(bench, 5, lambda time: np.array([value, 30.0 + time / 1000]))
    assert text in bench.health()


def test_what_fits_no_unit_is_named_by_none():
    bench = bench_of()
    feed(bench, 5, lambda time: np.array([-100.0 + time / 1000, 30.0 + time / 1000]))
    assert 'T1 out_of_range' in bench.health()
    assert 'that is' not in bench.health()


def test_open_input_of_50_kelvin_is_found_at_once_and_for_good():
    bench = bench_of()
    feed(bench, 10, [22.0, 23.0])
    samples = feed(bench, 100, [72.0, 23.0], start=120.0)
    assert all(statuses(item) == [Status.RATE, Status.OK] for item in samples)
    assert 'T1 rate' in bench.health()


def test_sensor_that_comes_back_is_trusted_again():
    bench = bench_of()
    feed(bench, 10, [22.0])
    feed(bench, 10, [72.0], start=120.0)
    samples = feed(bench, 10, [22.5], start=240.0)
    assert statuses(samples[-1]) == [Status.OK]


def test_fast_but_plausible_warming_is_no_error():
    """10 K/min is the limit; a spindle does 1."""
    bench = bench_of()
    samples = feed(bench, 50, lambda time: [20.0 + 5.0 / 60.0 * time])
    assert all(statuses(item) == [Status.OK] for item in samples)


def test_stuck_sensor_is_found_after_its_time():
    bench = bench_of()
    samples = feed(bench, 100, lambda time: [25.0, 20.0 + time / 1000])
    first_bad = next(item for item in samples if Status.STUCK in statuses(item))
    assert first_bad.stamp <= nanoseconds(600.0 + 2 * 60.0)
    assert statuses(samples[-1]) == [Status.STUCK, Status.OK]
    assert 'T1 stuck' in bench.health()
    good = feed(bench, 10, lambda time: [25.0 + time / 1e6, 20.0 + time / 1000], start=1200.0)
    assert statuses(good[-1]) == [Status.OK, Status.OK]


def test_stuck_check_can_be_switched_off():
    bench = bench_of(stuck_time=0.0)
    samples = feed(bench, 200, lambda time: [25.0])
    assert all(statuses(item) == [Status.OK] for item in samples)


def test_after_a_long_gap_any_plausible_value_is_news():
    """The machine was off over night; its temperatures have moved on."""
    bench = bench_of()
    feed(bench, 10, [45.0])
    samples = feed(bench, 10, [21.0], start=10 * 3600.0)
    assert all(statuses(item) == [Status.OK] for item in samples)
    np.testing.assert_allclose([item.temperature[0] for item in samples], 21.0, atol=0.01)


def test_short_gap_gives_a_sample_of_what_there_is():
    bench = bench_of()
    feed(bench, 7, [20.0])
    (sample, *_) = feed(bench, 5, [20.0], start=144.0)
    assert sample.stamp == 156 * SECOND
    assert sample.readings == 3


def test_duplicate_names_are_refused_by_name():
    bench = bench_of()
    bench.give('sensor_readings', readings(12.0, [1.0, 2.0, 3.0], ('T1', 'T2', 'T1')))
    assert bench.emitted == []
    assert 'ERROR readings: duplicate sensor names: T1' in bench.health()


@pytest.mark.parametrize('names', [('T1', 'T3'), ('T1',), ('T2', 'T1')])
def test_sensors_that_change_during_a_run_are_refused(names):
    bench = bench_of()
    feed(bench, 5, [20.0, 21.0])
    before = len(bench.emitted)
    for number in range(6, 20):
        values = [20.0] * len(names)
        bench.give('sensor_readings', readings(12.0 * number, values, names))
    assert len(bench.emitted) == before
    assert 'sensors changed during the run' in bench.health()


def test_a_changed_order_is_named():
    bench = bench_of()
    bench.give('sensor_readings', readings(12.0, [1.0, 2.0, 3.0], ('T1', 'T2', 'T3')))
    bench.give('sensor_readings', readings(24.0, [1.0, 2.0, 3.0], ('T1', 'T3', 'T2')))
    assert 'in place 2 expected T2 but found T3; restart' in bench.health()


@pytest.mark.parametrize(
    ('told', 'verdict'),
    [
        (Status.MISSING, Status.MISSING),
        (Status.DRIFT, Status.DRIFT),
        (Status.STUCK, Status.STUCK),
        (77, Status.MISSING),
    ],
)
def test_what_the_publisher_says_against_a_reading_counts(told, verdict):
    """A gateway knows of a broken sensor what no value shows."""
    bench = bench_of()
    for number in range(1, 6):
        given = readings(PERIOD * number, [20.0 + 0.01 * number, 21.0 + 0.01 * number])
        bench.give('sensor_readings', replace(given, status=np.array([0, told], np.uint8)))
    (sample,) = bench.records('temperatures')
    assert statuses(sample) == [Status.OK, verdict]
    assert f'bad sensors: T2 {verdict.name.lower()}' in bench.health()


def test_our_own_verdict_is_the_more_exact_one():
    bench = bench_of()
    for number in range(1, 6):
        given = readings(PERIOD * number, [500.0, np.nan])
        status = np.array([Status.DRIFT, Status.DRIFT], np.uint8)
        bench.give('sensor_readings', replace(given, status=status))
    (sample,) = bench.records('temperatures')
    assert statuses(sample) == [Status.OUT_OF_RANGE, Status.MISSING]


def test_values_that_do_not_fit_the_names_are_refused():
    bench = bench_of()
    bench.give('sensor_readings', readings(12.0, [1.0], ('T1', 'T2')))
    bench.give('sensor_readings', readings(24.0, [], ()))
    assert bench.emitted == []
    assert 'ERROR readings: expected readings of sensors but found no sensor' in bench.health()
    feed(bench, 5, [20.0, 21.0], start=24.0)
    before = len(bench.emitted)
    bench.give('sensor_readings', readings(96.0, [1.0, 2.0, 3.0], ('T1', 'T2')))
    assert len(bench.emitted) == before
    refusal = bench.merger.counts['sensor_readings'].refusal
    assert refusal == 'temperature: expected 2 values, parallel to sensor, but found 3'


def cold_start(bench: Bench, time: float, count: int, temperature) -> None:
    """Report a cold start at `time`, then give readings."""
    cold = nanoseconds(time)
    bench.push('machine_state', machine_state(time + 1.0, cold_since=cold))
    feed(bench, count, temperature, start=time)


def test_reference_is_the_mean_of_the_first_samples_after_a_cold_start():
    bench = bench_of()
    start = 6 * 3600.0
    cold_start(bench, start, 40, lambda time: [20.0 + (time - start) / 1000.0, 30.0 + time / 1e6])
    (reference,) = bench.records('thermal_reference')
    samples = bench.records('temperatures')[:3]
    wanted = np.mean([item.temperature for item in samples], axis=0)
    np.testing.assert_allclose(reference.temperature, wanted)
    assert reference.samples == 3
    assert reference.stamp == samples[-1].stamp
    assert reference.cold_since == nanoseconds(start)
    assert reference.set_by == 'temperature_acquisition'
    assert reference.sensor == ('T1', 'T2')
    assert 'OK reference: set by temperature_acquisition' in bench.health()


def test_reference_comes_before_the_sample_that_completes_it():
    """So that the predictor knows it when that sample arrives."""
    bench = bench_of()
    cold_start(bench, 3600.0, 15, [20.0])
    names = [item.output for item in bench.emitted]
    assert names == ['temperatures', 'temperatures', 'thermal_reference', 'temperatures']


def test_bad_readings_do_not_enter_the_reference():
    bench = bench_of()
    start = 3600.0

    def temperature(time: float) -> list[float]:
        early = time <= start + 60.0
        return [np.nan if early else 22.0 + time / 1e6, np.nan, 21.0 + time / 1e6]

    cold_start(bench, start, 20, temperature)
    (reference,) = bench.records('thermal_reference')
    assert reference.temperature[0] == pytest.approx(22.0, abs=0.01)
    assert np.isnan(reference.temperature[1])
    assert reference.temperature[2] == pytest.approx(21.0, abs=0.01)


def test_machine_that_has_been_warming_up_unseen_gets_no_reference():
    bench = bench_of()
    bench.push('machine_state', machine_state(7201.0, cold_since=nanoseconds(3600.0)))
    feed(bench, 40, [35.0], start=7200.0)
    assert bench.records('thermal_reference') == []
    assert 'WARN reference: no thermal reference; start from a cold machine' in bench.health()


def test_machine_that_does_not_know_its_cold_start_gets_no_reference():
    bench = bench_of()
    bench.push('machine_state', machine_state(1.0, cold_since=0))
    feed(bench, 40, [20.0])
    assert bench.records('thermal_reference') == []


def test_every_cold_start_gets_its_own_reference():
    bench = bench_of()
    for day, value in enumerate((20.0, 24.0)):
        cold_start(bench, 86400.0 * (1 + day), 30, [value])
    references = bench.records('thermal_reference')
    assert [round(item.temperature[0]) for item in references] == [20, 24]
    assert [item.cold_since // SECOND for item in references] == [86400, 172800]


def test_restart_beside_a_warm_machine_keeps_the_reference():
    bench = bench_of()
    cold_start(bench, 3600.0, 30, [20.0])
    (reference,) = bench.records('thermal_reference')
    again = bench_of()
    again.component.restore('thermal_reference', reference)
    again.push('machine_state', machine_state(4201.0, cold_since=nanoseconds(3600.0)))
    feed(again, 40, [40.0], start=4200.0)
    assert again.records('thermal_reference') == []
    assert 'OK reference: set by temperature_acquisition at 3780 s' in again.health()
    cold_start(again, 90000.0, 30, [21.0])
    assert len(again.records('thermal_reference')) == 1


def test_restart_without_the_old_reference_does_not_guess_one():
    bench = bench_of()
    bench.push('machine_state', machine_state(4201.0, cold_since=nanoseconds(3600.0)))
    feed(bench, 40, [40.0], start=4200.0)
    assert bench.records('thermal_reference') == []


def test_a_short_interval_does_not_make_the_samples_after_a_request_late():
    bench = bench_of(interval=1.0)
    feed(bench, 30, [22.0])
    assert bench.request('set_thermal_reference', set_by='operator').success
    feed(bench, 3, [23.0], start=362.0)
    (reference,) = bench.records('thermal_reference')
    assert reference.temperature == pytest.approx([23.0], abs=0.01)


def test_operator_can_declare_the_machine_at_rest():
    bench = bench_of(reference_samples=2)
    feed(bench, 30, [22.0])
    answer = bench.request('set_thermal_reference', set_by='operator')
    assert answer.success
    assert answer.message == 'the next 2 samples become the thermal reference'
    feed(bench, 10, [23.0], start=360.0)
    (reference,) = bench.records('thermal_reference')
    assert reference.set_by == 'operator'
    assert reference.samples == 2
    assert reference.temperature[0] == pytest.approx(23.0, abs=0.01)


def compensated(offset=(-13.7e-6, 0.0)) -> Bench:
    """Return an acquisition with a reference of 22 degC beside a machine with offsets [m]."""
    bench = bench_of(reference_samples=2)
    feed(bench, 30, [22.0])
    assert bench.request('set_thermal_reference', set_by='anna', force=False).success
    feed(bench, 10, [22.0], start=360.0)
    bench.push('compensation_applied', applied(481.0, offset))
    feed(bench, 5, [30.0], start=480.0)
    return bench


def test_a_reference_over_offsets_is_refused_however_often_it_is_asked_for():
    bench = compensated()
    for number in range(50):
        answer = bench.request('set_thermal_reference', set_by='bob', force=False)
        assert not answer.success
        feed(bench, 10, [30.0], start=540.0 + 120.0 * number)
    assert 'Y -13.70 um are in force' in answer.message
    assert 'deactivate the compensator' in answer.message
    (reference,) = bench.records('thermal_reference')
    assert reference.set_by == 'anna'
    assert 'forced' not in bench.health()


def test_a_forced_reference_over_offsets_says_what_becomes_of_them_until_they_are_zero():
    bench = compensated()
    answer = bench.request('set_thermal_reference', set_by='bob', force=True)
    assert answer.success
    assert answer.message == (
        'the next 2 samples become the thermal reference although Y -13.70 um are in force: '
        'these go to what the rises against the new reference say, which begin at zero'
    )
    told = 'WARN forced reference: reference forced by bob while offsets are in force, now Y '
    assert told + '-13.70 um' in bench.health()
    bench.push('compensation_applied', applied(550.0, (-6e-6, 0.0)))
    feed(bench, 10, [30.0], start=540.0)
    assert bench.records('thermal_reference')[-1].set_by == 'bob'
    assert told + '-6.00 um' in bench.health()
    bench.push('compensation_applied', applied(670.0))
    feed(bench, 5, [30.0], start=660.0)
    bench.push('compensation_applied', applied(730.0, (1e-6, 0.0)))
    feed(bench, 5, [30.0], start=720.0)
    assert 'forced' not in bench.health()


def test_a_cold_start_ends_the_warning_of_a_forced_reference():
    bench = compensated()
    assert bench.request('set_thermal_reference', set_by='bob', force=True).success
    bench.push('machine_state', machine_state(601.0, cold_since=nanoseconds(600.0)))
    feed(bench, 5, [30.0], start=600.0)
    assert 'forced' not in bench.health()


@pytest.mark.parametrize('offset', [(0.0, 0.0), (-0.9e-8, 0.9e-8)])
def test_a_reference_over_offsets_at_zero_needs_no_force(offset):
    bench = compensated(offset)
    answer = bench.request('set_thermal_reference', set_by='bob', force=False)
    assert answer.success
    assert answer.message == 'the next 2 samples become the thermal reference'


def test_an_offset_that_is_not_told_as_a_number_may_be_in_force():
    answer = compensated((np.nan, 0.0)).request('set_thermal_reference', force=False)
    assert not answer.success


def test_a_request_of_a_recording_from_before_there_was_force_is_repeated():
    bench = compensated()
    assert bench.request('set_thermal_reference', set_by='bob').success


def test_unknown_request_is_refused():
    answer = bench_of().request('calibrate')
    assert not answer.success
    assert 'temperature_acquisition knows no request calibrate' in answer.message


def test_range_must_not_be_empty():
    with pytest.raises(ValueError, match=r'range_low = 50\.0 degC must lie below'):
        bench_of(range_low=50.0, range_high=40.0)


def test_nothing_is_emitted_between_samples():
    bench = bench_of()
    assert feed(bench, 4, [20.0]) == []
    assert bench.emitted == []


def test_a_cold_start_in_the_future_is_not_believed():
    """Its reference would be taken warm, and no true cold start would replace it for years."""
    bench = bench_of()
    bench.push('machine_state', machine_state(1.0, cold_since=nanoseconds(1e9)))
    feed(bench, 40, [35.0, 36.0], start=1.0)
    assert not bench.records('thermal_reference')
    cold_start(bench, 3600.0, 40, [20.0, 21.0])
    (reference,) = bench.records('thermal_reference')
    assert reference.cold_since == nanoseconds(3600.0)


def test_an_infinite_reading_is_none():
    bench = bench_of()
    feed(bench, 12, [np.inf, 21.0], start=12.0)
    newest = bench.records('temperatures')[-1]
    assert np.isnan(newest.temperature[0])
    assert newest.status.tolist() == [Status.MISSING, Status.OK]


@pytest.mark.parametrize('tiny', [2.4e-41, -5e-324, 9e-7])
def test_next_to_nothing_is_no_reading(tiny):
    bench = bench_of()
    sample = feed(bench, 5, lambda k: np.array([20.0, tiny, 21.0]))[-1]
    assert statuses(sample) == [Status.OK, Status.MISSING, Status.OK]
    (line,) = [item for item in bench.component.health() if item.name == 'sensors']
    assert 'which no sensor does' in line.message


def test_zero_is_a_reading_of_a_sensor_that_has_read_something_else():
    bench = bench_of()
    first = feed(bench, 5, lambda k: np.array([20.0, 0.0, 0.5]))[-1]
    assert statuses(first) == [Status.OK, Status.MISSING, Status.OK]
    (line,) = [item for item in bench.component.health() if item.name == 'sensors']
    assert 'missing (has read 0 since the start)' in line.message
    second = feed(bench, 5, lambda k: np.array([20.0, 0.25, 0.0]), start=60.0)[-1]
    assert statuses(second) == [Status.OK, Status.OK, Status.OK]


def heated(time):
    """Return a spindle at rest and a bed that warms by 35 K/min to 140 degC."""
    bed = 25.0 + 35.0 / 60.0 * np.clip(time - 60.0, 0.0, 200.0) + 1e-4 * time
    return np.array([20.0 + 1e-4 * time, bed])


def test_a_heated_bed_has_limits_of_its_own():
    usual = feed(bench_of(), 24, heated)
    assert statuses(usual[-1]) == [Status.OK, Status.OUT_OF_RANGE]
    assert Status.RATE in {statuses(sample)[1] for sample in usual}
    own = bench_of(sensor_limits=('T2:rate_max:0.6', 'T*:range_high:150'))
    for sample in feed(own, 24, heated):
        assert statuses(sample) == [Status.OK, Status.OK]
    # Its limits are no licence: what is faster, or hotter, is still refused, and others as before.
    wild = feed(own, 7, lambda time: np.array([60.0, 151.0 + 1e-3 * time]), start=288.0)[-1]
    assert statuses(wild) == [Status.RATE, Status.OUT_OF_RANGE]


def test_a_bed_that_is_read_once_a_minute_may_warm_for_a_minute():
    bench = bench_of(sensor_limits=('T1:rate_max:0.6',))
    for minute in range(1, 4):
        bench.give('sensor_readings', readings(60.0 * minute, [20.0 + 35.0 * (minute - 1)]))
    assert [statuses(sample) for sample in bench.records('temperatures')] == [[Status.OK]] * 3


@pytest.mark.parametrize(
    'text',
    ['T1', 'T1:rate_max', 'T1:rate_max:fast', 'T1:speed:1', ':noise_band:1', 'T1:rate_max:nan'],
)
def test_limits_that_are_none_are_refused(text):
    with pytest.raises(ValueError, match='sensor_limits: expected SENSOR:LIMIT:VALUE'):
        bench_of(sensor_limits=(text,))
