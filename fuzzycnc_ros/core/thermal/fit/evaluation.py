# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Judge a trained model on a run, all candidates and the uncompensated machine side by side."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.band import (
    WIDTH,
    band_ratio,
    coverage,
    independent_residuals,
    is_false_band,
    largest_of,
    mean_of_square,
)
from fuzzycnc_ros.core.thermal.candidate import DEFAULT
from fuzzycnc_ros.core.thermal.fingerprint import recognised_in
from fuzzycnc_ros.core.thermal.fit.training import at_interval
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Residuals of a run.

    Parameters
    ----------
    run : str
        Name of the run.
    channel, axis : tuple of str, length c
        Channels and the axis of each.
    samples : tuple of int, length c
        Number of judged samples of each channel, at the model's interval.
    default : tuple of str, length c
        Candidate behind the row 'default' in each channel.
    rms, largest : mapping of str to ndarray, shape (c,)
        Root mean square and largest absolute residual [m] of 'uncompensated', of each
        candidate and of 'default'; infinite if it diverged, NaN if nothing was measured.
    in_domain : float
        Share of the judged samples inside the model's domain [-]; 0 after a warm start.
    warm : mapping of str to float
        Inputs that are warmer at the start of the run than at a cold start, by how much [K].
    trained_on : mapping of str to float
        Runs of the training that the judged samples come from, and their share of them [-].
    covered : ndarray, shape (c,)
        Share of the residuals of 'default' inside the band of two standard deviations [-]; NaN
        if nothing was measured.
    half_width : ndarray, shape (c,)
        Root mean square of the half width of the band where it was judged [m].
    independent : ndarray, shape (c,)
        How many independent residuals those of 'default' are as good as [-].
    band_ratio : ndarray, shape (c,)
        Root mean square of the residuals of 'default' over the predicted deviation [-].
    time : ndarray, shape (n,)
        Time of each judged sample [s].
    measured : ndarray, shape (n, c)
        Thermal error [m]; NaN where nothing was probed.
    predicted : mapping of str to ndarray, shape (n, c)
        Prediction behind each row of `rms` [m]; infinite or NaN where it diverged.
    recognised : bool
        Whether all samples that were trained on would have been found; if not, an empty
        `trained_on` says nothing.
    """

    run: str
    channel: tuple[str, ...]
    axis: tuple[str, ...]
    samples: tuple[int, ...]
    default: tuple[str, ...]
    rms: Mapping[str, Array]
    largest: Mapping[str, Array]
    in_domain: float
    warm: Mapping[str, float]
    trained_on: Mapping[str, float]
    covered: Array
    half_width: Array
    independent: Array
    band_ratio: Array
    time: Array
    measured: Array
    predicted: Mapping[str, Array]
    recognised: bool = True

    def false_band(self, runs: int = 1) -> tuple[str, ...]:
        """Return the channels whose band holds far less than it promises; see `is_false_band`.

        Parameters
        ----------
        runs : int
            Number of runs that are judged, each by itself.
        """
        figures = zip(self.channel, self.covered, self.band_ratio, self.independent, strict=True)
        return tuple(
            name
            for name, share, ratio, count in figures
            if is_false_band(share, ratio, count, runs)
        )


def evaluate(
    model: ThermalModel,
    run: ThermalRun,
    *,
    start: float | None = None,
    stop: float | None = None,
    recorded: ThermalRun | None = None,
    candidates: Collection[str] | None = None,
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
    recorded : ThermalRun, optional
        The run as it was recorded, where `run` has something in place of missing readings; in it
        samples of the training are recognised.
    candidates : collection of str, optional
        Candidates of the model that are judged beside its default; all if absent.

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
        name: model.candidates[name].recursion.run(rise)
        for name in model.candidates_on(even)
        if candidates is None or name in candidates
    }
    predictions[DEFAULT] = model.recursion().run(rise)
    rms, largest = {}, {}
    for name, predicted in predictions.items():
        # A diverged prediction counts as infinitely wrong, a sample never probed not at all.
        residual = np.where(np.isnan(predicted[inside]), np.inf, predicted[inside]) - measured
        with np.errstate(over='ignore'):
            rms[name] = np.sqrt(mean_of_square(residual))
        largest[name] = largest_of(residual)
    warm = model.warmth(even.reference()[even.columns(model.inputs)])
    trained_on, recognised = recognised_in(
        model.fingerprints, recorded or run, (recorded or run).inside(start, stop)
    )
    deviation = model.standard_deviation(rise[inside])
    residual = predictions[DEFAULT][inside] - measured
    judged = np.isfinite(measured)
    return Evaluation(
        run=run.name,
        channel=model.channel,
        axis=model.axis,
        samples=tuple(judged.sum(axis=0).tolist()),
        default=model.default,
        rms=rms,
        largest=largest,
        in_domain=0.0 if warm else float(model.in_domain(rise[inside]).mean()),
        warm=warm,
        trained_on=trained_on,
        covered=coverage(residual, deviation),
        half_width=np.sqrt(mean_of_square(np.where(judged, WIDTH * deviation, np.nan))),
        independent=independent_residuals(residual, deviation),
        band_ratio=band_ratio(residual, deviation),
        time=even.time[inside],
        measured=measured,
        predicted={name: predicted[inside] for name, predicted in predictions.items()},
        recognised=recognised,
    )


def pooled_coverage(judged: Sequence[Evaluation]) -> tuple[Array, Array, Array]:
    """Return `covered`, `band_ratio` and `independent` of all runs together, (c,) each.

    Each run counts with as many residuals as it has independent ones.
    """
    number = np.array([item.independent for item in judged])
    covered = np.array([np.nan_to_num(item.covered) for item in judged])
    square = np.array([np.nan_to_num(item.band_ratio) ** 2 for item in judged])
    total = number.sum(axis=0)
    known = np.where(total > 0.0, total, np.nan)
    ratio = np.sqrt((number * square).sum(axis=0) / known)
    return (number * covered).sum(axis=0) / known, ratio, np.asarray(total)


def false_bands(judged: Sequence[Evaluation]) -> list[str]:
    """Return the channels whose band is false in a run, or over all runs."""
    found = {name for item in judged for name in item.false_band(len(judged))}
    figures = zip(judged[0].channel, *pooled_coverage(judged), strict=True)
    return [name for name, *each in figures if name in found or is_false_band(*each)]


def pooled_rms(judged: Sequence[Evaluation]) -> dict[str, Array]:
    """Return the root mean square residual over all judged samples, (c,) [m].

    What diverged anywhere stays infinite; a channel that was measured nowhere is NaN.  Candidates
    that not all runs were judged with are left out.
    """
    weight = np.array([np.isfinite(item.measured).sum(axis=0) for item in judged])
    total = weight.sum(axis=0)
    pooled = {}
    for name in judged[0].rms:
        if not all(name in item.rms for item in judged):
            continue
        each = np.array([item.rms[name] for item in judged])
        with np.errstate(over='ignore', invalid='ignore'):
            square = np.where(weight > 0, each**2 * weight, 0.0).sum(axis=0)
            pooled[name] = np.sqrt(square / np.where(total > 0, total, np.nan))
    return pooled
