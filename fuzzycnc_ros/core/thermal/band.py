# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Error band of a prediction: held-out residuals, widened with the distance."""

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array, mean_of_measured


def mean_of_square(residual: Array) -> Array:
    """Return the mean square of each column (n, c) over what is not NaN, NaN if nothing is."""
    return mean_of_measured(np.square(residual), 0)


def largest_of(residual: Array) -> Array:
    """Return the largest size in each column (n, c) of what is not NaN, NaN if nothing is."""
    measured = ~np.isnan(residual)
    highest = np.where(measured, np.abs(residual), 0.0).max(axis=0)
    return np.where(measured.any(axis=0), highest, np.nan)


CONFIDENCE = 0.95
"""Confidence at which one model is better than another [-]; shared by all that compete."""

WORTH_CONFIDENCE = 0.8
"""Confidence at which a model is better than none [-]: temperatures do move machines."""

SCATTER = 0.3
"""Scatter of the gain from fold to fold that is expected beforehand [-]."""

SCATTER_WEIGHT = 3.0
"""Weight of this expectation, in folds [-]."""

GAIN_MIN = 0.1
"""Least gain that is worth another model [-]: the natural logarithm of the residuals' ratio."""

_GAIN_MAX = float(portable.log(2.0))
"""Most that one fold may say for or against a model at all [-]: it halves the error."""

RESIDUAL_MIN = 1e-12
"""Residual below which all models are equally good [m]."""


def log_residual(square: Array) -> Array:
    """Return the logarithm of the residual over all folds.

    Parameters
    ----------
    square : ndarray, shape (..., folds, c)
        Mean square of each fold and channel [m^2]; NaN where nothing was measured.

    Returns
    -------
    ndarray, shape (..., c)
        Logarithm of the root mean square; NaN where no fold has measured the channel.
    """
    mean = mean_of_measured(square, -2)
    return np.asarray(0.5 * portable.log(np.maximum(mean, RESIDUAL_MIN * RESIDUAL_MIN)))


def better(square: Array, other: Array, independent: int, rivals: int = 1) -> bool:
    """Return whether a model is better than another by a tenth, and beyond chance.

    The ratio of the residuals over all folds is tested on its jackknife pseudo-values.

    Parameters
    ----------
    square, other : ndarray, shape (folds, c)
        Mean squares of both [m^2]; the logarithms of the ratios are averaged over the channels.
    independent : int
        Number of folds that share no sample.
    rivals : int
        How many models the first was picked from as the best (Bonferroni).
    """
    measured = ~np.isnan(other).all(axis=1)
    square, other = square[measured], other[measured]
    gain = _gain(square, other)
    if not np.isfinite(gain):
        return gain == np.inf
    folds = len(square)
    variance = 0.0
    if folds > 1:
        kept = [np.delete(np.arange(folds), fold) for fold in range(folds)]
        without = np.array([_gain(square[rows], other[rows]) for rows in kept])
        variance = float((folds * gain - (folds - 1) * without).var(ddof=1))
    error = (1.0 - CONFIDENCE) / rivals
    return gain > GAIN_MIN and _significant(gain, variance, min(folds, independent), error)


def worth_using(square: Array, none: Array, independent: int) -> bool:
    """Return whether a model is better than none by a tenth, and beyond chance.

    Over all folds it has to leave less.  In the test every fold counts alike, whatever its size,
    and says at most that the error is halved or doubled: how much better a model is must not
    count as scatter against it.

    Parameters
    ----------
    square, none : ndarray, shape (folds,)
        Mean squares with the model and without [m^2].
    independent : int
        Number of folds that share no sample.
    """
    with np.errstate(divide='ignore', invalid='ignore'):
        gain = 0.5 * portable.log(
            np.maximum(none, RESIDUAL_MIN * RESIDUAL_MIN)
            / np.maximum(square, RESIDUAL_MIN * RESIDUAL_MIN)
        )
    gain = np.clip(gain[~np.isnan(none)], -_GAIN_MAX, _GAIN_MAX)
    if np.isnan(gain).any() or not len(gain):
        return False
    if not _gain(square[:, np.newaxis], none[:, np.newaxis]) > GAIN_MIN:
        return False
    variance = float(gain.var(ddof=1)) if len(gain) > 1 else 0.0
    mean, count = float(gain.mean()), min(len(gain), independent)
    return _significant(mean, variance, count, 1.0 - WORTH_CONFIDENCE)


def _gain(square: Array, other: Array) -> float:
    with np.errstate(invalid='ignore'):
        return float(np.nanmean(log_residual(other) - log_residual(square)))


def _student(freedom: float, share: float) -> float:
    """Return the quantile of Student's distribution."""
    # Here, since what only predicts does without: a node starts sooner.
    from scipy.special import stdtrit

    return float(stdtrit(freedom, share))


def _significant(gain: float, variance: float, count: int, error: float) -> bool:
    """Return whether a mean gain is above zero, given the variance of single ones."""
    if not np.isfinite(variance):
        return False
    count = max(1, count)
    freedom = SCATTER_WEIGHT + count - 1
    moderated = (SCATTER_WEIGHT * (SCATTER * SCATTER) + (count - 1) * variance) / freedom
    return bool(gain > _student(freedom, 1.0 - error) * np.sqrt(moderated / count))


WIDTH = 2.0
"""Half width of the band in standard deviations [-]."""

COVERED = 0.95
"""Share of the held-out samples that the band must hold [-]; of a normal distribution 0.954."""

GROWTHS = (0.5, 1.0, 2.0)
"""Widenings of the band at the border of the domain that training chooses from [-]."""


@dataclass(frozen=True, eq=False)
class PredictionBand:
    """Standard deviation of a prediction, wider where the model was not trained.

    Parameters
    ----------
    deviation : ndarray, shape (c,)
        Standard deviation amid the training samples [m], see `fitted_band`.
    growth : float
        Widening at the border of the domain [-]: the deviation grows in proportion to the
        distance beyond the point at which growth * distance is 1.
    """

    deviation: Array
    growth: float

    def at(self, distance: Array) -> Array:
        """Return the standard deviation of predictions.

        Parameters
        ----------
        distance : ndarray, shape (...)
            Distance of each sample from the training, 1 at the border of the domain [-].

        Returns
        -------
        ndarray, shape (..., c)
            Standard deviation [m].
        """
        ratio = np.asarray(distance, dtype=np.float64)[..., np.newaxis]
        return np.asarray(_widening(ratio, self.growth) * self.deviation)


def _widening(distance: Array, growth: float) -> Array:
    """Return the factor on the deviation at a distance from the training [-], 1 or more."""
    return np.maximum(1.0, growth * distance)


def fitted_band(residual: Array, distance: Array, folds: int) -> PredictionBand:
    """Return the band that residuals of unseen samples speak for.

    The growth is the one under which they are most likely, if they are normal; the deviation of
    each channel then is the least one whose band holds 95 % of them, as in split conformal
    prediction [lei2018], times what few folds leave unknown of another run (Student's t).

    Parameters
    ----------
    residual : ndarray, shape (n, c)
        Residuals of samples that neither fit nor choice had seen [m]; NaN where nothing was
        measured, infinite where a prediction diverged.
    distance : ndarray, shape (n,)
        Their distance from what had been seen, 1 at the border of the domain [-].
    folds : int
        Number of folds that they come from and that share no sample.

    References
    ----------
    [lei2018]
    """
    bands = [
        PredictionBand(
            held_out_deviation(residual / _widening(distance, growth)[:, np.newaxis]), growth
        )
        for growth in GROWTHS
    ]
    surprise = [_surprise(residual, band.at(distance)) for band in bands]
    best = bands[int(np.argmin(surprise))]
    # Samples of one run err alike: what counts is how many runs there were.
    unknown = _student(SCATTER_WEIGHT + folds, 0.5 + 0.5 * COVERED) / WIDTH
    return PredictionBand(max(1.0, unknown) * best.deviation, best.growth)


def _surprise(residual: Array, deviation: Array) -> float:
    """Return the negative logarithm of the likelihood per sample, up to a constant."""
    with np.errstate(over='ignore', invalid='ignore', divide='ignore'):
        values = 0.5 * np.square(residual / deviation) + portable.log(deviation)
    values = values[np.isfinite(residual) & np.isfinite(values)]
    return float(values.mean()) if len(values) else 0.0


def held_out_deviation(residual: Array) -> Array:
    """Return the standard deviation that residuals of unseen samples speak for.

    Parameters
    ----------
    residual : ndarray, shape (n, c)
        Residuals of samples that the judged fits had not seen [m]; NaN where nothing was
        measured, infinite where a prediction diverged.

    Returns
    -------
    ndarray, shape (c,)
        Root mean square [m], or more where two of it hold less than 95 % of the residuals, as
        with a few large ones among many small.  NaN if nothing was measured.
    """
    with np.errstate(over='ignore'):
        rms = np.sqrt(mean_of_square(residual))
    quantile = [
        np.quantile(channel[~np.isnan(channel)], COVERED, method='higher')
        if np.isfinite(level)
        else level
        for channel, level in zip(np.abs(residual).T, rms, strict=True)
    ]
    return np.maximum(rms, np.array(quantile) / WIDTH)


def independent_residuals(residual: Array, deviation: Array) -> Array:
    """Return how many independent residuals are as good as those of a run.

    Residuals of a run follow each other: an error that lasts for hours is one error, however
    often it is measured.  The number of samples is divided by the integrated autocorrelation time
    [geyer1992] of residual over deviation.  Their mean is not taken off: a constant error counts
    as one.

    Parameters
    ----------
    residual : ndarray, shape (n, c)
        Residuals of one run [m]; NaN where nothing was measured.
    deviation : ndarray, shape (n, c)
        Standard deviation that was predicted [m].

    Returns
    -------
    ndarray, shape (c,)
        From 1 to the number of measured samples [-]; 0 if there are none.

    References
    ----------
    [geyer1992]
    """
    found = []
    for column, spread in zip(residual.T, deviation.T, strict=True):
        measured = ~np.isnan(column)
        # What diverged, or has no band, is far outside of it and not infinitely so.
        floor = np.maximum(spread[measured], RESIDUAL_MIN)
        found.append(_effective_number(np.clip(column[measured] / floor, -1e3, 1e3)))
    return np.array(found)


def _effective_number(values: Array) -> float:
    """Return the number of values over their autocorrelation time."""
    count = len(values)
    square = float(values @ values)
    if count < 2 or square == 0.0:
        return float(count)
    spectrum = np.fft.rfft(values, 2 * count)
    correlation = np.fft.irfft(spectrum * spectrum.conj(), 2 * count)[:count] / square
    pairs = correlation[: count - count % 2].reshape(-1, 2).sum(axis=1)
    # Sums of neighbouring lags are positive as long as they are more than noise.
    ends = np.flatnonzero(pairs <= 0.0)
    time = 2.0 * float(pairs[: ends[0] if len(ends) else len(pairs)].sum()) - 1.0
    return float(np.clip(count / max(time, 1.0), 1.0, count))


COVERED_LEAST = 0.9
"""Share of the residuals below which a band may be far from holding 95 % [-]: twice as many are
outside as should be."""

FALSE_BAND_CHANCE = 0.05
"""Probability of so many residuals outside of a true band, up to which it counts as false [-]."""


def band_ratio(residual: Array, deviation: Array) -> Array:
    """Return the root mean square of residuals over their predicted deviation, (c,) [-].

    Parameters
    ----------
    residual, deviation : ndarray, shape (n, c)
        As in `independent_residuals`.
    """
    floor = np.maximum(deviation, RESIDUAL_MIN)
    return np.asarray(np.sqrt(mean_of_square(np.clip(residual / floor, -1e3, 1e3))))


def is_false_band(covered: float, ratio: float, independent: float, runs: int = 1) -> bool:
    """Return whether a band holds so little that chance does not explain it.

    So it is where less than 90 % of the residuals lie inside, and as many of the independent ones
    would be outside of a band of 95 % (binomial), or as large (chi-squared), with a probability of
    at most 5 %, shared among the runs that are looked at (Bonferroni).

    Parameters
    ----------
    covered : float
        Share of the residuals inside the band [-]; NaN if there are none.
    ratio : float
        Root mean square of the residuals over the deviation [-], see `band_ratio`.
    independent : float
        How many independent residuals they are as good as [-].
    runs : int
        Number of runs that are judged, each by itself.

    Examples
    --------
    >>> is_false_band(0.14, 2.1, 3.0), is_false_band(0.6, 3.0, 1.0), is_false_band(0.88, 1.1, 20.0)
    (True, True, False)
    """
    if not covered < COVERED_LEAST:
        return False
    # Here, since what only predicts does without: a node starts sooner.
    from scipy.special import bdtrc, chdtrc

    count = max(1, round(independent))
    outside = round(count * (1.0 - covered))
    number = float(bdtrc(outside - 1, count, 1.0 - COVERED)) if outside else 1.0
    size = float(chdtrc(independent, independent * (ratio * ratio)))
    return min(number, size) * runs <= FALSE_BAND_CHANCE * (1.0 + 1e-9)


def coverage(residual: Array, deviation: Array) -> Array:
    """Return the share of residuals within two standard deviations.

    Parameters
    ----------
    residual : ndarray, shape (n, c)
        Measured minus predicted or the reverse [m]; NaN where nothing was measured.
    deviation : ndarray, shape (n, c) or (c,)
        Standard deviation that was predicted [m].

    Returns
    -------
    ndarray, shape (c,)
        Share of the measured samples [-], NaN if there are none.
    """
    measured = ~np.isnan(residual)
    inside = measured & (np.abs(residual) <= WIDTH * deviation)
    count = measured.sum(axis=0)
    return np.where(count > 0, inside.sum(axis=0) / np.maximum(count, 1), np.nan)
