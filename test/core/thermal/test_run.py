# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.thermal.fit.training_runs import check_rise, check_training_runs
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun, counted
from fuzzycnc_ros.core.thermal.sensor_limits import SensorLimits


def make(samples=20, interval=60.0, **changes):
    time = interval * np.arange(samples)
    fields = {
        'name': 'run',
        'time': time,
        'sensor': ('T1', 'T2'),
        'temperature': 20.0 + np.column_stack([time, 2.0 * time]) / 1000.0,
        'channel': ('Y', 'Z'),
        'axis': ('Y', 'Z'),
        'displacement': np.column_stack([time, -time]) * 1e-9,
    }
    return ThermalRun(**{**fields, **changes})


def with_value(values, row, column, value):
    changed = np.array(values)
    changed[row, column] = value
    return changed


def test_rise_is_against_the_mean_of_the_first_three_samples():
    run = make()
    assert np.allclose(run.rise()[:3].mean(axis=0), 0.0)
    assert np.allclose(run.rise([20.0, 20.0])[10], [0.6, 1.2])
    with pytest.raises(ThermalDataError, match='reference: expected 2'):
        run.rise([20.0])


def test_arrays_are_copies_that_nobody_can_change():
    temperature = np.full((20, 2), 20.0)
    run = make(temperature=temperature)
    temperature[:] = 99.0
    assert run.temperature.max() == 20.0
    with pytest.raises(ValueError, match='read-only'):
        run.time[0] = 1.0


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'time': np.arange(19.0)}, 'temperature of shape'),
        ({'time': np.zeros((20, 1))}, 'expected time of shape'),
        ({'time': np.zeros(20)}, 'increasing times, but found 0 s after 0 s at sample 1'),
        ({'time': np.where(np.arange(20) == 4, np.nan, np.arange(20.0))}, 'nan at sample 4'),
        ({'sensor': ('T1', 'T1')}, 'sensor once, but found T1 more than once'),
        ({'channel': ('Y', 'Y')}, 'channel once, but found Y'),
        ({'axis': ('Y',)}, 'one axis per channel'),
        ({'temperature': with_value(make().temperature, 3, 1, 121.0)}, "121 of sensor 'T2'"),
        ({'temperature': with_value(make().temperature, 3, 1, np.inf)}, "inf of sensor 'T2'"),
        ({'displacement': with_value(make().displacement, 5, 0, 0.0128)}, '12800 µm.*mixed up'),
    ],
)
def test_refusals_say_what_and_where(changes, message):
    with pytest.raises(ThermalDataError, match=message):
        make(**changes)


def test_too_few_samples_are_refused():
    with pytest.raises(ThermalDataError, match='at least 8 samples, but found 7'):
        make(samples=7)
    with pytest.raises(ThermalDataError, match='at least 8 samples'):
        make().window(0.0, 300.0)


def test_missing_readings_and_probes_are_kept():
    run = make(
        temperature=with_value(make().temperature, 3, 1, np.nan),
        displacement=with_value(make().displacement, 4, 0, np.nan),
    )
    assert np.isnan(run.temperature[3, 1])
    assert np.isnan(run.displacement[4, 0])


def test_uneven_sampling_is_refused_until_resampled():
    time = 60.0 * np.arange(20)
    time[7] += 20.0
    run = make(time=time)
    with pytest.raises(ThermalDataError, match=r'step of 80 s after sample 6.*resample'):
        _ = run.interval
    assert run.resample(60.0).interval == pytest.approx(60.0)


@settings(deadline=None)
@given(block=st.integers(1, 6), samples=st.integers(60, 90))
def test_resampling_takes_block_means_stamped_at_their_end(block, samples):
    run = make(samples=samples, interval=10.0)
    slow = run.resample(10.0 * block)
    count = samples // block
    means = run.temperature[: count * block].reshape(count, block, 2).mean(axis=1)
    assert np.allclose(slow.temperature, means)
    assert np.allclose(slow.time, run.time[block - 1 : count * block : block])
    assert slow.interval == pytest.approx(10.0 * block)


def test_resampling_uneven_readings_keeps_a_straight_line_straight():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(5.0, 15.0, 400))
    run = make(
        time=time,
        temperature=20.0 + np.column_stack([time, 2.0 * time]) / 1000.0,
        displacement=np.column_stack([time, -time]) * 1e-9,
    )
    even = run.resample(60.0)
    slope = np.diff(even.temperature[:, 0]) / np.diff(even.time)
    assert np.allclose(slope, 1e-3)
    assert even.interval == pytest.approx(60.0)


@pytest.mark.parametrize('jitter', [0.0, 0.3])
def test_sparse_probing_survives_resampling(jitter):
    time = 15.0 * np.arange(200) + jitter * 15.0 * (np.arange(200) % 2)
    displacement = np.full((200, 2), np.nan)
    displacement[::40] = 1e-6
    run = make(time=time, temperature=np.full((200, 2), 20.0), displacement=displacement)
    slow = run.resample(60.0)
    assert np.isfinite(slow.displacement).all(axis=1).sum() == 5
    assert np.nanmax(np.abs(slow.displacement - 1e-6)) < 1e-15


@pytest.mark.parametrize('interval', [0.0, -1.0, np.nan, 1e9, 1e-9])
def test_bad_intervals_are_refused(interval):
    with pytest.raises(ThermalDataError, match='expected'):
        make().resample(interval)


def holed(samples, hole):
    """Return a run without any sample for some time after the hundredth."""
    time = 15.0 * np.arange(samples)
    time[100:] += hole
    flat = np.full((samples, 2), 20.0)
    return make(time=time, temperature=flat, displacement=np.zeros((samples, 2)))


def test_long_gaps_are_not_bridged():
    with pytest.raises(ThermalDataError, match=r'at most 1260 s, .* 3615 s .*, up to 1485 s$'):
        holed(200, 3600.0).resample(60.0)
    assert holed(200, 3600.0).window(stop=1485.0).resample(60.0).interval == 60.0


def test_a_window_long_behind_a_gap_is_offered_and_taken():
    run = holed(2000, 3600.0)
    with pytest.raises(
        ThermalDataError, match='or use what comes 4 h behind it, from 19500 s'
    ) as e:
        run.resample(60.0)
    assert 'up to 1485 s' in str(e.value)
    assert counted(run, start=19500.0).resample(60.0).interval == 60.0
    with pytest.raises(ThermalDataError, match='expected gaps of at most'):
        counted(run, start=19400.0).resample(60.0)
    with pytest.raises(ThermalDataError, match=r'up to 1485 s$'):
        counted(holed(2000, 1e9), start=1e9 + 19500.0).resample(60.0)


def lacking(rows, column=1, samples=60):
    """Return a run whose sensor T2 lacks some samples."""
    temperature = np.array(make(samples=samples).temperature)
    temperature[rows, column] = np.nan
    return make(samples=samples, temperature=temperature)


@pytest.mark.parametrize('rows', [slice(9, 10), slice(10, 30), [5, 7, 8, 9, 40]])
def test_short_gaps_are_bridged_by_a_straight_line(rows):
    whole, run = make(samples=60), lacking(rows)
    filled = run.bridged()
    assert np.allclose(filled.temperature, whole.temperature, rtol=0.0, atol=1e-12)
    assert np.array_equal(filled.temperature[:, 0], whole.temperature[:, 0])
    assert np.allclose(run.resample(60.0).temperature, whole.temperature, rtol=0.0, atol=1e-12)
    assert whole.bridged() is whole


def test_a_gap_as_long_as_the_predictor_bridges_is_the_longest():
    """`gap_max` is 1200 s: 20 samples of a minute; the reading behind is a sample later."""
    longest, too_long = lacking(slice(10, 30)), lacking(slice(10, 31))
    assert not longest.bridged().gaps()
    assert too_long.gaps() == (('T2', 21, 540.0, 1860.0),)
    assert np.isnan(too_long.bridged().temperature[:, 1]).sum() == 21


def test_the_reference_is_the_mean_of_what_was_read():
    run = lacking([0, 2])
    assert run.reference()[1] == run.temperature[1, 1]
    filled = run.bridged()
    assert filled.reference()[1] == pytest.approx(run.temperature[1, 1], abs=1e-12)
    assert filled.temperature[0, 1] == filled.temperature[2, 1] == run.temperature[1, 1]
    never = lacking([0, 1, 2, 9]).bridged()
    assert np.isnan(never.reference()[1])
    assert np.isnan(never.temperature[:, 1]).sum() == 4


def test_the_last_reading_is_held():
    run = lacking(slice(50, 60))
    assert (run.bridged().temperature[50:, 1] == run.temperature[49, 1]).all()
    assert np.isnan(lacking(slice(30, 60)).bridged().temperature[:, 1]).sum() == 30


def test_a_sample_is_the_mean_of_more_than_half_of_its_readings():
    time = 15.0 * np.arange(80)
    temperature = 20.0 + np.column_stack([time, time]) / 100.0
    temperature[[4, 8, 9], 1] = np.nan
    run = make(80, 15.0, temperature=temperature, displacement=np.zeros((80, 2)))
    slow = run.averaged(60.0)
    assert slow.temperature[1, 1] == pytest.approx(temperature[5:8, 1].mean())
    assert np.isnan(slow.temperature[2, 1])
    assert [gap.samples for gap in slow.gaps()] == [1]


def test_a_refusal_of_long_gaps_offers_the_longest_window_of_all_runs():
    one, other = lacking(slice(20, 45), 1, 400), lacking(slice(5, 26), 0, 400)
    with pytest.raises(ThermalDataError) as caught:
        check_training_runs([one.bridged(), replace(other, name='other').bridged()])
    text = str(caught.value)
    assert "T2 of run 'run' from 1140 to 2700 s, T1 of run 'other' from 240 to 1560 s" in text
    # The lags know again where the machine stands four hours behind the gap.
    assert text.endswith('; use the part with all readings from 17100 s')
    with pytest.raises(ThermalDataError, match='leave T2 out, or use the part'):
        check_training_runs([one.bridged()])
    with pytest.raises(ThermalDataError, match='; record anew'):
        check_training_runs([lacking(slice(5, 56), [0, 1])])


def test_a_long_gap_long_before_the_first_displacement_is_no_reason_to_refuse():
    run = lacking(slice(20, 45), 1, 400)
    later, soon = counted(run, start=17100.0), counted(run, start=17040.0)
    check_training_runs([later.bridged()])
    whole = make(samples=400).temperature
    assert np.allclose(later.bridged().temperature, whole, rtol=0.0, atol=1e-12)
    with pytest.raises(ThermalDataError, match='from 1140 to 2700 s'):
        check_training_runs([soon.bridged()])


def test_window_is_inclusive():
    run = make().window(60.0, 600.0)
    assert run.time[0] == 60.0
    assert run.time[-1] == 600.0


def test_missing_sensors_are_named():
    with pytest.raises(ThermalDataError, match=r'no T9; the run has T1, T2'):
        make().columns(['T1', 'T9'])
    assert make().columns(['T2', 'T1']).tolist() == [1, 0]


@pytest.mark.parametrize(
    ('others', 'message'),
    [
        ([], 'at least one run'),
        ([make(), make()], 'each name once'),
        ([make(), make(name='b', sensor=('T1', 'T3'))], 'sensor T1, T2 as in run'),
        ([make(), make(name='b', interval=30.0)], '60 s of run'),
        (
            [
                make(
                    sensor=tuple(f'T{k}' for k in range(501)),
                    temperature=np.zeros((20, 501)),
                )
            ],
            'at most 500 sensors, but found 501',
        ),
        ([make(temperature=np.full((20, 2), 20.0))], 'warms by 0.5 K'),
        ([make(temperature=with_value(make().temperature, 3, 1, np.nan))], 'none of T2 of run'),
        ([make(temperature=with_value(make().temperature, 9, 0, 40.0))], "'T1' at sample"),
        ([make(displacement=np.full((20, 2), np.nan))], "channel 'Y'"),
    ],
)
def test_runs_that_teach_nothing_are_refused(others, message):
    with pytest.raises(ThermalDataError, match=message):
        check_training_runs(others)


@pytest.mark.parametrize('interval', [0.7, 7.0, 9.1, 60.0, 90.0])
@pytest.mark.parametrize('limit', [(), ('*:rate_max:0.7',)])
def test_a_rise_at_its_limit_passes_at_any_interval(interval, limit):
    minute = max(1, round(60.0 / interval))
    fastest = (42.0 if limit else 10.0) * minute * interval / 60.0
    for share, passes in ((1.0 - 1e-12, True), (1.001, False)):
        step = np.repeat([0.0, share * fastest], minute + 4)
        run = make(
            len(step),
            interval,
            temperature=np.column_stack([step, step]),
            limits=SensorLimits.of(('*:range_high:1000', *limit)),
        )
        if passes:
            check_rise(run)
        else:
            with pytest.raises(ThermalDataError, match='K per minute'):
                check_rise(run)
