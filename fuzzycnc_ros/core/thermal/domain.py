# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Domain of the training of a model, so that it can say when it extrapolates.

The rises of many sensors lie near a few directions: what heats a machine heats it in few ways.
Two distances tell whether a sample does so too: Hotelling's T along these directions, and the
squared prediction error (Q statistic) across them.

References
----------
[jackson1979]
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import LENGTH_MIN, NUMBER_MAX, Array, check_bounds
from fuzzycnc_ros.core.thermal.moments import Fold

DOMAIN_QUANTILE = 0.95
"""Share of the samples of unseen training runs that lie in the domain."""

DOMAIN_MARGIN, SPEED_MARGIN = 3.0, 1.4
"""Distance from the training, and spindle speed over the largest of it, up to which a model may be
used on a machine [-]; 1 is the border of what it was trained on."""

EXPLAINED = 0.99
"""Share of the variance of the training rises that the kept directions explain."""

RISE_NOISE = 0.1
"""Standard deviation below which differences between sensors are noise [K]."""


@dataclass(frozen=True, eq=False)
class Domain:
    """Rises that the model was trained on: an ellipsoid in few directions, thin in all others.

    Parameters
    ----------
    mean : ndarray, shape (p,)
        Mean rise of each input [K].
    directions : ndarray, shape (k, p)
        Orthonormal directions in which the training rises spread.
    reach : ndarray, shape (k,)
        Distance from the mean along each direction that is at the border of the domain [K].
    thickness : float
        Distance across all directions that is at the border of the domain [K]; infinite where
        the directions span everything.
    drive : ndarray, shape (d,)
        Largest driver that it was trained on [-]; empty where the model reads none.
    """

    mean: Array
    directions: Array
    reach: Array
    thickness: float
    drive: Array = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        """Refuse numbers that would put every sample into the domain, or none.

        Raises
        ------
        ValueError
            The message names the number and its bounds.
        """
        if self.directions.shape != (len(self.reach), len(self.mean)):
            raise ValueError(
                f'directions: expected {len(self.reach)} rows of {len(self.mean)}, but found '
                f'shape {self.directions.shape}'
            )
        check_bounds(
            self,
            mean=(-NUMBER_MAX, NUMBER_MAX),
            directions=(-NUMBER_MAX, NUMBER_MAX),
            reach=(LENGTH_MIN, NUMBER_MAX),
            thickness=(LENGTH_MIN, np.inf),
            drive=(0.0, NUMBER_MAX),
        )

    def scaled(self, along: float, across: float) -> 'Domain':
        """Return the domain whose border lies at other multiples of reach and thickness."""
        return replace(self, reach=self.reach * along, thickness=self.thickness * across)

    def parts(self, rise: Array) -> tuple[Array, Array]:
        """Return how far rises (..., p) lie along and across the directions, in borders [-]."""
        apart = rise - self.mean
        score = portable.matmul(apart, self.directions.T)
        along = np.sqrt(((score / self.reach) ** 2).sum(axis=-1))
        square = (apart**2).sum(axis=-1) - (score**2).sum(axis=-1)
        return np.asarray(along), np.asarray(np.sqrt(np.maximum(square, 0.0)) / self.thickness)

    def distance(self, samples: Array) -> Array:
        """Return the distance of rises [K] and, behind them, drivers [-] from the training.

        Parameters
        ----------
        samples : ndarray, shape (..., p) or (..., p + d)
            Rises, or rises and drivers.

        Returns
        -------
        ndarray, shape (...)
            1 at the border of the domain [-]: the larger one of both distances of the rises and
            of the ratio of each driver to the largest that it was trained on.
        """
        inputs = len(self.mean)
        distance = np.maximum(*self.parts(samples[..., :inputs]))
        if samples.shape[-1] == inputs or not len(self.drive):
            return np.asarray(distance)
        # A driver that was only ever noise says nothing of what it was trained on.
        trained_on = np.where(self.drive > LENGTH_MIN, self.drive, np.inf)
        ratio = samples[..., inputs:] / trained_on[: samples.shape[-1] - inputs]
        return np.asarray(np.maximum(distance, ratio.max(axis=-1)))


def trained_domain(
    rise: Array,
    drive: Array,
    trained: NDArray[np.bool_],
    block: NDArray[np.int64],
    folds: Sequence[Fold],
) -> tuple[Domain, list[Array]]:
    """Describe training rises so that unseen runs of the same machine lie in the domain.

    Parameters
    ----------
    rise : ndarray, shape (n, p)
        Rises of the inputs [K].
    drive : ndarray, shape (n, d)
        Drivers [-].
    trained : ndarray of bool, shape (n,)
        Samples that were trained on.
    block : ndarray, shape (n,)
        Stretch of each sample.
    folds : sequence of Fold
        Stretches to learn from and to try in turn.

    Returns
    -------
    domain : Domain
        Its border holds 95 % of the samples of stretches that it was not learnt from.
    distance : list of ndarray
        Distance of the tried samples of each fold from the domain without them, in borders of
        the whole one [-].
    """
    apart = []
    for fold in folds:
        learnt = trained & np.isin(block, fold.train)
        tried = np.isin(block, fold.test)
        part = _ellipsoid(rise[learnt])
        apart.append((*part.parts(rise[tried]), trained[tried]))
    domain = _ellipsoid(rise[trained])
    own = domain.parts(rise[trained])
    limits = [
        max(
            _limit(own[number]),
            _limit(np.concatenate([item[number][item[2]] for item in apart])),
        )
        for number in range(2)
    ]
    # Nothing but rounding lies off the directions where they span everything.
    limits = [limit if limit * RISE_NOISE > LENGTH_MIN else 1.0 for limit in limits]
    distance = [np.maximum(item[0] / limits[0], item[1] / limits[1]) for item in apart]
    largest = np.asarray(drive[trained].max(axis=0))
    return replace(domain.scaled(*limits), drive=largest), distance


def _ellipsoid(rise: Array) -> Domain:
    """Return directions and standard deviations of rises (n, p), not yet scaled to a border."""
    mean = np.asarray(rise.mean(axis=0), dtype=np.float64)
    _, singular, directions = np.linalg.svd(rise - mean, full_matrices=False)
    deviation = singular / np.sqrt(len(rise))
    share = np.cumsum(deviation**2) / max(float((deviation**2).sum()), 1e-12)
    kept = 1 + int(np.searchsorted(share, EXPLAINED))
    kept = max(1, min(kept, int((deviation > RISE_NOISE).sum())))
    rest = float(np.sqrt((deviation[kept:] ** 2).sum()))
    return Domain(
        mean=mean,
        directions=np.asarray(directions[:kept]),
        reach=np.hypot(deviation[:kept], RISE_NOISE),
        # Collinear sensors differ by less than their noise, which says nothing of the domain.
        thickness=float(np.hypot(rest, RISE_NOISE * np.sqrt(len(mean)))),
    )


def _limit(distance: Array) -> float:
    return float(np.quantile(distance, DOMAIN_QUANTILE)) if len(distance) else 0.0
