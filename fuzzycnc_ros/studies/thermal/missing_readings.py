# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Predictions of a model where readings of a recorded run are missing."""

import os
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.core.remedies import Remedy

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fuzzycnc_ros.core.thermal.fit import Evaluation
    from fuzzycnc_ros.core.thermal.model import ThermalModel
    from fuzzycnc_ros.core.thermal.run import ThermalRun

LINE, MATES = 'line', 'mates'
"""Substitutes of missing readings: a straight line, or estimates from other sensors."""


@dataclass(frozen=True)
class Bridged:
    """A gap in the readings of a sensor, and what stands in its place.

    Parameters
    ----------
    sensor : str
        The sensor.
    samples : int
        Samples without a reading.
    start_s, stop_s : float
        Times of the readings before and behind it [s].
    by : str
        `LINE` or `MATES`.
    """

    sensor: str
    samples: int
    start_s: float
    stop_s: float
    by: str


def as_predicted(
    model: 'ThermalModel', run: 'ThermalRun'
) -> 'tuple[ThermalRun, tuple[Bridged, ...]]':
    """Return a run with what the predictor would have read where inputs of a model are missing.

    Other sensors stand in for an input as long as the model knows some that can; else a straight
    line goes over the gap.

    Raises
    ------
    ThermalDataError
        If an input is missing for longer than that, or the run is too slow for the model.
    """
    from fuzzycnc_ros.core.thermal.fit.training import at_interval
    from fuzzycnc_ros.core.thermal.run import ThermalDataError

    at_interval(run, model.interval)  # refuses what is too slow
    even = run.averaged(model.interval)
    gaps = [gap for gap in even.gaps() if gap.sensor in model.inputs]
    if not gaps:
        return run, ()
    filled = replace(even, temperature=_with_mates(model, even))
    left = {(gap.sensor, gap.start) for gap in filled.gaps()}
    whole = filled.bridged()
    lost = [gap for gap in whole.gaps() if gap.sensor in model.inputs]
    if lost:
        first = lost[0]
        raise ThermalDataError(
            f'run {run.name!r}: expected readings of {first.sensor}, which the model reads, but '
            f'found none from {first.start:.6g} to {first.stop:.6g} s, nor sensors that can stand '
            'in for it',
            Remedy('judge the part before', {'end': f'{first.start:.10g}'}),
            Remedy(f'train a model that does without {first.sensor}', {}),
        )
    return whole, tuple(
        Bridged(*gap, by=LINE if (gap.sensor, gap.start) in left else MATES) for gap in gaps
    )


def read_usable(
    path: 'str | os.PathLike[str]', interval: float | None, **options: Any
) -> 'ThermalRun':
    """Read a run that can be trained on at an interval [s], the usual one if absent.

    Options are those of `read_run`.

    Raises
    ------
    BagError
        If it cannot be read.
    ThermalDataError
        If it is too slow, lacks readings for longer than is bridged, or warms faster than metal.
    """
    from fuzzycnc_ros.bags.runs import read_run
    from fuzzycnc_ros.core.thermal.fit.training import at_interval, training_interval
    from fuzzycnc_ros.core.thermal.fit.training_runs import check_gaps, check_rise

    run = read_run(path, **options)
    even = at_interval(run, training_interval([run], interval))
    check_gaps([even])
    check_rise(even)
    return run


def judge_recorded(
    model: 'ThermalModel',
    recorded: 'ThermalRun',
    *,
    start: float | None = None,
    stop: float | None = None,
    candidates: Collection[str] | None = None,
) -> 'tuple[Evaluation, ThermalRun, tuple[Bridged, ...]]':
    """Judge a model on a recorded run as it would have run on the machine.

    Parameters
    ----------
    model, recorded : ThermalModel, ThermalRun
        The model and the run as it was recorded, readings missing or not.
    start, stop : float, optional
        Times between which residuals count [s].
    candidates : collection of str, optional
        Candidates that are judged beside the default; all if absent.

    Returns
    -------
    evaluation : Evaluation
        What is left.
    run : ThermalRun
        The run as the predictor would have read it.
    bridged : tuple of Bridged
        What was missing, and what stood in for it.

    Raises
    ------
    ThermalDataError
        If the model cannot be judged on the run.
    ModelMismatchError
        If the run lacks inputs of the model.
    """
    from fuzzycnc_ros.core.thermal.fit import evaluate

    run, bridged = as_predicted(model, recorded)
    judged = evaluate(model, run, start=start, stop=stop, recorded=recorded, candidates=candidates)
    return judged, run, bridged


def _with_mates(model: 'ThermalModel', run: 'ThermalRun') -> 'NDArray[Any]':
    """Return the temperatures (n, s) of a run, other sensors standing in for lost inputs."""
    import numpy as np

    from fuzzycnc_ros.components.thermal.sensor_substitution import RiseSource
    from fuzzycnc_ros.core.thermal.model import ModelMismatchError
    from fuzzycnc_ros.core.thermal.run import REFERENCE_SAMPLES
    from fuzzycnc_ros.runtime.records import ThermalReference

    values = run.temperature.copy()
    columns = run.columns(model.inputs)
    zero = run.reference()
    try:
        source = RiseSource(
            model,
            run.sensor,
            ThermalReference(
                stamp=0,
                frame_id='',
                cold_since=0,
                set_by='recording',
                sensor=run.sensor,
                temperature=zero,
                samples=REFERENCE_SAMPLES,
            ),
            None,
        )
    except ModelMismatchError:
        return values  # no zero to count rises from, neither of an input nor of those like it
    # Whatever is taken for an unknown zero drops out where rises are meant against it again.
    level = np.where(np.isfinite(zero), zero, np.nanmean(zero))[columns]
    known = np.isfinite(zero[columns])
    lost = ~np.isfinite(values[:, columns]) | ~known
    # What lacks of the zero itself is left to `bridged`, which keeps it as it is.
    lost[:REFERENCE_SAMPLES, known] = False
    for row in np.flatnonzero(lost.any(axis=1)):
        rise = source.rise(run.temperature[row], np.isfinite(run.temperature[row]))
        if rise is not None:
            own = columns[lost[row]]
            values[row, own] = (level + rise)[lost[row]]
    return values
