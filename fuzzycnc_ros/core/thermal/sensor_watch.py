# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Slow sensor faults, judged by all other sensors of the machine.

A sensor that drifts by 2 K an hour passes every check of range and rate.  Its mates see it: two
groups of them, which share no sensor, each estimate its rise from theirs.  What both miss to the
same side counts; one faulty mate speaks in one group only.

How far the groups miss a healthy sensor was learnt on held-out runs, for each input by itself: a
limit of 0.5 K where the mates know it well, several times as much where they do not.  Beyond the
distance from the training that the held-out samples had, the limit grows with the distance.
Above the limit, the excess is summed over time: a jump is found in the second sample, a drift
soon after it has passed the limit, and a short excursion is forgotten.

Of 144 healthy runs of the mill that were never trained on (T2 and T3, 72 noise seeds) two raised
a false alarm.  A drift of 2 K/h was found after 26 min in the median, after 24 min where the mates
know the sensor well, and after 77 min at T67, half of whose heat no other sensor sees.
"""

from collections import defaultdict
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import LENGTH_MIN, NUMBER_MAX, Array, check_bounds, check_shapes
from fuzzycnc_ros.core.document import Node


@dataclass(frozen=True)
class InputCluster:
    """Sensors that warm up alike, the one that speaks for them, and who may stand in.

    Parameters
    ----------
    member : tuple of str
        Sensors of the cluster, best ranked first.
    score : tuple of float
        Rank score of each member in [0, 1] [-].
    chosen : str
        Sensor that stands for the cluster.
    substitute : tuple of str
        Mates that may replace the chosen sensor, best first.
    gain : tuple of float
        Rise of the chosen sensor = gain * rise of the substitute [-].
    correlation : tuple of float
        Correlation of the rises in training [-].
    """

    member: tuple[str, ...]
    score: tuple[float, ...]
    chosen: str
    substitute: tuple[str, ...]
    gain: tuple[float, ...]
    correlation: tuple[float, ...]


@dataclass(frozen=True)
class InputSelection:
    """The chosen sensors and the clusters that they stand for.

    Parameters
    ----------
    method : str
        'correlation', 'grey_grade', or 'all' where every usable sensor is an input.
    clusters : tuple of InputCluster
        One entry per input, in the order of the inputs.
    partition_coefficient : float
        Partition coefficient of the clustering, in [1/c, 1] [-]; 1 is crisp.
    xie_beni : float
        Xie-Beni index [-]; smaller is better, NaN if undefined.
    dropped : tuple of str
        Sensors left out because they never warmed by 0.5 K.
    calibration : tuple of str
        Runs that the selection rests on.
    """

    method: str
    clusters: tuple[InputCluster, ...]
    partition_coefficient: float
    xie_beni: float
    dropped: tuple[str, ...]
    calibration: tuple[str, ...]

    @property
    def chosen(self) -> tuple[str, ...]:
        """The chosen sensors, one per cluster."""
        return tuple(cluster.chosen for cluster in self.clusters)


MATE_RIDGE = 1e-4
"""Penalty on the weights of mates that are scaled to a mean square of 1 [-].

On duties that no figure is quoted for, 1e-3 missed the spindle's sensors by up to 1.2 K where
1e-4 missed them by 1.0 K, as it shrinks towards zero what rises by 13 K."""

LEVERAGE_RIDGE = 0.1
"""Penalty in the distance of a sample from the training samples [-]: the noise of a sensor that
hardly warms, a mean square of about 0.004 when scaled, must not count as distance."""

VOTERS = 2
"""Groups of mates that judge a sensor, each on its own."""

Indices = NDArray[np.int64]


def moment_of(rise: Array) -> Array:
    """Return the sums of products of rises (n, s) [K], shape (s, s) [K^2]."""
    return np.asarray(portable.matmul(rise.T, rise))


MOMENT_MIN = 1e-9
"""Least mean square of a sensor that rose at all [K^2]."""

MOMENT_ROUNDING = 1e-6
"""Excess that moments have from being rounded in a file [K^2]."""


def _is_moment(moment: Array) -> bool:
    """Return whether a matrix can hold mean products of rises; see `MATE_RIDGE`, its tolerance."""
    square = np.diag(moment)
    if (moment != moment.T).any() or not ((square == 0.0) | (square >= MOMENT_MIN)).all():
        return False
    scale = _scale_of(moment)
    alike = moment / np.outer(scale, scale)
    rounding = len(moment) * MOMENT_ROUNDING / float((scale * scale).min(initial=1.0))
    return bool(np.linalg.eigvalsh(alike).min(initial=0.0) > -0.5 * MATE_RIDGE - rounding)


def _scale_of(moment: Array) -> Array:
    """Return the root mean square of each sensor's rise, 1 for one that never rose, shape (s,)."""
    scale = np.sqrt(np.diag(moment))
    return np.where(scale > 0.0, scale, 1.0)


def _ranked_mates(moment: Array, target: int, usable: Indices) -> Indices:
    """Return the usable sensors but the target, the one most alike first."""
    alike = moment[target] / _scale_of(moment)
    mates = usable[usable != target]
    return np.asarray(mates[np.argsort(-alike[mates], kind='stable')])


def mate_weights(moment: Array, target: int | Indices, mates: Indices) -> Array:
    """Return the weights of mates in the ridge estimate of a target's rise, shape (..., k) [-].

    Parameters
    ----------
    moment : ndarray, shape (s, s)
        Mean products of the rises in training [K^2].
    target : int or ndarray of int, shape (...)
        Sensor to estimate.
    mates : ndarray of int, shape (..., k)
        Sensors to estimate it from.
    """
    one, other = mates[..., :, np.newaxis], mates[..., np.newaxis, :]
    scale = _scale_of(moment)
    alike = moment[one, other] / (scale[one] * scale[other])
    own = moment[np.asarray(target)[..., np.newaxis, np.newaxis], one] / scale[one]
    weights = portable.solve(alike + MATE_RIDGE * np.eye(mates.shape[-1]), own) / scale[one]
    return np.asarray(weights[..., 0])


def unexplained(moment: Array, target: int, mates: Indices, weights: Array) -> float:
    """Return the root mean square of what an estimate misses in training [K]."""
    seen = portable.matmul(moment[target, mates], weights)
    square = moment[target, target] - 2.0 * seen
    square += portable.matmul(portable.matmul(weights, moment[np.ix_(mates, mates)]), weights)
    return float(np.sqrt(max(square, 0.0)))


def voter_weights(moment: Array, targets: Indices, usable: Indices) -> Array:
    """Return what each voter expects of each target per kelvin of each sensor.

    The mates are dealt out to the voters in turn, best first, so that each voter has some from
    every part of the machine and no sensor speaks twice.

    Parameters
    ----------
    moment : ndarray, shape (s, s)
        Mean products of the rises in training [K^2].
    targets : ndarray of int, shape (p,)
        Sensors that are judged; they need not be usable.
    usable : ndarray of int
        Sensors that can be mates.

    Returns
    -------
    ndarray, shape (voters, p, s)
        Weights [-]; all NaN for a target with fewer usable mates than voters.
    """
    weights = np.zeros((VOTERS, len(targets), len(moment)))
    # Groups of one size are solved together.
    alike: dict[int, list[tuple[int, int, Indices]]] = defaultdict(list)
    for row, target in enumerate(targets):
        mates = _ranked_mates(moment, int(target), usable)
        if len(mates) < VOTERS:
            weights[:, row] = np.nan
            continue
        for voter in range(VOTERS):
            group = mates[voter::VOTERS]
            alike[len(group)].append((voter, row, group))
    for found in alike.values():
        groups = np.array([group for _, _, group in found])
        of = mate_weights(moment, targets[[row for _, row, _ in found]], groups)
        for (voter, row, group), weight in zip(found, of, strict=True):
            weights[voter, row, group] = weight
    return weights


def agreed(residual: Array) -> Array:
    """Return what both voters miss to the same side: the smaller of the two, else 0.

    Parameters
    ----------
    residual : ndarray, shape (..., 2, p)
        What each voter misses [K].

    Returns
    -------
    ndarray, shape (..., p)
        What they agree on [K].
    """
    one, other = residual[..., 0, :], residual[..., 1, :]
    low, high = np.minimum(one, other), np.maximum(one, other)
    return np.asarray(np.maximum(low, 0.0) + np.minimum(high, 0.0))


class Leverage:
    """Distance of a sample of rises from the training samples, as its mates see it.

    Parameters
    ----------
    moment : ndarray, shape (s, s)
        Mean products of the rises in training [K^2].
    targets : ndarray of int, shape (p,)
        Sensors that are judged.
    usable : ndarray of int
        Sensors that may be read.
    """

    def __init__(self, moment: Array, targets: Indices, usable: Indices) -> None:
        scale = _scale_of(moment)[usable]
        alike = moment[np.ix_(usable, usable)] / np.outer(scale, scale)
        inverse = portable.solve(alike + LEVERAGE_RIDGE * np.eye(len(usable)), np.eye(len(usable)))
        self.metric = np.zeros_like(moment)
        """Inverse of the penalised moments, shape (s, s) [1/K^2]; 0 for what is not usable."""
        self.metric[np.ix_(usable, usable)] = inverse / np.outer(scale, scale)
        self._targets = targets
        own = np.diag(self.metric)[targets]
        # A target that is not usable is no part of the distance: nothing is to be taken off.
        self._share = np.where(own > 0.0, 1.0 / np.where(own > 0.0, own, 1.0), 0.0)

    def of(self, rise: Array) -> Array:
        """Return the squared distance of rises (..., s) [K] without each target, (..., p) [-]."""
        return self.without_targets(rise, portable.matmul(rise, self.metric))

    def without_targets(self, rise: Array, pulled: Array) -> Array:
        """Return what `of` does, from the product of rises and `metric` that is known already.

        It is the distance of all sensors less what the target adds to it, given the others.
        """
        whole = np.add.reduce(pulled * rise, axis=-1, keepdims=True)
        return np.asarray(whole - self._share * np.square(pulled[..., self._targets]))


WATCH_LIMIT = 0.5
"""Difference that is never a fault [K], five times the noise of one reading of the sheet."""

TOLERANCE = 2.0
"""Limit over what the mates missed of held-out runs [-]: a few runs do not show everything."""

PERSISTENCE = 120.0
"""Sum of the relative excess that makes a fault [s]: a drift of 2 K/h is declared 8 min after it
has passed a limit of 0.5 K, an excursion to 1.2 times the limit may last 10 min."""

DOUBT = 2.0
"""Multiple of the limit [-] from which a single sample is not used, though nothing is declared:
the lags of a model would keep a jump of 5 K for an hour."""

RETURN_TIME = 1800.0
"""Time within half of the limit after which a sensor is trusted again [s].  A stuck sensor may
agree by chance for as long as the machine keeps its temperature."""


@dataclass(frozen=True, eq=False)
class SensorWatchModel:
    """Common behaviour of the sensors in training.

    Parameters
    ----------
    sensor : tuple of str, length s
        Sensors that can be mates.
    input : tuple of str, length p
        Sensors that are judged, all of them in `sensor`.
    moment : ndarray, shape (s, s)
        Mean products of the rises in training [K^2].
    missed : ndarray, shape (p,)
        Most that all voters agreed to miss of each input on held-out runs [K].
    leverage : ndarray, shape (p,)
        Largest squared distance of the held-out samples from the training [-]; 0 without mates.

    Raises
    ------
    ValueError
        If an input is no sensor, a shape is another, or a number is not finite, or negative
        where it must not be.
    """

    sensor: tuple[str, ...]
    input: tuple[str, ...]
    moment: Array
    missed: Array
    leverage: Array

    def __post_init__(self) -> None:
        """Check that the parts belong together."""
        size, inputs = len(self.sensor), len(self.input)
        if len(set(self.sensor)) != size:
            raise ValueError(f'sensor: expected each sensor once, but found {self.sensor}')
        unknown = [name for name in self.input if name not in self.sensor]
        if unknown:
            raise ValueError(
                f'input: expected inputs among {", ".join(self.sensor)}, but found '
                f'{", ".join(unknown)}'
            )
        check_shapes(self, moment=(size, size), missed=(inputs,), leverage=(inputs,))
        check_bounds(
            self,
            moment=(-NUMBER_MAX, NUMBER_MAX),
            missed=(0.0, NUMBER_MAX),
            leverage=(0.0, NUMBER_MAX),
        )
        if not _is_moment(self.moment):
            raise ValueError(
                'moment: expected mean products of rises, a symmetric matrix without negative '
                f'eigenvalues whose diagonal is 0 or at least {MOMENT_MIN:g} K^2, but found '
                'another; train the model anew'
            )

    @property
    def columns(self) -> Indices:
        """Place of each input in `sensor`, shape (p,)."""
        return np.array([self.sensor.index(name) for name in self.input], dtype=np.int64)

    def document(self) -> dict[str, Any]:
        """Return the numbers as JSON values; of the symmetric moments the lower triangle."""
        return {
            'sensor': list(self.sensor),
            'input': list(self.input),
            'moment': self.moment[np.tril_indices(len(self.sensor))].tolist(),
            'missed': self.missed.tolist(),
            'leverage': self.leverage.tolist(),
        }

    @classmethod
    def read(cls, node: Node) -> 'SensorWatchModel':
        """Return the watch of a document.

        Raises
        ------
        ModelFileError
            If a value has another type or number.
        ValueError
            If the parts do not belong together.
        """
        sensor = node.get('sensor').texts()
        lower = node.get('moment').vector()
        size = len(sensor)
        if len(lower) != size * (size + 1) // 2:
            node.get('moment').refuse(f'{size * (size + 1) // 2} numbers')
        moment = np.zeros((size, size))
        moment[np.tril_indices(size)] = lower
        with node.named():
            return cls(
                sensor=sensor,
                input=node.get('input').texts(),
                moment=moment + np.tril(moment, -1).T,
                missed=node.get('missed').vector(),
                leverage=node.get('leverage').vector(),
            )


class SensorWatch:
    """Watch the inputs of a model while it runs.

    Parameters
    ----------
    model : SensorWatchModel
        What training knows of the sensors.
    limit : float
        Difference that is never a fault [K].
    tolerance : float
        Limit over what the mates missed of held-out runs, where that is more than `limit` [-].
    persistence : float
        Sum of the relative excess above the limit that makes a fault [s]; 0 switches the watch
        off.

    Notes
    -----
    One sensor is declared at a time and then is no mate any more, so that it cannot drag others
    along; and never more than half of the inputs, since then the machine has changed and not
    its sensors.

    Examples
    --------
    Three sensors that always rise alike, and then the first one stays behind:

    >>> alike = SensorWatchModel(
    ...     ('a', 'b', 'c'), ('a',), np.full((3, 3), 9.0), np.array([0.2]), np.array([9.0])
    ... )
    >>> watch = SensorWatch(alike)
    >>> [bool(watch.update([rise, 4.0, 4.0], 60.0)[0]) for rise in (4.0, 1.0)]
    [False, True]
    >>> bool(watch.faulty[0]), bool(watch.update([1.0, 4.0, 4.0], 60.0)[0]), bool(watch.faulty[0])
    (False, True, True)
    """

    def __init__(
        self,
        model: SensorWatchModel,
        *,
        limit: float = WATCH_LIMIT,
        tolerance: float = TOLERANCE,
        persistence: float = PERSISTENCE,
    ) -> None:
        self._model = model
        self._columns = model.columns
        self._voices = VOTERS * len(model.input)
        self.limit: Array = np.maximum(limit, tolerance * model.missed)
        """Largest disagreement of the mates on each input near the training, shape (p,) [K]."""
        # Where training saw no distance there are no mates, and so nothing to be far from.
        self._farthest = np.where(model.leverage > LENGTH_MIN, model.leverage, np.inf)
        self._persistence = persistence
        self._faulty_max = max(1, len(model.input) // 2)
        inputs = len(model.input)
        self._excess = np.zeros((2, inputs))
        self._agreeing = np.zeros(inputs)
        self._prepare(np.ones(len(model.sensor), dtype=np.bool_))
        self.faulty: NDArray[np.bool_] = np.zeros(inputs, dtype=np.bool_)
        """Inputs that were voted out, shape (p,); one returns when its mates agree for long."""
        self._outvoted = 0

    @property
    def model(self) -> SensorWatchModel:
        """Common behaviour of the sensors in training."""
        return self._model

    @property
    def state(self) -> Array:
        """Copy of the state, shape (4 p,): excess to both sides, time of agreement, faulty."""
        return np.concatenate([self._excess.ravel(), self._agreeing, self.faulty])

    @state.setter
    def state(self, values: ArrayLike) -> None:
        state = np.array(values, dtype=np.float64)
        inputs = len(self._model.input)
        if state.shape != (4 * inputs,) or not np.isfinite(state).all():
            raise ValueError(
                f'state: expected {4 * inputs} finite numbers, but found {state.tolist()}'
            )
        self._excess = state[: 2 * inputs].reshape(2, inputs)
        self._agreeing = state[2 * inputs : 3 * inputs]
        self.faulty = state[3 * inputs :] != 0.0
        self._outvoted = int(self.faulty.sum())

    def update(self, rise: ArrayLike, elapsed: float) -> NDArray[np.bool_]:
        """Take one sample; return which inputs not to use, shape (p,).

        Those are the `faulty` ones, and the one that misses most in this sample alone, if it is
        beyond twice its limit: a jump is declared in its second sample, but not used in its first.

        Parameters
        ----------
        rise : array_like, shape (s,)
            Rise that each sensor of the model reads [K]; NaN where it reads nothing.
        elapsed : float
            Time since the sample before [s].
        """
        if self._persistence <= 0.0:
            return self.faulty
        read = np.asarray(rise, dtype=np.float64)
        usable = np.isfinite(read)
        if self._outvoted:
            usable[self._columns[self.faulty]] = False
        if usable.tobytes() != self._usable:
            self._prepare(usable)
        known = read if self._whole else np.where(usable, read, 0.0)
        # One product serves the voters and the distance from the training.
        product = portable.matmul(self._weights, known)
        expected, pulled = product[: self._voices], product[self._voices :]
        residual = read[self._columns] - expected.reshape(VOTERS, -1)
        distance = self._leverage.without_targets(known, pulled)
        limit = self.limit * np.sqrt(np.maximum(distance / self._farthest, 1.0))
        if not self._whole:
            # A sensor that reads nothing, or has too few mates left, is not judged.
            judged = np.isfinite(residual[0])
            residual[:, ~judged] = 0.0
        share = agreed(residual) / limit
        self._excess += np.minimum((self._sides * share - 1.0) * elapsed, 0.5 * self._persistence)
        np.maximum(self._excess, 0.0, out=self._excess)
        if self._outvoted:
            self._take_back(np.abs(residual.mean(axis=0)) / limit, judged, elapsed)
        if self._excess.max() >= self._persistence:
            self._vote_out(share)
        return self._with_doubt(np.abs(share))

    _sides = np.array([[1.0], [-1.0]])

    def _with_doubt(self, share: Array) -> NDArray[np.bool_]:
        """Return the faulty inputs and the one that this sample speaks against."""
        worst = int(share.argmax())
        if share[worst] < DOUBT or self.faulty[worst] or self._outvoted >= self._faulty_max:
            return self.faulty
        doubted = self.faulty.copy()
        doubted[worst] = True
        return doubted

    def _take_back(self, share: Array, judged: NDArray[np.bool_], elapsed: float) -> None:
        """Trust a sensor again that its mates have agreed with for long."""
        self._excess[:, self.faulty] = 0.0
        self._agreeing = np.where(share < 1.0, self._agreeing, 0.0)
        self._agreeing += np.where(judged & (share < 0.5), elapsed, 0.0)
        self.faulty = self.faulty & (self._agreeing < RETURN_TIME)
        self._outvoted = int(self.faulty.sum())

    def _vote_out(self, share: Array) -> None:
        """Declare the sensor that misses most among those beyond their limit for long enough."""
        if self._outvoted >= self._faulty_max:
            # What waits does not gather more than it takes.
            np.minimum(self._excess, self._persistence, out=self._excess)
            return
        beyond = (self._excess >= self._persistence).any(axis=0)
        worst = int(np.where(beyond, np.abs(share), -1.0).argmax())
        self.faulty = self.faulty.copy()
        self.faulty[worst] = True
        self._outvoted += 1
        self._excess[:] = 0.0
        self._agreeing[worst] = 0.0

    def _prepare(self, usable: NDArray[np.bool_]) -> None:
        """Let the sensors that can be read share the work of those that cannot."""
        mates = np.flatnonzero(usable)
        weights = voter_weights(self._model.moment, self._columns, mates)
        self._usable = usable.tobytes()
        self._whole = bool(usable.all() and np.isfinite(weights).all())
        self._leverage = Leverage(self._model.moment, self._columns, mates)
        self._weights = np.vstack([weights.reshape(-1, len(usable)), self._leverage.metric])


class Estimate(NamedTuple):
    """Substitute for a rise that cannot be read.

    Parameters
    ----------
    rise : float
        Estimated rise [K]; NaN where no mate can be read.
    missed : float
        What such an estimate missed in training, root mean square [K]; infinity without a mate.
    mate : str
        The mate that is most like the sensor; empty without one.
    """

    rise: float
    missed: float
    mate: str


class MateEstimate:
    """Estimate the rise of a sensor that cannot be read from all that can.

    Parameters
    ----------
    model : SensorWatchModel
        What training knows of the sensors.
    """

    def __init__(self, model: SensorWatchModel) -> None:
        self._model = model
        self._columns = model.columns
        self._weighed: dict[int, tuple[bytes, Indices, Array, float]] = {}

    def of(self, number: int, rise: Array) -> Estimate:
        """Return the estimate of an input.

        Parameters
        ----------
        number : int
            Input to estimate; its own rise is not looked at.
        rise : ndarray, shape (s,)
            Rise of each sensor of the model [K]; NaN where it cannot be used.
        """
        usable = np.isfinite(rise)
        weighed = self._weighed.get(number)
        if weighed is None or weighed[0] != usable.tobytes():
            weighed = self._weighed[number] = (usable.tobytes(), *self._weigh(number, usable))
        _, mates, weights, missed = weighed
        if not len(mates):
            return Estimate(np.nan, np.inf, '')
        return Estimate(
            float(portable.matmul(weights, rise[mates])), missed, self._model.sensor[mates[0]]
        )

    def _weigh(self, number: int, usable: NDArray[np.bool_]) -> tuple[Indices, Array, float]:
        """Return the mates of an input, best first, their weights, and what they miss [K]."""
        moment, target = self._model.moment, int(self._columns[number])
        mates = _ranked_mates(moment, target, np.flatnonzero(usable))
        weights = mate_weights(moment, target, mates)
        return mates, weights, unexplained(moment, target, mates, weights)
