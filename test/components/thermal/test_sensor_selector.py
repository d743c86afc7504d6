# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sensor selector: selects when it is asked to, from what it was given, and says why not."""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benches.component_bench import Bench

from fuzzycnc_ros.components.thermal import kept_samples
from fuzzycnc_ros.components.thermal.sensor_selector import SensorSelector, SensorSelectorConfig
from fuzzycnc_ros.core.thermal.fit import select_sensors
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun
from fuzzycnc_ros.core.thermal.sensor_limits import SensorLimits
from fuzzycnc_ros.runtime.records import (
    Displacement,
    Temperatures,
    nanoseconds,
)
from fuzzycnc_ros.simulation.thermal.duties import record_runs


@cache
def recordings() -> dict[str, ThermalRun]:
    """Return calibration runs by name."""
    return record_runs(('D0', 'D0b', 'T1'), seed=0)


def bench_with_bags(**changes) -> Bench:
    """Return a selector that finds the recordings by name."""
    selector = SensorSelector(SensorSelectorConfig(**changes))

    def read(name: str, *, sensor_limits: Sequence[str]) -> ThermalRun:
        if name not in recordings():
            raise ThermalDataError(f'bag {name}: not found')
        return recordings()[name]

    selector.run_reader = read
    return Bench(selector)


def give_run(bench: Bench, run: ThermalRun, rows: int, begin: float = 3600.0) -> None:
    """Give samples and displacements of the same stamps."""
    for row in range(rows):
        stamp = nanoseconds(begin + run.time[row])
        bench.push(
            'displacement',
            Displacement(
                stamp=stamp,
                frame_id='mill/workpiece',
                axis=run.axis,
                channel=run.channel,
                displacement=run.displacement[row],
                standard_deviation=np.full(2, 0.3e-6),
                includes_compensation=False,
            ),
        )
        bench.give(
            'temperatures',
            Temperatures(
                stamp=stamp,
                frame_id='mill/machine',
                sensor=run.sensor,
                temperature=run.temperature[row],
                status=np.zeros(len(run.sensor), np.uint8),
                readings=5,
            ),
        )


def test_nothing_happens_until_it_is_asked_for():
    bench = bench_with_bags()
    give_run(bench, recordings()['D0'], 100)
    assert bench.emitted == []
    assert 'OK selection: nothing selected yet; call select_sensors' in bench.health()


def test_selects_from_the_bags_that_are_named():
    bench = bench_with_bags()
    answer = bench.request('select_sensors', bag=['D0', 'D0b', 'T1'], clusters=0)
    assert answer.success, answer.message
    (selection,) = bench.records('sensor_selection')
    direct = select_sensors(list(recordings().values()), n_clusters=5)
    assert tuple(item.chosen for item in selection.cluster) == direct.chosen
    assert selection.calibration == ('D0', 'D0b', 'T1')
    assert selection.method == 'correlation'
    assert selection.frame_id == 'mill/machine'
    assert answer.message.startswith(', '.join(direct.chosen))
    assert f'selected {", ".join(direct.chosen)}' in bench.health()


def test_every_sensor_is_in_one_cluster_and_mates_are_of_the_same():
    bench = bench_with_bags()
    bench.request('select_sensors', bag=['D0'], clusters=4)
    (selection,) = bench.records('sensor_selection')
    assert len(selection.cluster) == 4
    members = [name for cluster in selection.cluster for name in cluster.member]
    assert sorted([*members, *selection.dropped]) == sorted(recordings()['D0'].sensor)
    for cluster in selection.cluster:
        assert cluster.chosen in cluster.member
        assert cluster.chosen not in cluster.substitute
        assert set(cluster.substitute) <= set(cluster.member)
        assert len(cluster.score) == len(cluster.member)
        assert len(cluster.gain) == len(cluster.correlation) == len(cluster.substitute)
        assert ((cluster.score >= 0) & (cluster.score <= 1)).all()
        assert (np.abs(cluster.correlation) <= 1 + 1e-12).all()
        assert np.isfinite(cluster.gain).all()


def test_same_seed_same_selection():
    chosen = []
    for _ in range(2):
        bench = bench_with_bags(seed=4)
        bench.request('select_sensors', bag=['D0', 'T1'])
        chosen.append([item.chosen for item in bench.records('sensor_selection')[0].cluster])
    assert chosen[0] == chosen[1]


@pytest.mark.parametrize('ranking', ['correlation', 'grey_grade'])
def test_ranking_is_a_parameter(ranking):
    bench = bench_with_bags(ranking=ranking, refine=False)
    assert bench.request('select_sensors', bag=['D0']).success
    (selection,) = bench.records('sensor_selection')
    assert selection.method == ranking
    assert all(cluster.chosen == cluster.member[0] for cluster in selection.cluster)


def test_present_run_begins_anew_after_a_pause():
    """What was before, the machine has cooled down from; nor is it kept for ever."""
    asked = []
    for earlier in ((), ('T1',)):
        bench = bench_with_bags()
        for name in earlier:
            give_run(bench, recordings()[name], 201)
        give_run(bench, recordings()['D0'], 201, begin=4 * 86400.0)
        assert bench.request('select_sensors').success
        asked.append([item.chosen for item in bench.records('sensor_selection')[0].cluster])
    assert asked[0] == asked[1]


def test_present_run_can_be_selected_from():
    bench = bench_with_bags()
    give_run(bench, recordings()['D0'], 201)
    assert bench.request('select_sensors').success
    (selection,) = bench.records('sensor_selection')
    assert selection.calibration == ('present run',)
    direct = select_sensors([recordings()['D0']], n_clusters=5)
    assert tuple(item.chosen for item in selection.cluster) == direct.chosen


def test_samples_without_a_displacement_of_their_own_do_not_count():
    bench, run = bench_with_bags(), recordings()['D0']
    give_run(bench, run, 3)
    bench.give(
        'temperatures',
        Temperatures(
            stamp=nanoseconds(3600.0 + run.time[3]),
            sensor=run.sensor,
            temperature=run.temperature[3],
            status=np.zeros(len(run.sensor), np.uint8),
        ),
    )
    (item,) = bench.component.health()
    assert item.values == {'samples with displacement': '3'}


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({}, 'none named, and no temperatures with a displacement of the same stamp'),
        ({'bag': ['T9']}, 'bag T9: not found'),
        ({'bag': ['D0'], 'clusters': 200}, '200'),
    ],
)
def test_refusals_say_why(arguments, message):
    bench = bench_with_bags()
    answer = bench.request('select_sensors', **arguments)
    assert not answer.success
    assert message in answer.message
    assert bench.emitted == []


def test_sensors_have_limits_of_their_own_in_bags_too():
    hot = recordings()['D0']
    name, warm = hot.sensor[0], hot.temperature.copy()
    warm[:, 0] = warm[0, 0] + 40.0 * (warm[:, 0] - warm[0, 0])  # a heated bed among sensors

    def read(bag: str, *, sensor_limits: Sequence[str]) -> ThermalRun:
        return replace(hot, temperature=warm, limits=SensorLimits.of(sensor_limits))

    bench = bench_with_bags()
    bench.component.run_reader = read
    answer = bench.request('select_sensors', bag=['D0'])
    assert not answer.success
    needed = re.search(r"parameter sensor_limits: \['(.*?)'\]", answer.message)
    assert needed is not None, answer.message
    own = (f'{name}:range_high:2000', f'{name}:rate_max:1000')
    assert needed[1].rsplit(':', 1)[0] in {text.rsplit(':', 1)[0] for text in own}
    bench = bench_with_bags(sensor_limits=own)
    bench.component.run_reader = read
    assert bench.request('select_sensors', bag=['D0']).success
    with pytest.raises(ValueError, match='sensor_limits: expected'):
        SensorSelector(SensorSelectorConfig(sensor_limits=('bed:hot:7',)))


def test_host_without_bags_says_so():
    bench = Bench(SensorSelector())
    answer = bench.request('select_sensors', bag=['D0'])
    assert not answer.success
    assert 'this host cannot read bags; select from the present run' in answer.message


def test_failed_request_keeps_the_selection():
    bench = bench_with_bags()
    bench.request('select_sensors', bag=['D0'])
    before = bench.health()
    assert not bench.request('select_sensors', bag=['T9']).success
    assert bench.health() == before


def test_restart_restores_the_selection():
    bench = bench_with_bags()
    bench.request('select_sensors', bag=['D0'])
    again = bench_with_bags()
    again.component.restore('sensor_selection', bench.records('sensor_selection')[0])
    assert again.health() == bench.health()
    assert again.emitted == []


def test_a_run_of_too_many_samples_is_selected_from_as_a_whole(monkeypatch):
    monkeypatch.setattr(kept_samples, 'SAMPLES_MAX', 60)
    bench, run = bench_with_bags(), recordings()['T1']
    give_run(bench, run, 100)
    known = bench.component._present_run()
    assert len(known.time) <= 60
    np.testing.assert_allclose(known.time, run.time[0:100:2] - run.time[0], atol=1e-9)
    assert bench.request('select_sensors', bag=[], clusters=0).success
