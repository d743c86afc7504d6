# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A shift of the whole graph, sample by sample, with faults and changes on the way."""

from collections.abc import Callable
from functools import cache

import numpy as np
from kept import kept

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.thermal.compensator import Compensator
from fuzzycnc_ros.components.thermal.temperature_acquisition import (
    TemperatureAcquisition,
    TemperatureAcquisitionConfig,
)
from fuzzycnc_ros.components.thermal.thermal_predictor import (
    ThermalPredictor,
    ThermalPredictorConfig,
)
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.graph import InProcessGraph
from fuzzycnc_ros.runtime.records import Record
from fuzzycnc_ros.studies.shift.thermal_shift import Calibration, record_calibration

CANDIDATES = ('stable_grey', 'lag_ridge')
"""Candidates that train in a moment."""

UNSEEN = ('T2', 'T3')
HEALTHY_SEEDS = range(12)
FAULTY_SEEDS = range(2)
ALARM_SEEDS = range(4)
FAULT = 60
"""Sample, one a minute, in which a fault begins."""

HALF_HOURLY = {'learn': True, 'probe_interval': 1800.0}
PROBE = 30
"""Samples between two of these probes."""

UNWATCHED = {'mate_persistence': 0.0}

Change = Callable[[Emission], Emission | None]


class ChangedMachine(SimulatedMachine):
    """The simulated mill, with what it says passed through `change`; None is not said."""

    change: Change

    def tick(self):
        for emission in super().tick():
            changed = self.change(emission)
            if changed is not None:
                yield changed


class Shift:
    """One duty of the whole graph, sample by sample, and what was said on the way.

    `text` is a model file, `change` is put on what the machine says, and `parameters` are those
    of the predictor, which learns from nothing where the text is empty.  Sample k carries the
    stamp k + 1 min.
    """

    def __init__(
        self,
        text,
        duty='T2',
        *,
        seed=0,
        faults=(),
        probe_interval=60.0,
        stuck_time=600.0,
        change=None,
        compensator=None,
        displacement_compensated=False,
        **parameters,
    ):
        machine = ChangedMachine(
            SimulatedMachineConfig(
                duties=(duty,),
                seed=seed,
                sensor_faults=tuple(faults),
                displacement_interval=probe_interval,
                displacement_compensated=displacement_compensated,
            )
        )
        machine.change = change or (lambda emission: emission)
        self.predictor = ThermalPredictor(ThermalPredictorConfig(**parameters))
        self.compensator = Compensator(compensator)
        acquisition = TemperatureAcquisition(TemperatureAcquisitionConfig(stuck_time=stuck_time))
        self.graph = InProcessGraph(
            machine, [acquisition, self.predictor, self.compensator], sink=self._take
        )
        self.errors, self.health, self.compensation, self.applied = [], [], [], []
        self.posteriors = []
        self._measured = {}
        if text:
            self.use(text)
        assert self.graph.request('compensator', 'activate').success

    def _take(self, topic: str, record: Record) -> None:
        if topic == 'thermal_error':
            self.errors.append(record)
            self.health.append({item.name: item.message for item in self.predictor.health()})
        elif topic == 'compensation':
            self.compensation.append(record)
        elif topic == 'thermal_posterior':
            self.posteriors.append(record)
        elif topic == 'compensation_applied':
            self.applied.append(1e6 * record.offset)
        elif topic == 'displacement':
            self._measured[record.stamp] = 1e6 * record.displacement

    def use(self, text: str) -> str:
        """Ask for a model; return the answer."""
        answer = self.graph.request('thermal_predictor', 'use_model', model=text)
        assert answer.success
        return answer.message

    def run(self, samples: int | None = None, until: str = '') -> 'Shift':
        """Go on for a number of samples, until an item is in the health, or to the end."""
        end = np.inf if samples is None else len(self.errors) + samples
        while len(self.errors) < end and self.graph.machine.next_tick is not None:
            self.graph.step()
            if until and self.health and until in self.health[-1]:
                break
        return self

    @property
    def error(self) -> np.ndarray:
        """Published errors, shape (n, c) [um]; NaN where there is none."""
        return 1e6 * np.array([item.error for item in self.errors])

    @property
    def valid(self) -> np.ndarray:
        """Which of them are valid, shape (n,)."""
        return np.array([item.valid for item in self.errors])

    @property
    def residual(self) -> np.ndarray:
        """What they missed, shape (n, c) [um]; NaN where nothing was measured."""
        nothing = np.full(2, np.nan)
        measured = [self._measured.get(item.stamp, nothing) for item in self.errors]
        return self.error - np.array(measured)

    @property
    def largest(self) -> np.ndarray:
        """Largest residual of Y and Z [um]."""
        return np.nanmax(np.abs(self.residual), axis=0)

    def substituted(self, sensor: str) -> np.ndarray:
        """At which samples something stood in for a sensor, shape (n,)."""
        return np.array([sensor in item.substituted for item in self.errors])

    def said(self, name: str) -> np.ndarray:
        """At which samples the predictor's health had an item, shape (n,)."""
        return np.array([name in items for items in self.health])


@cache
def calibrated(seed: int) -> Calibration:
    """Return recorded calibration runs."""
    return record_calibration(seed=seed)


@kept
def model_of(seed: int, *candidates: str) -> str:
    """Return the file of a model of them."""
    return train_model(calibrated(seed).runs, candidates=candidates or CANDIDATES).to_json()


@kept
def speed_model() -> str:
    """Return the file of a model that reads the spindle speed."""
    name = 'lag_ridge_speed'
    model = train_model(calibrated(0).runs, model=name, candidates=(name, *CANDIDATES))
    assert load_model(model.to_json()).needs_speed
    return model.to_json()


@cache
def healthy(seed: int, duty: str) -> Shift:
    """Return a healthy shift that is probed every half hour."""
    return Shift(model_of(seed), duty, seed=seed, **HALF_HOURLY).run()


@cache
def plain(duty: str, seed: int = 0) -> Shift:
    """Return a healthy shift without probing."""
    return Shift(model_of(seed), duty, seed=seed).run()


def inputs_of(seed: int) -> tuple[str, ...]:
    return load_model(model_of(seed)).inputs


def cases(seeds, duties=UNSEEN) -> list[tuple[int, str]]:
    return [(seed, duty) for seed in seeds for duty in duties]


def with_fault(kind: str, seeds, duties=UNSEEN, samples=200, **changes):
    """Yield shifts with a fault on one input, its sensor, and the healthy shift beside them."""
    for seed, duty in cases(seeds, duties):
        for sensor in inputs_of(seed):
            faults = [f'{sensor}:{kind}'.format(60 * FAULT)]
            shift = Shift(model_of(seed), duty, seed=seed, faults=faults, **changes)
            yield shift.run(samples), sensor, plain(duty, seed)


def found_after(shift: Shift, sensor: str) -> float:
    """Return the samples from the start of a fault to its substitution, infinity if never."""
    found = shift.substituted(sensor)
    assert not found[: FAULT - 1].any()
    return float(found.argmax() + 1 - FAULT) if found.any() else np.inf
