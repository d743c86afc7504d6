# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Offline evaluation against real time, and one step of the thermal predictor.

Writes a bag of one hour with 76 sensors and 2 displacement channels at 10 Hz, then reads it and
judges every candidate of a model on it, as `fuzzycnc evaluate` does; what counts is how many
times faster than the machine that is (at least 500).  Then steps the predictor component through
a shift, in microseconds a sample (below 100).
Run with `python benchmarks/bench_evaluate.py`; it needs rosbags, mcap and zstandard.
"""

import os

# One thread, set before numpy starts its pool: a shop-floor computer has other work to do.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.core.thermal.fit import evaluate, train_model
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.runtime.component import Component
from fuzzycnc_ros.runtime.merge import Merger
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Displacement,
    Record,
    Temperatures,
    ThermalReference,
)
from fuzzycnc_ros.simulation.thermal.duties import record_run
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration

RATE, DURATION = 10, 3600
REPEATS = 5
REAL_TIME_RATIO_MIN = 500.0
STEP_MAX = 100e-6


def records(run: ThermalRun) -> list[tuple[str, Record]]:
    """Return the first hour of a run, sampled anew at 10 Hz."""
    rng = np.random.default_rng(0)
    time = np.arange(1, RATE * DURATION + 1) / RATE
    temperature = resampled(run.time, run.temperature, time)
    displacement = resampled(run.time, run.displacement, time)
    temperature += rng.normal(0.0, 0.1, temperature.shape)
    found: list[tuple[str, Record]] = []
    for second, sample, moved in zip(time, temperature, displacement, strict=True):
        stamp = round(second * SECOND)
        found.append(('displacement', measured(run, stamp, moved)))
        found.append(('temperatures', temperatures(run, stamp, sample)))
    return found


def resampled(time: Any, values: Any, wanted: Any) -> Any:
    """Return the columns of values at other times."""
    return np.stack([np.interp(wanted, time, column) for column in values.T], axis=1)


def temperatures(run: ThermalRun, stamp: int, values: Any) -> Temperatures:
    """Return one sample of all sensors."""
    return Temperatures(
        stamp=stamp,
        frame_id='mill/machine',
        sensor=run.sensor,
        temperature=values,
        status=np.zeros(len(values), np.uint8),
        readings=1,
    )


def measured(run: ThermalRun, stamp: int, values: Any) -> Displacement:
    """Return one measurement of the displacement."""
    return Displacement(
        stamp=stamp,
        frame_id='mill/workpiece',
        axis=run.axis,
        channel=run.channel,
        displacement=values,
        standard_deviation=np.full(len(values), 3e-7),
        includes_compensation=False,
    )


def timed(task: Callable[[], Any]) -> tuple[float, Any]:
    """Return the wall time of a task [s] and its result."""
    begin = perf_counter()
    result = task()
    return perf_counter() - begin, result


def steps(component: Component, samples: Sequence[Temperatures]) -> list[float]:
    """Return the time of each sample's way through the merge and the component [s]."""
    merger = Merger(component)
    found = []
    for sample in samples:
        begin = perf_counter()
        merger.push('temperatures', sample)
        emitted = merger.advance(sample.stamp)
        found.append(perf_counter() - begin)
        assert emitted[0].output == 'thermal_error'
    return found


def step_times(model: ThermalModel, run: ThermalRun) -> list[float]:
    """Return the time of each step through a shift [s]."""
    predictor = ThermalPredictor()
    predictor.use_model(model.to_json())
    samples = [
        temperatures(run, round((60.0 + second) * SECOND), values)
        for second, values in zip(run.time, run.temperature, strict=True)
    ]
    reference = ThermalReference(
        stamp=samples[0].stamp,
        frame_id='mill/machine',
        cold_since=1,
        set_by='benchmark',
        sensor=run.sensor,
        temperature=run.reference(),
        samples=3,
    )
    predictor.on_thermal_reference(reference)
    return steps(predictor, samples)


def main() -> None:
    """Print both figures."""
    model = train_model(record_calibration().runs)
    shift = record_run('T2')
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'hour'
        with PublishedBag(path) as bag:
            for topic, record in records(shift):
                bag(topic, record)
        reading, run = timed(lambda: read_run(path))
        judging, result = timed(lambda: evaluate(model, run))
    ratio = DURATION / (reading + judging)
    print(f'one hour of {len(run.sensor)} sensors at {RATE} Hz: {len(run.time)} samples')
    print(f'  reading    {reading:6.2f} s')
    print(f'  evaluating {judging:6.2f} s, {result.samples} samples at the model interval')
    print(f'  {ratio:.0f} times real time (at least {REAL_TIME_RATIO_MIN:.0f} expected)')
    times = [time for _ in range(REPEATS) for time in step_times(model, shift)]
    middle = median(times)
    print(f'one step of thermal_predictor, {len(model.inputs)} inputs, {model.default}:')
    print(
        f'  median {1e6 * middle:.1f} us, 99 % below {1e6 * np.quantile(times, 0.99):.1f} us '
        f'(below {1e6 * STEP_MAX:.0f} us expected)'
    )
    if ratio < REAL_TIME_RATIO_MIN or middle >= STEP_MAX:
        raise SystemExit('a figure was missed')


if __name__ == '__main__':
    main()
