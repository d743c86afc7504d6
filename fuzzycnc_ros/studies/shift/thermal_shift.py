# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The thermal shift: calibrate on some duties of the simulated mill, compensate others.

The components, their order of turns and the requests are those of a live lock-step graph, so
that both give the same outputs.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.thermal.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.components.thermal.sensor_selector import SensorSelector, SensorSelectorConfig
from fuzzycnc_ros.components.thermal.temperature_acquisition import (
    TemperatureAcquisition,
    TemperatureAcquisitionConfig,
)
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.runtime.component import Answer
from fuzzycnc_ros.runtime.graph import Sink
from fuzzycnc_ros.studies.evaluated_graph import judged_graph
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.shift.shift_log import ShiftLog, compensation_runs
from fuzzycnc_ros.studies.thermal.report_data import CompensationRun

CALIBRATION_DUTIES = ('D0', 'D0b', 'T1')
"""Duties that models are trained on."""

SHIFT_DUTIES = ('T2', 'T3')
"""Duties that no model has seen."""

CALIBRATION_SEED = 500_000
"""Offset between the noise seeds of a shift and of its calibration, which is another campaign."""

SEED_STEP = 1000
"""Offset between the noise seeds of two duties, as in `simulated_machine`."""

Progress = Callable[[str, int, int], None]
"""Told what is going on, ticks done and in all; an exception that it raises ends the run."""

Parameters = Mapping[str, Mapping[str, Any]]
"""Parameters that differ from their defaults, by node and name."""

C = TypeVar('C', bound=Config)

ShiftComponents = tuple[
    SimulatedMachine, TemperatureAcquisition, SensorSelector, ThermalPredictor, Compensator
]
"""All components of a shift."""


@dataclass(frozen=True)
class Calibration:
    """Calibration runs and the names under which `sensor_selector` asks for them.

    Parameters
    ----------
    runs : tuple of ThermalRun
        The runs.
    bags : tuple of str
        Bag of each run; the name of its duty where no bag was written.
    """

    runs: tuple[ThermalRun, ...]
    bags: tuple[str, ...]

    def read(self, bag: str, *, sensor_limits: Sequence[str]) -> ThermalRun:
        """Return the run of a bag."""
        if bag in self.bags:
            return self.runs[self.bags.index(bag)]
        return read_run(bag, sensor_limits=sensor_limits)


def record_calibration(
    duties: Sequence[str] = CALIBRATION_DUTIES,
    seed: int = 0,
    *,
    folder: str | os.PathLike[str] | None = None,
    parameters: Parameters | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Run calibration duties without compensation and record them.

    Parameters
    ----------
    duties : sequence of str
        Duties of the simulated mill, each run once from cold.
    seed : int
        Seed of all measuring noise.
    folder : path, optional
        Folder to write one bag per duty into.
    parameters : mapping, optional
        Parameters of `simulated_machine` and `temperature_acquisition`.
    progress : callable, optional
        Told how far it is.

    Returns
    -------
    Calibration
        One run per duty, equal to what `bags.read_run` gives for its bag.

    Raises
    ------
    ValueError
        If a duty or parameter is unknown or out of bounds.
    BagError
        If a bag exists or cannot be written.
    """
    given = checked(parameters)
    machines = [
        SimulatedMachine(
            configured(
                SimulatedMachineConfig,
                given,
                duties=(duty,),
                seed=CALIBRATION_SEED + seed + SEED_STEP * number,
            )
        )
        for number, duty in enumerate(duties)
    ]
    runs, bags = [], []
    for duty, machine in zip(duties, machines, strict=True):
        log = ShiftLog()
        acquisition = TemperatureAcquisition(configured(TemperatureAcquisitionConfig, given))
        told = _labelled(progress, f'calibrating on {duty}')
        if folder is None:
            judged_graph(machine, [acquisition], log, None).run(told)
            bags.append(duty)
        else:
            path = Path(folder) / duty
            with PublishedBag(path) as bag:
                judged_graph(machine, [acquisition], log, bag).run(told)
            bags.append(str(path))
        runs.append(log.thermal_run(duty))
    return Calibration(tuple(runs), tuple(bags))


def run_shift(
    model_text: str,
    calibration: Calibration | None = None,
    duties: Sequence[str] = SHIFT_DUTIES,
    seed: int = 0,
    *,
    faults: Sequence[str] = (),
    parameters: Parameters | None = None,
    sink: Sink | None = None,
    progress: Progress | None = None,
) -> tuple[CompensationRun, ...]:
    """Compensate duties of the simulated mill with a trained model, in one process.

    Parameters
    ----------
    model_text : str
        Text of a model file.
    calibration : Calibration, optional
        Runs that `sensor_selector` is asked to select from; without them the model's own
        substitutes stand.
    duties : sequence of str
        Duties of the simulated mill, one a day.
    seed : int
        Seed of all measuring noise.
    faults : sequence of str
        Sensor faults as `sensor:kind:start[:value]`, the same in every duty.
    parameters : mapping, optional
        Parameters of the components by node and name.
    sink : callable, optional
        Takes every published record, configurations, requests and turns included.
    progress : callable, optional
        Told how far it is.

    Returns
    -------
    tuple of CompensationRun
        One per duty.

    Raises
    ------
    ModelFileError
        If the text is no model file.
    ValueError
        If a duty, fault or parameter is unknown or out of bounds, or a request is refused.
    """
    machine, acquisition, selector, predictor, compensator = shift_components(
        duties, seed, faults=faults, parameters=parameters
    )
    model = load_model(model_text)
    selector.run_reader = calibration.read if calibration is not None else read_run
    limits = compensator.configuration
    log = ShiftLog()
    graph = judged_graph(machine, [acquisition, selector, predictor, compensator], log, sink)
    if calibration is not None:
        bags = list(calibration.bags)
        _accepted(graph.request('sensor_selector', 'select_sensors', bag=bags, clusters=0))
    _accepted(graph.request('thermal_predictor', 'use_model', model=model_text))
    _accepted(graph.request('compensator', 'activate'))
    graph.run(_labelled(progress, f'compensating {", ".join(duties)}'))
    return compensation_runs(log, model, duties, offset_max=limits.offset_max)


def shift_components(
    duties: Sequence[str],
    seed: int = 0,
    *,
    faults: Sequence[str] = (),
    parameters: Parameters | None = None,
) -> ShiftComponents:
    """Return the components of a shift, all of whose settings are checked then.

    Parameters
    ----------
    duties, seed, faults, parameters
        As `run_shift` takes them.

    Raises
    ------
    ValueError
        If a duty, fault or parameter is unknown or out of bounds.
    """
    given = checked(parameters)
    fixed: dict[str, Any] = {'duties': tuple(duties), 'seed': seed}
    if faults:
        fixed['sensor_faults'] = tuple(faults)
    return (
        SimulatedMachine(configured(SimulatedMachineConfig, given, **fixed)),
        TemperatureAcquisition(configured(TemperatureAcquisitionConfig, given)),
        SensorSelector(configured(SensorSelectorConfig, given)),
        ThermalPredictor(configured(ThermalPredictorConfig, given)),
        Compensator(configured(CompensatorConfig, given)),
    )


def checked(parameters: Parameters | None) -> Parameters:
    """Return parameters after a look at the names of their nodes and of themselves.

    Raises
    ------
    ValueError
        If a node or parameter does not exist.
    """
    for node, values in (parameters or {}).items():
        if node not in COMPONENTS:
            raise ValueError(f'expected a node of {", ".join(COMPONENTS)} but found {node!r}')
        known = [item.name for item in fields(COMPONENTS[node].CONFIG)]
        unknown = [name for name in values if name not in known]
        if unknown:
            raise ValueError(
                f'unknown parameter {", ".join(unknown)} of {node}; expected one of '
                f'{", ".join(known)}'
            )
    return parameters or {}


def configured(config: type[C], given: Parameters, **fixed: Any) -> C:
    """Return a configuration with given parameters, and fixed ones that overrule them."""
    node = next(name for name, item in COMPONENTS.items() if item.CONFIG is config)
    return config(**{**given.get(node, {}), **fixed})


def _accepted(answer: Answer) -> None:
    if not answer.success:
        raise ValueError(answer.message)


def _labelled(progress: Progress | None, text: str) -> Callable[[int, int], None] | None:
    if progress is None:
        return None
    return lambda done, total: progress(text, done, total)
