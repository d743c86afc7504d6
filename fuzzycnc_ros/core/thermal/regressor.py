# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What all thermal models of one channel share: input checks, prediction, streaming."""

import copy
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.estimator import Estimator, check_features, check_fitted
from fuzzycnc_ros.core.thermal.recursions import (
    Recursion,
    Stream,
    check_interval,
    run_slices,
)

Self = TypeVar('Self', bound='ThermalRegressor')


class ThermalRegressor(Estimator):
    """Base of the models that map rises to the thermal error of one channel.

    A subclass learns `recursion_` in `fit`; everything else follows from that.
    """

    interval: float
    recursion_: Recursion

    def predict(self, X: ArrayLike, *, runs: ArrayLike | None = None) -> Array:  # noqa: N803
        """Return the thermal error of whole runs, each from its own start.

        Parameters
        ----------
        X : array_like, shape (n, p)
            Rises [K].
        runs : array_like, shape (n,), optional
            Label of the run that each sample belongs to; one run if absent.

        Returns
        -------
        ndarray, shape (n,)
            Thermal error in the unit of the training target [m].
        """
        check_fitted(self, 'recursion_')
        rise = check_features(self, X, reset=False)
        return np.concatenate(
            [self.recursion_.run(rise[rows])[:, 0] for rows in run_slices(runs, len(rise))]
        )

    def start(self: Self) -> Self:
        """Begin a new run for `step` and return the estimator."""
        check_fitted(self, 'recursion_')
        self._stream = Stream(self.recursion_)
        return self

    def step(self, x: ArrayLike) -> float:
        """Take the rises of one sample, shape (p,) [K], and return the thermal error [m]."""
        return float(self._running().step(x)[0])

    def get_state(self) -> Array:
        """Return the recursion's state as a flat array."""
        return self._running().state

    def set_state(self, state: ArrayLike) -> None:
        """Resume from a state that `get_state` returned."""
        self._running().state = np.asarray(state, dtype=np.float64)

    def with_interval(self: Self, interval: float) -> Self:
        """Return a copy for another sampling interval [s], method sheet 001 section 3.1.

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


def check_training(
    estimator: Any,
    samples: ArrayLike,
    target: ArrayLike,
    runs: ArrayLike | None,
    parameters_max: int | None = None,
) -> tuple[Array, Array, list[slice]]:
    """Return rises (n, p), target (n,) and the rows of each run after checking them.

    Parameters
    ----------
    estimator : ThermalRegressor
        Estimator under training; it notes the number of inputs.
    samples, target, runs : array_like
        Arguments of `fit`; the target may hold NaN where nothing was measured.
    parameters_max : int, optional
        Number of free parameters that must stay below the number of measured samples; absent
        where a ridge makes the fit well posed.

    Raises
    ------
    ValueError
        If lengths disagree, the target is infinite or never measured, or there are too few
        samples.
    """
    rise = check_features(estimator, samples, reset=True)
    measured = np.asarray(target, dtype=np.float64)
    if measured.shape != (len(rise),):
        raise ValueError(
            f'y: expected {len(rise)} values, one per sample, but found shape {measured.shape}'
        )
    if np.isinf(measured).any():
        raise ValueError('y: expected finite values or NaN, but found infinity')
    count = int(np.isfinite(measured).sum())
    if count == 0:
        raise ValueError('y: expected measured values, but found only NaN')
    if parameters_max is not None and count <= parameters_max:
        raise ValueError(
            f'y: expected more than {parameters_max} measured samples for as many parameters, '
            f'but found {count}; record longer, use fewer sensors, or a ridge'
        )
    return rise, measured, run_slices(runs, len(rise))
