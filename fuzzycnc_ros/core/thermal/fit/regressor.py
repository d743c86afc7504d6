# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Base of the thermal models of one channel: input checks, prediction, streaming."""

import copy
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.estimator import (
    RegressionEstimator,
    check_features,
    check_fitted,
    check_target,
)
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, Stream, check_interval, run_slices

_Self = TypeVar('_Self', bound='ThermalRegressor')


class ThermalRegressor(RegressionEstimator):
    """Base of the models that map rises to the thermal error of one channel.

    A subclass learns `recursion_` in `_fit`; everything else follows from that.
    """

    interval: float
    recursion_: Recursion

    def fit(
        self: _Self,
        X: ArrayLike,  # noqa: N803
        y: ArrayLike,
        *,
        runs: ArrayLike | None = None,
        groups: ArrayLike | None = None,
    ) -> _Self:
        """Learn from recorded samples and return the estimator.

        Parameters
        ----------
        X : array_like, shape (n, p)
            Rises [K].
        y : array_like, shape (n,)
            Thermal error [m]; NaN where nothing was measured.
        runs : array_like, shape (n,), optional
            Label of the run that each sample belongs to; lags, delays and history start anew with
            each run.  One run if absent.
        groups : array_like, shape (n,), optional
            The same by scikit-learn's word.

        Raises
        ------
        ValueError
            If a parameter is out of its range, lengths disagree, or too few samples were measured.
        ImportError
            If the estimator needs scikit-learn and that is not installed.
        """
        self._fit(*check_training(self, X, y, run_labels(runs, groups)))
        return self

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        """Learn `recursion_` from checked rises (n, p), target (n,) and the rows of each run."""
        raise NotImplementedError

    def predict(
        self,
        X: ArrayLike,  # noqa: N803
        *,
        runs: ArrayLike | None = None,
        groups: ArrayLike | None = None,
    ) -> Array:
        """Return the thermal error of whole runs, each from its own start.

        Parameters
        ----------
        X : array_like, shape (n, p)
            Rises [K].
        runs, groups : array_like, shape (n,), optional
            Label of the run that each sample belongs to, by either word; one run if absent.

        Returns
        -------
        ndarray, shape (n,)
            Thermal error in the unit of the training target [m].
        """
        check_fitted(self, 'recursion_')
        rise = check_features(self, X, reset=False)
        slices = run_slices(run_labels(runs, groups), len(rise))
        return np.concatenate([self.recursion_.run(rise[rows])[:, 0] for rows in slices])

    def start(self: _Self) -> _Self:
        """Begin a new run for `step` and return the estimator."""
        check_fitted(self, 'recursion_')
        self._stream = Stream(self.recursion_)
        return self

    def step(self, x: ArrayLike) -> float:
        """Take the rises of one sample, shape (p,) [K], and return the thermal error [m]."""
        return float(self._running().step(x)[0])

    def with_interval(self: _Self, interval: float) -> _Self:
        """Return a copy for another sampling interval [s].

        Raises
        ------
        ValueError
            If `interval` is not positive, or the model has no meaning at another interval.
        """
        check_fitted(self, 'recursion_')
        check_interval(interval)
        other = copy.copy(self)
        other.recursion_ = self.recursion_.with_interval(interval / self.interval)
        other.interval = interval
        other.__dict__.pop('_stream', None)
        return other

    def _running(self) -> Stream:
        check_fitted(self, 'recursion_')
        if not hasattr(self, '_stream'):
            self.start()
        return self._stream


def run_labels(runs: ArrayLike | None, groups: ArrayLike | None) -> ArrayLike | None:
    """Return the labels of runs, given by one word or by scikit-learn's.

    Raises
    ------
    ValueError
        If both are given.
    """
    if runs is not None and groups is not None:
        raise ValueError('groups: expected runs or groups, which mean the same, but found both')
    return groups if runs is None else runs


def check_training(
    estimator: Any,
    samples: ArrayLike,
    target: ArrayLike,
    runs: ArrayLike | None,
) -> tuple[Array, Array, list[slice]]:
    """Return rises (n, p), target (n,) and the rows of each run after checking them.

    Parameters
    ----------
    estimator : ThermalRegressor
        Estimator under training; it notes the number of inputs.
    samples, target, runs : array_like
        Arguments of `fit`; the target may hold NaN where nothing was measured.

    Raises
    ------
    ValueError
        If lengths disagree, or the target is absent, infinite or never measured.
    """
    measured = check_target(estimator, target)
    rise = check_features(estimator, samples, reset=True)
    if measured.shape != (len(rise),):
        raise ValueError(
            f'y: expected {len(rise)} values, one per sample, but found shape {measured.shape}'
        )
    if np.isnan(measured).all():
        raise ValueError('y: expected measured values, but found only NaN')
    return rise, measured, run_slices(runs, len(rise))


def check_sample_count(target: Array, parameters: int) -> None:
    """Refuse a target (n,) with no more measured samples than a fit has free parameters.

    Raises
    ------
    ValueError
        The message names the remedies.
    """
    count = int(np.isfinite(target).sum())
    if count <= parameters:
        raise ValueError(
            f'y: expected more than {parameters} measured samples for as many parameters, but '
            f'found {count} sample{"" if count == 1 else "s"}; record longer, use fewer sensors, '
            'or a ridge'
        )
