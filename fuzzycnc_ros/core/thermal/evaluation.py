# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Judge a trained model on a run, all candidates and the uncompensated machine side by side."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.residuals import mean_of_square
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun
from fuzzycnc_ros.core.thermal.training import at_interval


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Residuals of a run.

    Parameters
    ----------
    run : str
        Name of the run.
    channel, axis : tuple of str, length c
        Channels and the axis of each.
    samples : int
        Number of judged samples at the model's interval.
    default : tuple of str, length c
        Candidate behind the row 'default' in each channel.
    rms, largest : mapping of str to ndarray, shape (c,)
        Root mean square and largest absolute residual [m] of 'uncompensated', of each
        candidate and of 'default'; infinite if it diverged, NaN if nothing was measured.
    in_domain : float
        Share of the judged samples inside the model's domain [-].
    time : ndarray, shape (n,)
        Time of each judged sample [s].
    measured : ndarray, shape (n, c)
        Thermal error [m]; NaN where nothing was probed.
    predicted : mapping of str to ndarray, shape (n, c)
        Prediction behind each row of `rms` [m]; infinite or NaN where it diverged.
    """

    run: str
    channel: tuple[str, ...]
    axis: tuple[str, ...]
    samples: int
    default: tuple[str, ...]
    rms: Mapping[str, Array]
    largest: Mapping[str, Array]
    in_domain: float
    time: Array
    measured: Array
    predicted: Mapping[str, Array]


def evaluate(
    model: ThermalModel,
    run: ThermalRun,
    *,
    start: float | None = None,
    stop: float | None = None,
) -> Evaluation:
    """Compare the predictions of all candidates with what was measured.

    Parameters
    ----------
    model : ThermalModel
        Trained model.
    run : ThermalRun
        Run from its thermal start, at the model's interval or faster.
    start, stop : float, optional
        Times [s] between which residuals count.  The states warm up from the run's start, as
        they would on the machine.

    Returns
    -------
    Evaluation
        Root mean square and largest residual per channel.

    Raises
    ------
    ModelMismatchError
        If the run lacks inputs of the model.
    ThermalDataError
        If channels differ, nothing was measured in the window, or the run is too slow.
    """
    if run.channel != model.channel:
        raise ThermalDataError(
            f'run {run.name!r}: expected the channels {", ".join(model.channel)} of the model, '
            f'but found {", ".join(run.channel)}'
        )
    even = at_interval(run, model.interval)
    rise = model.rises(even)
    inside = even.inside(start, stop)
    measured = even.displacement[inside]
    if not np.isfinite(measured).any():
        raise ThermalDataError(
            f'run {run.name!r}: expected measured displacements in the window, but found none'
        )
    predictions = {'uncompensated': np.zeros_like(even.displacement)}
    predictions |= {
        name: model.candidates[name].recursion.run(rise) for name in model.candidates_on(even)
    }
    predictions['default'] = model.recursion().run(rise)
    rms, largest = {}, {}
    for name, predicted in predictions.items():
        # A diverged prediction counts as infinitely wrong, a sample never probed not at all.
        residual = np.where(np.isnan(predicted[inside]), np.inf, predicted[inside]) - measured
        with np.errstate(over='ignore'):
            rms[name] = np.sqrt(mean_of_square(residual))
        absent = np.isnan(residual)
        highest = np.where(absent, 0.0, np.abs(residual)).max(axis=0)
        largest[name] = np.where(absent.all(axis=0), np.nan, highest)
    return Evaluation(
        run=run.name,
        channel=model.channel,
        axis=model.axis,
        samples=int(inside.sum()),
        default=model.default,
        rms=rms,
        largest=largest,
        in_domain=float(model.in_domain(rise[inside]).mean()),
        time=even.time[inside],
        measured=measured,
        predicted={name: predicted[inside] for name, predicted in predictions.items()},
    )
