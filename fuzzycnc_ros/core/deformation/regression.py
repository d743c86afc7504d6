# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Simple models of feed compensation beside the network, and samples that fit none of them.

All are written as rules (`RuleNetwork`): ridge regression is a single rule with linear
consequents, a Gaussian process has a rule for each sample, and no correction a rule that says 0.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.features import feature_set, folded_samples, lapped, load
from fuzzycnc_ros.core.deformation.model import (
    SUPPORT_QUANTILE,
    Antecedent,
    AxisGain,
    DeformationModel,
    Gate,
    RuleNetwork,
)
from fuzzycnc_ros.core.deformation.training import robust_deviation
from fuzzycnc_ros.core.threads import single_threaded

PENALTIES = np.logspace(-6.0, 1.0, 15)
"""Penalties of the ridge regression, as shares of its largest squared singular value."""

PROCESS_MAX = 1000
"""Samples that a Gaussian process has at most; of more, evenly spread ones are taken."""

SEARCH_MAX = 150
"""Samples from which the scales of a Gaussian process are found; with 400 it is no better."""

CONTRADICTING = 14.0
"""Negative logarithm of the density, in mm per 50 mm, from which on a sample is an outlier [-].

That is 5.5 standard deviations of 0.2 mm and 4.9 of 1 mm: samples that scatter much reach farther
towards outliers.  On sheets of `benchmarks/soft_choice.py`, 200 samples by order, seeds 2000 to
2009, it misses 3 of 100 outliers, six standard deviations throughout miss 7.  Of 265 samples of
the simulated sheet it leaves out one honest one, where those leave out 0.7 (data seeds 4, 5 and
100 to 104).
"""

FEW = 100
"""Samples up to which each suspect is judged by models that were found without it [-].

Of more, the others outweigh an outlier, and models without each suspect take long.
"""

IMPROBABLE = 8.0
"""Gain of the likelihood of the others, as a logarithm, by leaving an outlier out [-].

An outlier lies anywhere within 10 mm, which is a density of exp(-5.75), and one sample in 20 is
one, which is odds of exp(-2.95).  One that is missed costs twice as much as an honest one that
is lost, exp(0.7).
"""

MEASURED_TO = 0.1
"""Scatter that samples have at least, however well the others explain them [mm per 50 mm].

A needle's hole in a soft sheet is not seen more exactly.  Without it, samples without noise
contradict each other by what a smooth model leaves of them.
"""

_SUSPECTS = 4

CONTRADICTING_MAX = 0.2
"""Largest share of outliers [-]; beyond it the samples contradict one another."""

_ROUNDS = 6
_LEAST = 8
"""Samples from which outliers can be told."""


@dataclass(frozen=True, eq=False)
class _Inputs:
    """Samples as a regression takes them: inputs that vary, and compensation per load."""

    rows: Array
    inputs: Array
    columns: tuple[int, ...]
    target: Array
    load: Array

    @staticmethod
    def of(rows: Array, s: Array, features: str) -> '_Inputs':
        chosen = feature_set(features)
        inputs = chosen.rows(rows)
        # Directions have no constant beside them, so that one which does not vary still counts.
        odd = features == 'directions'
        varies = np.abs(inputs).max(axis=0) > 0.0 if odd else np.ptp(inputs, axis=0) > 0.0
        varies[0] |= not varies.any()
        weight = load(*rows[:, [1, 3, 4]].T)
        columns = tuple(int(at) for at in np.flatnonzero(varies))
        return _Inputs(rows, inputs[:, varies], columns, s / weight[:, np.newaxis], weight)

    @property
    def scale(self) -> tuple[Array, Array]:
        """Mean and standard deviation of the inputs; 1 for what does not vary."""
        deviation = self.inputs.std(axis=0)
        return self.inputs.mean(axis=0), np.where(deviation > 1e-12, deviation, 1.0)

    def one_rule(self) -> Antecedent:
        """Return a rule amid the samples."""
        mean, deviation = self.scale
        return Antecedent(mean[np.newaxis], deviation[np.newaxis], 0.5, 2)

    def model(self, features: str, network: RuleNetwork, support: Array) -> DeformationModel:
        """Return a model with the gate of the samples, the first ones, that have a support."""
        gate = Gate.of_training(self.rows[: len(support)], support, SUPPORT_QUANTILE)
        return DeformationModel(features, self.columns, network, gate, AxisGain.unit(2))


def no_correction(x: Array, s: Array) -> DeformationModel:
    """Return a model that compensates nothing.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values.
    s : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    """
    rows, _ = folded_samples(x, s)
    data = _Inputs.of(rows, np.zeros_like(s), 'load')
    rule = data.one_rule()
    outer = np.zeros((2, len(data.columns) + 1, 1))
    network = RuleNetwork(rule, None, outer, np.zeros(2))
    return data.model('load', network, rule.support(data.inputs))


@single_threaded
def ridge_regression(x: Array, s: Array) -> DeformationModel:
    """Return the ridge regression on directions and their products with the other values.

    It is odd: opposite directions have opposite compensations without a sample of both.  The
    penalty has the least error on samples left out one by one.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values.
    s : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    """
    rows, s = folded_samples(x, s)
    data = _Inputs.of(rows, s, 'directions')
    size, left, singular, right = _decomposed(data)
    along = left.T @ s
    best = (np.inf, np.zeros(len(singular)))
    for penalty in PENALTIES * singular[0] ** 2:
        kept = singular**2 / (singular**2 + penalty)
        out = 1.0 - (left**2 @ kept)
        unseen = (s - left @ (kept[:, np.newaxis] * along)) / out[:, np.newaxis]
        error = float((unseen**2).sum())
        if error < best[0]:
            best = (error, singular / (singular**2 + penalty))
    slope = right.T @ (best[1][:, np.newaxis] * along) / size[:, np.newaxis]
    outer = np.concatenate([np.zeros((1, 2)), slope]).T[:, :, np.newaxis]
    rule = data.one_rule()
    network = RuleNetwork(rule, None, outer, np.zeros(2))
    return data.model('directions', network, rule.support(data.inputs))


def _decomposed(data: _Inputs) -> tuple[Array, Array, Array, Array]:
    """Return the sizes of the inputs, and the singular values of inputs per size times load."""
    size = np.sqrt((data.inputs**2).mean(axis=0))
    size = np.where(size > 0.0, size, 1.0)
    parts = np.linalg.svd(data.inputs / size * data.load[:, np.newaxis], full_matrices=False)
    return size, *parts


def _ridge_evidence(x: Array, s: Array) -> float:
    """Return the logarithm of the likelihood of samples by the best ridge regression of them.

    Slopes are normal numbers, whose variance is that of the noise over the penalty.
    """
    rows, s = folded_samples(x, s)
    _, left, singular, _ = _decomposed(_Inputs.of(rows, s, 'directions'))
    along, best = left.T @ s, -np.inf
    beside = float((s**2).sum() - (along**2).sum())
    for penalty in PENALTIES * singular[0] ** 2:
        wider = 1.0 + singular**2 / penalty
        off = beside + float((along**2 / wider[:, np.newaxis]).sum())
        variance = max(off / s.size, MEASURED_TO**2)
        found = -0.5 * (s.size * np.log(2.0 * np.pi * variance) + off / variance)
        best = max(best, float(found - np.log(wider).sum()))
    return best


@dataclass(frozen=True, eq=False)
class _Process:
    """A Gaussian process on scaled samples: length of each input, signal and noise variances.

    A sample is off by a share of its compensation, for sheets and feet scatter, and by what its
    stitches are measured with.  Per load the one is alike for all, the other falls with the load.

    Attributes
    ----------
    data : _Inputs
        Samples, some again beyond the ends of the half turn.
    target : ndarray, shape (k, 2)
        Scaled compensation per load.
    offset, spread : ndarray, shape (2,)
        What was taken from it, and what it was divided by.
    own : int
        How many of the samples, the first ones, are no repeated ones.
    length : ndarray, shape (n,)
        Length of each input.
    signal : float
        Variance of the process.
    noise : ndarray, shape (2,)
        Variance of a sample's share, and of its measurement at `usual` load.
    usual : float
        Median load.
    """

    data: _Inputs
    target: Array
    offset: Array
    spread: Array
    own: int
    length: Array
    signal: float
    noise: Array
    usual: float

    @staticmethod
    def of(x: Array, s: Array) -> '_Process':
        folded, s = folded_samples(x, s)
        taken, rows, sign = lapped(folded)
        data = _Inputs.of(rows, s[taken] * sign[:, np.newaxis], 'load')
        offset, spread = data.target.mean(axis=0), data.target.std(axis=0)
        spread = np.where(spread > 0.0, spread, 1.0)
        target = (data.target - offset) / spread
        _, deviation = data.scale
        scaled = data.inputs / deviation
        some = np.random.default_rng(0).permutation(len(scaled))[:SEARCH_MAX]
        usual = float(np.median(data.load))
        start = np.concatenate([np.full(scaled.shape[1], np.log(2.0)), [0.0, -1.5, -1.5]])
        found = minimize(
            _surprise,
            start,
            args=(scaled[some], target[some], _noises(usual, data.load[some])),
            jac=True,
            method='L-BFGS-B',
            bounds=[(-2.0, 5.0)] * scaled.shape[1] + [(-3.0, 3.0), (-5.0, 1.0), (-5.0, 1.0)],
            options={'maxiter': 40},
        ).x
        return _Process(
            data, target, offset, spread, len(x), np.exp(found[:-3]) * deviation,
            float(np.exp(2.0 * found[-3])), np.exp(2.0 * found[-2:]), usual,
        )  # fmt: skip

    @property
    def rules(self) -> Antecedent:
        """The kernel about the samples."""
        centre = self.data.inputs
        return Antecedent(centre, np.broadcast_to(self.length, centre.shape).copy(), 0.5, 2)

    def inverse(self) -> tuple[Array, Array]:
        """Return the kernel between the samples, of signal 1, and the inverse with its noise."""
        kernel = np.exp(self.rules.log_fitness(self.data.inputs))
        whole = self.signal * kernel
        whole.flat[:: len(whole) + 1] += self.noise @ _noises(self.usual, self.data.load) + _JITTER
        return kernel, cho_solve(cho_factor(whole), np.eye(len(whole)))

    def evidence(self) -> float:
        """Return the logarithm of the likelihood of the samples, in mm per 50 mm, none twice.

        They scatter by `MEASURED_TO` at least.
        """
        target, weight = self.target[: self.own], self.data.load[: self.own]
        whole = self.signal * np.exp(self.rules.log_fitness(self.data.inputs))
        whole = whole[: self.own, : self.own]
        whole.flat[:: self.own + 1] += self.noise @ _noises(self.usual, weight) + np.square(
            MEASURED_TO / (weight * self.spread.mean())
        )
        factor = cho_factor(whole)
        spread = np.log(np.diag(factor[0])) + np.log(2.0 * np.pi) / 2.0 + np.log(weight)
        off = 0.5 * float((target * cho_solve(factor, target)).sum())
        return -off - 2.0 * float(spread.sum()) - self.own * float(np.log(self.spread).sum())

    def variance(self, x: Array, inverse: Array) -> Array:
        """Return the variance of other samples, scaled as the target is, shape (k,)."""
        rows, _ = folded_samples(x, np.zeros((len(x), 2)))
        inputs = feature_set('load').rows(rows)[:, list(self.data.columns)]
        near = self.signal * np.exp(self.rules.log_fitness(inputs))
        known = np.einsum('ij,jk,ik->i', near, inverse, near)
        noise = self.noise @ _noises(self.usual, load(*x[:, [1, 3, 4]].T))
        return np.asarray(self.signal + noise - np.minimum(known, self.signal))

    def model(self, kernel: Array, inverse: Array) -> DeformationModel:
        """Return its mean as rules, from what `inverse` returns."""
        weight = self.signal * (inverse @ self.target) * self.spread
        network = RuleNetwork(
            self.rules, None, weight.T[:, np.newaxis], self.offset, normalised=False
        )
        # What the other samples say of each: its own kernel of 1 would hide that it stands alone.
        support = np.log(np.maximum(kernel.sum(axis=1) - 1.0, 1e-12))[: self.own]
        return self.data.model('load', network, support)


_JITTER = 1e-8
_LENGTH_PRIOR = (np.log(2.0), 1.5)
"""Mean and standard deviation of the logarithm of a length, of scaled inputs."""


def _noises(usual: float, weight: Array) -> Array:
    """Return what a unit of either noise adds to samples of some loads, shape (2, k)."""
    return np.stack([np.ones(len(weight)), (usual / weight) ** 2])


def _surprise(
    parameters: Array, inputs: Array, target: Array, noises: Array
) -> tuple[float, Array]:
    """Return the negative log posterior of lengths, signal and noises, and its gradient."""
    length, signal = np.exp(parameters[:-3]), float(np.exp(2.0 * parameters[-3]))
    noise = np.exp(2.0 * parameters[-2:])
    apart = ((inputs[:, np.newaxis] - inputs) / length) ** 2
    kernel = signal * np.exp(-0.5 * apart.sum(axis=-1))
    whole = kernel + np.diag(noise @ noises + _JITTER)
    factor = cho_factor(whole, lower=True)
    solved = cho_solve(factor, target)
    pull = target.shape[1] * cho_solve(factor, np.eye(len(whole))) - solved @ solved.T
    mean, deviation = _LENGTH_PRIOR
    unlikely = (parameters[:-3] - mean) / deviation
    cost = 0.5 * float((target * solved).sum()) + 0.5 * float(unlikely @ unlikely)
    cost += target.shape[1] * float(np.log(np.diag(factor[0])).sum())
    slope = np.empty_like(parameters)
    slope[:-3] = 0.5 * np.einsum('ij,ijk->k', pull * kernel, apart) + unlikely / deviation
    slope[-3], slope[-2:] = (pull * kernel).sum(), noise * (noises @ np.diag(pull))
    return cost, slope


@single_threaded
def gaussian_process(x: Array, s: Array) -> DeformationModel:
    """Return the mean of a Gaussian process on directions, depth ratio, thickness, kind and step.

    Its kernel is squared exponential with a length for each input, found with signal and noise
    by the marginal likelihood of both outputs.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values.
    s : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    """
    if len(x) > PROCESS_MAX:
        some = np.linspace(0, len(x) - 1, PROCESS_MAX).astype(int)
        x, s = x[some], s[some]
    process = _Process.of(x, s)
    return process.model(*process.inverse())


@single_threaded
def outlying(x: Array, s: Array) -> NDArray[np.bool_]:
    """Return which samples contradict all others, shape (k,).

    A Gaussian process predicts each sample from the others; what is less probable than
    `CONTRADICTING` is left out of the next round, until nothing changes.  The standard deviation
    is the middle one of three: the robust deviation of compensations, that of compensations per
    load, and what the process expects of the sample, which is right where loads differ much.  Few
    samples are judged one by one.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values.
    s : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    """
    out = np.zeros(len(x), bool)
    if not _LEAST <= len(x) <= PROCESS_MAX:
        return out
    if len(x) <= FEW:
        return _outlying_of_few(x, s)
    weight = load(*x[:, [1, 3, 4]].T)
    for _ in range(_ROUNDS):
        left, expected = _unexplained(x, s, out)
        distance = np.hypot(*left.T)
        by_load = _scaled(distance / weight, out, MEASURED_TO / float(np.median(weight)))
        scores = [_scaled(distance, out, MEASURED_TO), by_load, _surprise_in(left, expected)]
        score = np.maximum(np.median(scores, axis=0), 1e-9)
        deviation = np.maximum(distance / score, MEASURED_TO)
        now = 0.5 * score**2 + np.log(2.0 * np.pi * deviation**2) > CONTRADICTING
        if now.mean() > CONTRADICTING_MAX:
            return np.zeros(len(x), bool)
        if (now == out).all():
            break
        out = now
    return out


def _outlying_of_few(x: Array, s: Array) -> NDArray[np.bool_]:
    """Return which of few samples contradict the others, the worst first.

    With an outlier among its samples, a model takes it for noise or bends towards it: so models
    with and without each suspect are compared by how likely they make the samples.
    """
    out = np.zeros(len(x), bool)
    known = _evidence(x, s)
    while out.mean() <= CONTRADICTING_MAX:
        surprise = _surprise_in(*_unexplained(x, s, out))
        evidence = {}
        for suspect in np.argsort(np.where(out, 0.0, surprise))[-_SUSPECTS:].tolist():
            kept = ~out
            kept[suspect] = False
            evidence[suspect] = _evidence(x[kept], s[kept])
        worst = max(evidence, key=evidence.__getitem__)
        if evidence[worst] - known <= IMPROBABLE:
            return out
        out[worst], known = True, evidence[worst]
    return np.zeros(len(x), bool)


def _evidence(x: Array, s: Array) -> float:
    """Return the logarithm of the likelihood of samples, the mean of both kinds of models.

    By a process alone 97 % of single outliers among 20 are found and by both 99 %, with 12 instead
    of 18 honest ones in 100 sets, on sheets of seeds 3000 to 3023 of `benchmarks/soft_choice.py`.
    """
    return 0.5 * (_Process.of(x, s).evidence() + _ridge_evidence(x, s))


def _surprise_in(left: Array, deviation: Array) -> Array:
    """Return differences, shape (k, 2), in standard deviations that are expected, (k,)."""
    return np.asarray(np.hypot(*(left / np.maximum(deviation, MEASURED_TO)).T))


def _unexplained(x: Array, s: Array, out: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return what a process of the samples that are not out leaves of each, left out itself.

    Returns
    -------
    left, deviation : ndarray, shape (k, 2)
        The difference, and the standard deviation that the process expects [mm per 50 mm].
    """
    process = _Process.of(x[~out], s[~out])
    kernel, inverse = process.inverse()
    left, variance = np.empty_like(s), np.empty(len(x))
    own = np.diag(inverse)[: process.own]
    weight = load(*x[:, [1, 3, 4]].T)[:, np.newaxis] * process.spread
    left[~out] = (inverse @ process.target)[: process.own] / own[:, np.newaxis] * weight[~out]
    variance[~out] = 1.0 / own
    if out.any():
        left[out] = process.model(kernel, inverse).predict(x[out]) - s[out]
        variance[out] = process.variance(x[out], inverse)
    return left, np.sqrt(variance)[:, np.newaxis] * weight


def _scaled(distance: Array, out: NDArray[np.bool_], least: float) -> Array:
    """Return distances over their robust standard deviation, of those that are not out."""
    return np.asarray(distance / max(robust_deviation(distance[~out]), least))
