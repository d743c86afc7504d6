# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Drives the thermal predictor along recorded runs of the simulated mill."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from benches.component_bench import Bench
from kept import kept

from fuzzycnc_ros.components.thermal.thermal_predictor import (
    ThermalPredictor,
    ThermalPredictorConfig,
)
from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.model import ThermalModel, load_model
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import (
    Displacement,
    MachineState,
    Temperatures,
    ThermalError,
    ThermalReference,
    nanoseconds,
)
from fuzzycnc_ros.simulation.thermal.duties import record_runs

START = 6 * 3600.0
"""Machine time of the first sample [s]."""
MICRON = 1e-6
LINEAR = ('least_squares', 'stable_grey', 'lag_ridge')
"""Candidates that train in a moment."""


@cache
def recordings() -> dict[str, ThermalRun]:
    """Return the runs that are trained and judged on."""
    return {name: replace(run, spindle_speed=None) for name, run in record_runs(seed=0).items()}


@kept
def model_text(*names: str) -> str:
    """Return the file of a model of some runs, of three if none is named."""
    runs = [recordings()[name] for name in names or ('D0', 'D0b', 'T1')]
    # Which model is chosen is tested elsewhere.
    return train_model(runs, model='stable_grey', candidates=LINEAR).to_json()


@cache
def trained(*names: str) -> ThermalModel:
    """Return that model."""
    return load_model(model_text(*names))


def losing_text() -> str:
    """Return the file of a model that leaves 26.6 um of 9.4 um in Y on held-out samples."""
    model = trained()
    used, bare = (model.candidates[name] for name in (model.default[0], UNCOMPENSATED))
    worse = replace(used, held_out_rms=used.held_out_rms.copy())
    none = replace(bare, held_out_rms=bare.held_out_rms.copy())
    worse.held_out_rms[0], none.held_out_rms[0] = 26.6 * MICRON, 9.4 * MICRON
    changed = {model.default[0]: worse, UNCOMPENSATED: none}
    return replace(model, candidates={**model.candidates, **changed}).to_json()


def reference_of(run: ThermalRun, **changes: Any) -> ThermalReference:
    """Return the reference that the first three samples of a run give."""
    values: dict[str, Any] = {
        'stamp': nanoseconds(START + run.time[2]),
        'frame_id': 'mill/machine',
        'cold_since': nanoseconds(START - 1.0),
        'set_by': 'temperature_acquisition',
        'sensor': run.sensor,
        'temperature': run.temperature[:3].mean(axis=0),
        'samples': 3,
    }
    return ThermalReference(**(values | changes))


def sample_of(
    run: ThermalRun, row: int, bad: Iterable[str] = (), later: float = 0.0
) -> Temperatures:
    """Return one sample of a run; `bad` sensors are missing."""
    temperature = run.temperature[row].copy()
    status = np.zeros(len(run.sensor), np.uint8)
    for name in bad:
        temperature[run.sensor.index(name)] = np.nan
        status[run.sensor.index(name)] = 1
    return Temperatures(
        stamp=nanoseconds(START + run.time[row] + later),
        frame_id='mill/machine',
        sensor=run.sensor,
        temperature=temperature,
        status=status,
        readings=5,
    )


def probe_of(run: ThermalRun, row: int, later: float = 0.0, **changes: Any) -> Displacement:
    """Return what a probe measures at a sample of a run."""
    values: dict[str, Any] = {
        'axis': run.axis,
        'channel': run.channel,
        'displacement': run.displacement[row],
        'standard_deviation': np.full(len(run.channel), 0.3 * MICRON),
        'includes_compensation': False,
    }
    stamp = nanoseconds(START + run.time[row] + later)
    return Displacement(stamp=stamp, frame_id='mill/workpiece', **(values | changes))


def state_of(run: ThermalRun, row: int, spindle_speed: float) -> MachineState:
    """Return the state of a machine at a sample of a run."""
    return MachineState(
        stamp=nanoseconds(START + run.time[row]),
        frame_id='mill/machine',
        state=int(MachineMode.RUNNING),
        homed=True,
        offsets_allowed=True,
        cold_since=nanoseconds(START - 1.0),
        spindle_speed=spindle_speed,
        axis=run.axis,
        position=np.zeros(len(run.axis)),
    )


def bench_with_model(text: str = '', **changes: Any) -> Bench:
    """Return a predictor that uses a model, the one of three runs if none is given."""
    bench = Bench(ThermalPredictor(ThermalPredictorConfig(**changes)))
    assert bench.request('use_model', model=text or model_text()).success
    return bench


def predict(
    bench: Bench,
    run: ThermalRun,
    rows: Iterable[int],
    bad: Iterable[str] = (),
    probes: Iterable[Displacement] = (),
) -> list[ThermalError]:
    """Give samples, the reference in its place and probes; return the errors that came of them."""
    before = len(bench.records('thermal_error'))
    for probe in probes:
        bench.push('displacement', probe)
    for row in rows:
        if row == 2:
            bench.push('thermal_reference', reference_of(run))
        bench.give('temperatures', sample_of(run, row, bad))
    return bench.records('thermal_error')[before:]


def errors_of(found: list[ThermalError]) -> np.ndarray:
    """Return the errors, shape (n, c) [um]."""
    return np.array([item.error for item in found]) / MICRON


def residual(errors: list[ThermalError], run: ThermalRun, rows: Any) -> float:
    """Return the largest difference to what was measured [um]."""
    return float(np.abs(errors_of(errors) - run.displacement[rows] / MICRON).max())
