# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""ANFIS, the adaptive neuro-fuzzy system, as a model of the thermal error and as a corrector."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from fuzzycnc_ros.core.arrays import Array, Seed
from fuzzycnc_ros.core.fuzzy.clustering import FuzzyCMeans
from fuzzycnc_ros.core.fuzzy.takagi_sugeno import Premises, TrainedRules, train_rules
from fuzzycnc_ros.core.thermal.domain import RISE_NOISE
from fuzzycnc_ros.core.thermal.fit.grey import GreyModel
from fuzzycnc_ros.core.thermal.fit.linear import check_ridge, column_scale
from fuzzycnc_ros.core.thermal.fit.regressor import ThermalRegressor
from fuzzycnc_ros.core.thermal.recursions.base import check_interval
from fuzzycnc_ros.core.thermal.recursions.rules import CorrectedRecursion, RulesRecursion

RULES = ('fcm', 'grid')
"""Origins of the rules."""

GRID_INPUTS_MAX = 8
"""Most inputs of a grid: 2^8 rules with 9 consequents each."""

WIDTH_MIN = 0.1
"""Floor of the widths, as a fraction of the input's standard deviation [-]."""

STEP = 0.01
"""First step of the sets' gradient descent, in standard deviations of the inputs [-]."""

EDGE_QUANTILE = 0.99
"""Share of the training samples inside the edge of the corrector's domain [-]."""

FADE = 1.5
"""Distance at which the corrector is off, in units of the edge of its training domain [-]."""


@dataclass(kw_only=True, eq=False, repr=False)
class Anfis(ThermalRegressor):
    """Adaptive neuro-fuzzy inference system on the rises.

    docs/explanation/methods/thermal-fuzzy-and-grey.md says what it is worth.

    Parameters
    ----------
    rules : {'fcm', 'grid'}
        'fcm' has one rule per cluster of the training rises, by fuzzy c-means; 'grid' has one
        for each combination of a low and a high set of every input, 2^p in all.
    n_rules : int
        Number of rules of 'fcm'; 'grid' has its own.
    ridge : float
        Penalty on the consequents of the scaled rises, per sample [-].
    epochs : int
        Steps of hybrid learning, 0 or more; 0 fits the consequents only.
    interval : float
        Sampling interval of the training samples [s].  The rules have no memory and hold at
        every interval.
    random_state : int, numpy.random.Generator or None
        Seed of the clustering.

    Attributes
    ----------
    cost_ : ndarray, shape (at most epochs + 1,)
        Mean square error plus penalty over the epochs, relative to the target's variance [-];
        the least one is kept.
    support_ : ndarray, shape (r,)
        Samples that each rule rests on: the sum of its normalised firing strengths [-].
    problems_ : tuple of str
        Why the fit is not to be trusted; empty if it is.

    Notes
    -----
    Outside its training data a rule goes on linearly, by weights that were never tried there.
    Trained on one duty of the simulated mill it was the worst model on the most different one:
    10.3/12.8 um, the stable grey model 3.8/7.3 um.

    Examples
    --------
    >>> rise = np.linspace(0.0, 10.0, 80)[:, np.newaxis]
    >>> bent = 1e-6 * np.maximum(rise[:, 0] - 5.0, 0.0)
    >>> model = Anfis(n_rules=2, ridge=1e-6).fit(rise, bent)
    >>> print(bool(np.abs(model.predict(rise) - bent).max() < 0.2e-6))
    True
    """

    rules: str = 'fcm'
    n_rules: int = 3
    ridge: float = 1e-3
    epochs: int = 50
    interval: float = 60.0
    random_state: Seed = 0

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        self._check_parameters(rise.shape[1])
        measured = np.isfinite(target)
        rise, target = rise[measured], target[measured]
        scale = column_scale(rise)
        unit = float(target.std()) or 1.0
        trained = train_rules(
            rise / scale,
            target / unit,
            self._premises(rise / scale),
            ridge=self.ridge,
            epochs=self.epochs,
            step=STEP,
            width_min=WIDTH_MIN,
        )
        center, width = trained.premises.of_rules()
        self.recursion_: RulesRecursion = RulesRecursion(
            center=(center * scale)[np.newaxis],
            width=(width * scale)[np.newaxis],
            slope=(unit * trained.slope / scale)[np.newaxis],
            offset=(unit * trained.offset)[np.newaxis],
        )
        self.cost_ = trained.cost
        self.support_ = trained.support
        self.problems_ = _problems(trained)

    def _premises(self, inputs: Array) -> Premises:
        if self.rules == 'grid':
            return grid_premises(inputs)
        return cluster_premises(inputs, self.n_rules, self.random_state)

    def _check_parameters(self, inputs: int) -> None:
        check_ridge(self.ridge)
        check_interval(self.interval)
        if self.rules not in RULES:
            raise ValueError(
                f'rules: expected one of {", ".join(RULES)}, but found {self.rules!r}'
            )
        if self.epochs < 0:
            raise ValueError(f'epochs: expected 0 or more, but found {self.epochs}')
        if self.rules == 'grid' and inputs > GRID_INPUTS_MAX:
            raise ValueError(
                f'rules: expected at most {GRID_INPUTS_MAX} inputs for a grid, but found '
                f'{inputs}, which makes 2^{inputs} rules; use fcm or choose fewer sensors'
            )


@dataclass(kw_only=True, eq=False, repr=False)
class GreyAnfis(ThermalRegressor):
    """Stable grey model whose residual an ANFIS corrects, inside the domain of its training.

    Parameters
    ----------
    n_rules : int
        Number of rules of the corrector.
    ridge : float
        Penalty of the grey model per sample [-].
    corrector_ridge : float
        Penalty on the consequents of the corrector per sample [-].
    epochs : int
        Steps of hybrid learning of the corrector.
    fade : float
        Distance from the training data at which the corrector is off, above 1, in units of the
        distance that 99 % of them stay below; up to there it is on, between both it fades.
    interval : float
        Sampling interval of the training samples [s].
    random_state : int, numpy.random.Generator or None
        Seed of the clustering.

    Attributes
    ----------
    grey_ : GreyModel
        The fitted grey model.
    anfis_ : Anfis
        The fitted corrector.
    problems_ : tuple of str
        Why either is not to be trusted; empty if both are.

    Notes
    -----
    The published text has both models but does not say how they are joined.  In series the
    corrector learns what the grey model leaves
    (docs/explanation/methods/thermal-fuzzy-and-grey.md).
    """

    n_rules: int = 3
    ridge: float = 1e-3
    corrector_ridge: float = 1e-3
    epochs: int = 50
    fade: float = FADE
    interval: float = 60.0
    random_state: Seed = 0

    def _fit(self, rise: Array, target: Array, rows: list[slice]) -> None:
        if not (np.isfinite(self.fade) and self.fade > 1.0):
            raise ValueError(f'fade: expected a number above 1, but found {self.fade}')
        self.grey_ = GreyModel('stable', interval=self.interval, ridge=self.ridge)
        runs = np.repeat(np.arange(len(rows)), [run.stop - run.start for run in rows])
        self.grey_.fit(rise, target, runs=runs)
        residual = target - self.grey_.predict(rise, runs=runs)
        self.anfis_ = Anfis(
            n_rules=self.n_rules,
            ridge=self.corrector_ridge,
            epochs=self.epochs,
            interval=self.interval,
            random_state=self.random_state,
        )
        self.anfis_.fit(rise, residual)
        mean, whitening, limit = mahalanobis(rise[np.isfinite(target)])
        self.recursion_: CorrectedRecursion = CorrectedRecursion(
            base=self.grey_.recursion_,
            corrector=self.anfis_.recursion_,
            mean=mean[np.newaxis],
            whitening=whitening[np.newaxis],
            inner=np.array([limit]),
            outer=np.array([self.fade * limit]),
        )
        self.problems_ = self.grey_.problems_ + self.anfis_.problems_


def mahalanobis(rise: Array) -> tuple[Array, Array, float]:
    """Return the mean of rises (n, p) [K], what whitens them (p, p), and 99 % of the distances."""
    mean = np.asarray(rise.mean(axis=0), dtype=np.float64)
    covariance = np.atleast_2d(np.cov(rise, rowvar=False))
    # Collinear sensors differ by less than their noise, which says nothing of the domain.
    inverse = np.linalg.inv(covariance + RISE_NOISE**2 * np.eye(len(mean)))
    apart = rise - mean
    distance = np.sqrt(np.maximum(((apart @ inverse) * apart).sum(axis=-1), 0.0))
    whitening = np.asarray(np.linalg.cholesky(inverse)).T
    return mean, whitening, float(np.quantile(distance, EDGE_QUANTILE))


def cluster_premises(inputs: Array, n_rules: int, random_state: Seed) -> Premises:
    """Return one rule per cluster of the inputs (n, p), as wide as its members are spread."""
    clustering = FuzzyCMeans(n_rules, random_state=random_state).fit(inputs)
    weight = clustering.membership_**clustering.m
    center = clustering.cluster_centers_
    apart = (inputs[:, np.newaxis, :] - center) ** 2
    variance = np.einsum('kr,krp->rp', weight, apart) / weight.sum(axis=0)[:, np.newaxis]
    index = np.repeat(np.arange(n_rules)[:, np.newaxis], inputs.shape[1], axis=1)
    return Premises(center, np.maximum(np.sqrt(variance), WIDTH_MIN), index)


def grid_premises(inputs: Array) -> Premises:
    """Return the rules of all combinations of two sets per input (n, p).

    The sets sit at both ends of the training inputs and meet half way at a membership of 1/2.
    """
    center = np.stack([inputs.min(axis=0), inputs.max(axis=0)])
    half = (center[1] - center[0]) / 2.0
    width = np.maximum(half / np.sqrt(2.0 * np.log(2.0)), WIDTH_MIN)
    index = np.array(list(product((0, 1), repeat=inputs.shape[1])), dtype=np.int64)
    return Premises(center, np.stack([width, width]), index)


def _problems(trained: TrainedRules) -> tuple[str, ...]:
    coefficients = trained.slope.shape[1] + 1
    weak = int((trained.support < coefficients).sum())
    if not weak:
        return ()
    return (
        f'{weak} of {len(trained.support)} rules rest on fewer samples than their '
        f'{coefficients} coefficients: they repeat the training noise',
    )
