# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The thermal components at work: compensator, acquisition, selector and predictor."""

import random
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from benches import predictor_bench
from benches.component_bench import Bench, applied, machine_state, readings, thermal_error
from fuzzing.targets import CopiedTarget, work

from fuzzycnc_ros.components.thermal.compensator import Compensator
from fuzzycnc_ros.components.thermal.sensor_selector import SensorSelector, SensorSelectorConfig
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisition
from fuzzycnc_ros.runtime.enums import CompensationState, Status
from fuzzycnc_ros.runtime.records import (
    SECOND,
    ProbeEvidence,
    SensorCluster,
    SensorSelection,
    SpindleSpeed,
    nanoseconds,
)


class CompensatorTarget(CopiedTarget):
    """A compensator that follows 3 um; half of the time one that has no read-back yet."""

    component = 'compensator'
    inputs = ('machine_state', 'compensation_applied', 'probe_evidence', 'thermal_error')
    step = 20 * SECOND

    def make(self) -> Bench:
        bench = Bench(Compensator())
        bench.until(900.0)
        assert bench.request('activate').success
        bench.push('machine_state', machine_state(900.0))
        return bench

    def bench(self) -> Bench:
        bench = super().bench()
        if len(bench.emitted) % 2 == 0:
            bench.push('compensation_applied', applied(910.0))
            bench.give('thermal_error', thermal_error(950.0, (3e-6, -3e-6)))
        return bench

    def good(self, name, stamp, rng):
        time = stamp / SECOND
        if name == 'machine_state':
            return replace(machine_state(time), stamp=stamp)
        if name == 'compensation_applied':
            return replace(applied(time), stamp=stamp)
        if name == 'probe_evidence':
            axes = ('Y', 'Z')
            return ProbeEvidence(stamp=stamp, axis=axes, channel=axes, evidence=np.zeros(2))
        return replace(thermal_error(time, (3e-6, -3e-6)), stamp=stamp)

    def recover(self, bench, stamp):
        for _ in range(40):
            stamp += 30 * SECOND
            for name in self.inputs:
                bench.push(name, self.good(name, stamp, random.Random(0)))
            work(bench, stamp)
        newest = bench.records('compensation')[-1]
        assert newest.state == CompensationState.ACTIVE, bench.health()
        np.testing.assert_allclose(newest.offset, [-3e-6, 3e-6], atol=1e-12)

    def check(self, bench):
        for item in bench.records('compensation'):
            assert (np.abs(item.offset) <= 50e-6).all(), item.offset


class AcquisitionTarget(CopiedTarget):
    """An acquisition that gets a reading of four sensors every 12 s."""

    component = 'temperature_acquisition'
    inputs = ('sensor_readings', 'machine_state', 'compensation_applied')
    step = 12 * SECOND
    start = 1200 * SECOND
    names = ('T1', 'T2', 'T3', 'T4')

    def make(self) -> Bench:
        bench = Bench(TemperatureAcquisition())
        for number in range(40):
            stamp = 600 * SECOND + number * self.step
            for name in self.inputs:
                bench.push(name, self.good(name, stamp, random.Random(number)))
            work(bench, stamp)
        assert bench.records('temperatures')
        return bench

    def good(self, name, stamp, rng):
        time = stamp / SECOND
        if name == 'machine_state':
            return replace(machine_state(time), stamp=stamp)
        if name == 'compensation_applied':
            return replace(applied(time, (2e-6, 0.0)), stamp=stamp)
        values = [20.0 + 0.1 * rng.random() + k for k in range(4)]
        return replace(readings(time, values), stamp=stamp)

    def recover(self, bench, stamp):
        rng = random.Random(1)
        stamp = (stamp // (60 * SECOND) + 20) * 60 * SECOND
        cold = stamp
        for _ in range(30):
            stamp += self.step
            bench.push('machine_state', machine_state(stamp / SECOND, cold_since=cold))
            bench.push('sensor_readings', self.good('sensor_readings', stamp, rng))
            work(bench, stamp)
        newest = bench.records('temperatures')[-1]
        assert newest.sensor == self.names
        assert (newest.status == Status.OK).all(), (newest, bench.health())
        np.testing.assert_allclose(newest.temperature, [20.0, 21.0, 22.0, 23.0], atol=0.1)
        assert bench.records('thermal_reference')[-1].cold_since == cold, bench.health()

    def check(self, bench):
        for item in bench.records('thermal_reference'):
            assert item.cold_since <= item.stamp, (item.cold_since, item.stamp)
        for item in bench.records('temperatures'):
            assert len(item.temperature) == len(item.status) == len(item.sensor)
            assert np.isfinite(item.temperature[item.status == Status.OK]).all()


class SelectorTarget(CopiedTarget):
    """A selector that has kept a run of thirty samples."""

    component = 'sensor_selector'
    inputs = ('displacement', 'temperatures')
    step = 60 * SECOND
    run = property(lambda self: predictor_bench.recordings()['D0'])

    def make(self) -> Bench:
        config = SensorSelectorConfig(clusters=2, refine=False)
        bench = Bench(SensorSelector(config))
        self.start = nanoseconds(predictor_bench.START + self.run.time[30])
        for row in range(30):
            bench.push('displacement', predictor_bench.probe_of(self.run, row))
            bench.give('temperatures', predictor_bench.sample_of(self.run, row))
        return bench

    def bench(self) -> Bench:
        bench = super().bench()
        bench.component.run_reader = lambda bag, sensor_limits: self.run
        return bench

    def good(self, name, stamp, rng):
        row = rng.randrange(30, 60)
        if name == 'displacement':
            return replace(predictor_bench.probe_of(self.run, row), stamp=stamp)
        return replace(predictor_bench.sample_of(self.run, row), stamp=stamp)

    def recover(self, bench, stamp):
        rng = random.Random(2)
        for name in self.inputs:
            bench.push(name, self.good(name, stamp, rng))
        work(bench, stamp)
        present = bench.request('select_sensors')
        assert present.success or present.message
        if rng.random() < 0.1:
            answer = bench.request('select_sensors', bag=['D0'])
            assert answer.success, answer.message


class PredictorTarget(CopiedTarget):
    """A predictor in the midst of a run; probes are for training only."""

    component = 'thermal_predictor'
    inputs = (
        'sensor_selection',
        'thermal_reference',
        'machine_state',
        'spindle_speed',
        'compensation_applied',
        'displacement',
        'temperatures',
    )
    step = 60 * SECOND
    run = property(lambda self: predictor_bench.recordings()['T1'])
    rows = 12
    learn = False

    def make(self) -> Bench:
        bench = predictor_bench.bench_with_model(learn=self.learn)
        predictor_bench.predict(bench, self.run, range(self.rows))
        self.start = bench.merger.time + self.step
        assert bench.records('thermal_error')[-1].valid
        return bench

    @cached_property
    def wanted(self) -> Any:
        """Errors at the beginning of the run."""
        bench = predictor_bench.bench_with_model()
        return predictor_bench.errors_of(
            predictor_bench.predict(bench, self.run, range(self.rows))[2:]
        )

    def good(self, name, stamp, rng):
        run, row, time = self.run, self.rows + rng.randrange(20), stamp / SECOND
        if name == 'sensor_selection':
            cluster = SensorCluster(
                member=run.sensor[:3],
                score=np.ones(3),
                chosen=run.sensor[0],
                substitute=run.sensor[1:3],
                gain=np.ones(2),
                correlation=np.ones(2),
            )
            return SensorSelection(
                stamp=stamp,
                method='correlation',
                cluster=(cluster,),
                partition_coefficient=0.9,
                xie_beni=0.1,
                dropped=(),
                calibration=('D0',),
            )
        if name == 'thermal_reference':
            cold = stamp - 4 * self.step
            return predictor_bench.reference_of(run, stamp=stamp, cold_since=cold)
        if name == 'machine_state':
            speed = rng.choice((100.0, np.nan))
            return replace(machine_state(time, spindle_speed=speed), stamp=stamp)
        if name == 'spindle_speed':
            return SpindleSpeed(stamp=stamp, speed=100.0, status=int(Status.OK))
        if name == 'compensation_applied':
            return replace(applied(time), stamp=stamp)
        if name == 'displacement':
            probe = predictor_bench.probe_of(run, row, includes_compensation=rng.random() < 0.5)
            return replace(probe, stamp=stamp)
        return replace(predictor_bench.sample_of(run, row), stamp=stamp)

    def recover(self, bench, stamp):
        stamp += 86_400 * SECOND
        cold = stamp
        found = []
        for row in range(self.rows):
            stamp += self.step
            if row == 2:
                reference = self.good('thermal_reference', stamp, random.Random(0))
                bench.push('thermal_reference', replace(reference, cold_since=cold))
            sample = replace(predictor_bench.sample_of(self.run, row), stamp=stamp)
            bench.push('temperatures', sample)
            work(bench, stamp)
            found.append(bench.records('thermal_error')[-1])
        assert found[-1].valid, bench.health()
        if not self.learn:
            errors = predictor_bench.errors_of(found[2:])
            np.testing.assert_allclose(errors, self.wanted, atol=1e-6)

    def check(self, bench):
        for item in bench.records('thermal_error'):
            if item.valid:
                assert np.isfinite(item.error).all()
                assert np.isfinite(item.standard_deviation).all()


class ProbingTarget(PredictorTarget):
    """A predictor that learns from probes; hostile ones that are plausible count as well."""

    inputs = ('compensation_applied', 'displacement', 'thermal_reference', 'temperatures')
    learn = True
