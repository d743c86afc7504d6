# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bayesian linear regression of a thermal error, learnt from probes by a Kalman filter.

In run k, y(t) = phi(t)' w_k + d(t) + noise, with w_k = rho w_(k-1) + sqrt(1 - rho^2) N(0, S).
Features phi are the rises of the sensors and their first-order lags, lags of the spindle speed and
of its square, and what usual ball screws of axes along which the error slopes would have grown.
The weights are those of one machine, and differ a little from run to run; d is a slow drift
(Ornstein-Uhlenbeck process) that begins anew in each run.  Nothing has to be known beforehand: S,
the drift and rho follow from the probes by marginal likelihood.

References
----------
[kalman1960], [rasmussen2006]
"""

from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.band import WIDTH
from fuzzycnc_ros.core.thermal.places import channel_axis
from fuzzycnc_ros.core.thermal.screw_growth import ScrewGrowth

GATE = 4.0
"""Standard deviations beyond which a probe is doubted [-]."""


class Verdict(IntEnum):
    """Result of a probe."""

    ABSENT = 0
    """Nothing was measured in this channel."""
    ACCEPTED = 1
    REJECTED = 2
    """Far from the expected value, and no probe before it agrees."""


RISE_LAGS = (600.0, 1800.0, 5400.0)
"""Lags of the rises [s]; with those of the speed the likeliest of six sets on the simulated mill
and grinder."""

SPINDLE_LAGS = (300.0, 900.0, 2700.0, 7200.0)
"""Lags of the spindle speed and of its square [s]."""

RISE_UNIT, SPEED_UNIT = 10.0, 200.0
"""Rise [K] and least largest speed [rad/s] of which a scale is the error."""

GROWTH_UNIT = 30e-6
"""Growth of a screw that is expected to do as much as a rise of `RISE_UNIT` [m]."""

DRIFT_TIME = 9000.0
"""Correlation time of the drift [s]; probes tell it no better."""

FEATURES_MAX = 350
"""Most features: the covariance of a channel then has a megabyte."""

WINDOW = 64
"""Probes from which the scales are learnt; those before them are kept as mean and covariance."""

KNOWN_MIN = 1e-18
"""Least variance of a prediction [m^2]: below a nanometre there is nothing but rounding."""

FIRST = 4
"""Probes from which on a single one does not change the scales."""

FALSE_PROBE = float(portable.log(100e-6 / 0.005))
"""Surprise of a false probe: one in 200 is, anywhere within 100 um [-, of a density in 1/m]."""

TRUST = 8
"""Weight of the predicted variance beside the squared residuals of probes, in probes [-]."""

RUNS_MAX = 100_000
"""Most runs from the first probe of a window to now."""

_HEAD = 12
"""Numbers of a posterior's state before its base and probes."""

TUNED = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
"""Probes in the window after which the scales are learnt anew; so they are where it is full."""


@dataclass(frozen=True)
class Basis:
    """Features of a thermal error, from rises and the spindle speed.

    Parameters
    ----------
    sensors : int
        Number s of sensors.
    speed : bool
        Whether the spindle speed is read.
    interval : float
        Sampling interval [s].
    lags : tuple of float
        Lags of the rises [s].
    screws : tuple of ScrewGrowth, length m
        Screws of the axes whose motion is read.

    Raises
    ------
    ValueError
        If there is no sensor, or there are more than the covariance has room for.
    """

    sensors: int
    speed: bool
    interval: float
    lags: tuple[float, ...] = RISE_LAGS
    screws: tuple[ScrewGrowth, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what gives no features, or too many."""
        most = FEATURES_MAX - 2 * len(SPINDLE_LAGS) - ScrewGrowth.FEATURES * len(self.screws)
        most //= 1 + len(self.lags)
        if not 1 <= self.sensors <= most:
            raise ValueError(
                f'sensors: expected 1 to {most} to learn from, but found {self.sensors}; choose '
                'those that stand for the others'
            )

    @property
    def of_rises(self) -> int:
        """Number of features that are of rises or axes; those of the spindle speed follow them."""
        return (1 + len(self.lags)) * self.sensors + ScrewGrowth.FEATURES * len(self.screws)

    @property
    def features(self) -> int:
        """Number p of features."""
        return self.of_rises + 2 * len(SPINDLE_LAGS) * self.speed

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes whose motion is read."""
        return tuple(screw.span.axis for screw in self.screws)

    def seen_by(self, channel: str) -> Array:
        """Return 1 for the features (p,) from which a channel is learnt, else 0.

        The screws of other axes move it no more than the temperatures tell.
        """
        begin, axis = (1 + len(self.lags)) * self.sensors, channel_axis(channel)
        found = np.ones(self.features)
        for number, name in enumerate(self.axes):
            if name != axis:
                first = begin + number * ScrewGrowth.FEATURES
                found[first : first + ScrewGrowth.FEATURES] = 0.0
        return found

    def initial_state(self) -> Array:
        """Return the state at the thermal reference, shape (q,): lags, then screws."""
        return np.zeros(len(self._share) + ScrewGrowth.STATES * len(self.screws))

    def step(
        self, rise: Array, speed: float, state: Array, motion: Array | None = None
    ) -> tuple[Array, Array]:
        """Return the features (p,) of a sample and the next state (q,).

        Parameters
        ----------
        rise : ndarray, shape (s,)
            Rises of the sensors [K].
        speed : float
            Spindle speed [rad/s].
        state : ndarray, shape (q,)
            State after the sample before.
        motion : ndarray, shape (m, 4), optional
            Motion of each axis since the sample before, see `ScrewGrowth.step`; nothing moved if
            it is left out.
        """
        lags = state[: len(self._share)]
        lags = lags + self._share * (self._drive(rise, np.asarray(speed)) - lags)
        moved = np.zeros((len(self.screws), 4)) if motion is None else motion
        after = [
            screw.step(warm, self.interval, of_axis)
            for (screw, warm), of_axis in zip(self._screws_in(state), moved, strict=True)
        ]
        state = np.concatenate([lags, *after])
        return self.features_of(rise, state), state

    def features_of(self, rise: Array, state: Array) -> Array:
        """Return the features (p,) of rises (s,) [K] and a state (q,)."""
        count = len(self._share)
        of_rises = len(self.lags) * self.sensors
        grown = [
            RISE_UNIT / GROWTH_UNIT * screw.growths(warm) for screw, warm in self._screws_in(state)
        ]
        return np.concatenate([rise, state[:of_rises], *grown, state[of_rises:count]])

    def _screws_in(self, state: Array) -> list[tuple[ScrewGrowth, Array]]:
        """Return each screw with its part of a state (q,)."""
        parts = state[len(self._share) :].reshape(len(self.screws), ScrewGrowth.STATES)
        return list(zip(self.screws, parts, strict=True))

    @cached_property
    def _share(self) -> Array:
        lags = np.repeat(self.lags, self.sensors)
        if self.speed:
            lags = np.concatenate([lags, np.tile(SPINDLE_LAGS, 2)])
        return 1.0 - portable.exp(-self.interval / lags)

    def _drive(self, rise: Array, speed: Array) -> Array:
        drives = [rise] * len(self.lags)
        if self.speed:
            size = np.abs(speed)[..., np.newaxis]
            drives += [size] * len(SPINDLE_LAGS) + [size * size] * len(SPINDLE_LAGS)
        return np.concatenate(drives, axis=-1)


class Scales(NamedTuple):
    """Prior standard deviations of the parts of an error.

    Parameters
    ----------
    rise : float
        Standard deviation of the error where all sensors have risen by 10 K [m].
    speed : float
        The same at the largest speed so far, but 200 rad/s at least [m].
    drift : float
        Standard deviation of the drift [m].
    change : float
        Change of the weights from one run to the next, as a share of their own scale [-].
    """

    rise: float = 30e-6
    speed: float = 20e-6
    drift: float = 1.5e-6
    change: float = 0.25

    @property
    def drift_variance(self) -> float:
        """Variance of the drift [m^2]."""
        return self.drift * self.drift

    @property
    def kept(self) -> float:
        """Correlation rho of the weights of a run with those of the run before [-]."""
        return float(1.0 / np.sqrt(1.0 + self.change * self.change))


EXPECTED = Scales()
"""Medians of the log-normal priors of the scales."""

BREADTH = Scales(1.2, 1.2, 0.8, 0.8)
"""Standard deviations of their logarithms [-]; the likelier of two sets on the simulated mill and
grinder."""


BREADTH_KNOWN = Scales(*(0.5 * breadth for breadth in BREADTH))
"""The same where runs before have told the scales."""


class Probe(NamedTuple):
    """A measured error and what the machine felt then.

    Parameters
    ----------
    run : int
        Number of the run.
    time : float
        Time in it [s].
    features : ndarray, shape (p,)
        Features, see `Basis`.
    error : float
        Measured error [m].
    noise : float
        Standard deviation of the measurement [m].
    """

    run: int
    time: float
    features: Array
    error: float
    noise: float


class Knowledge(NamedTuple):
    """Knowledge of a channel before a run, without the drift, which begins anew.

    Parameters
    ----------
    scales : Scales
        Scales in force.
    fastest : float
        Largest lagged spindle speed so far [rad/s].
    mean : ndarray, shape (p,)
        Expected weights.
    covariance : ndarray, shape (p, p)
        Their covariance.
    """

    scales: Scales
    fastest: float
    mean: Array
    covariance: Array


class Posterior:
    """Weights and drift of one channel with their covariance.

    Parameters
    ----------
    basis : Basis
        The features.
    scales : Scales
        Scales to begin with.

    Notes
    -----
    A probe is a Kalman update, O(p^2).  One that is improbable is doubted: it moves the expected
    error to the border of the band and no further.  If the next one is off alike the machine has
    changed: it is known less, and both are learnt.  Else the first is learnt where the second has
    made it probable; if not it is as if it had never been.
    `tune` learns the scales anew from the last probes, and the weights with them.  Everything is
    computed in a fixed order with `portable`, so that a replay has the same digits on every
    processor.

    Examples
    --------
    >>> import numpy as np
    >>> from fuzzycnc_ros.core.thermal.learning import Basis, Posterior
    >>> known = Posterior(Basis(1, False, 60.0))
    >>> warm = np.full(4, 10.0)
    >>> said = lambda: '{:.0f} +- {:.1f} um'.format(*1e6 * np.array(known.predict(warm, 3600.0)))
    >>> said()
    '0 +- 30.0 um'
    >>> verdict = known.update(warm, 3600.0, 22e-6, 0.5e-6)
    >>> said()
    '22 +- 0.5 um'
    """

    def __init__(self, basis: Basis, scales: Scales = EXPECTED) -> None:
        self.scales = scales
        self._expected, self._breadth = EXPECTED, BREADTH
        self._basis = basis
        # Mean and covariance are those of the last event, this time after the run's reference.
        self._run, self._time, self._fastest = 0, 0.0, SPEED_UNIT
        self._base: tuple[int, Array, Array] | None = None
        self._probes: list[Probe] = []
        self._doubted: Probe | None = None
        self._square, self._squares = float(TRUST), TRUST
        self._mean: Array = np.zeros(basis.features + 1)
        self._covariance: Array = np.diag(np.append(self._prior(scales), scales.drift_variance))

    @staticmethod
    def of(basis: Basis, known: Knowledge) -> 'Posterior':
        """Return a posterior that begins its first run with knowledge."""
        found = Posterior(basis, known.scales)
        found._expected, found._breadth = known.scales, BREADTH_KNOWN
        found._fastest = known.fastest
        found._base = (0, known.mean, known.covariance)
        found._rebuild()
        return found

    @staticmethod
    def studied(
        basis: Basis, probes: Sequence[Probe], expected: Scales, *, tuned: bool = True
    ) -> Knowledge:
        """Return what probes of earlier runs teach for the next one, of all of them at once.

        Parameters
        ----------
        basis : Basis
            The features.
        probes : sequence of Probe
            Probes in their order, at least one; none is doubted.
        expected : Scales
            Medians of the scales.
        tuned : bool
            Whether the scales are learnt; else they are as expected.
        """
        found = Posterior(basis, expected)
        found._expected, found._probes = expected, list(probes)
        found._fastest = max([SPEED_UNIT, *(found._speed_of(probe.features) for probe in probes)])
        found._run, found._time = probes[-1].run, probes[-1].time
        if tuned:
            found.scales, _ = found._likeliest(found._evidence(found._probes))
        found._rebuild()
        return found.knowledge()

    def knowledge(self) -> Knowledge:
        """Return what is known for the next run."""
        found = deepcopy(self)
        found.begin_run()
        weights = found._covariance[:-1, :-1]
        return Knowledge(found.scales, found._fastest, found._mean[:-1], weights)

    @property
    def missed(self) -> float:
        """Root mean square of what probes missed by, over what was expected [-]."""
        return float(np.sqrt(self._square / self._squares))

    def unknown(self, features: Array, time: float) -> dict[str, float]:
        """Return the variance of a prediction from each part of it alone [m^2].

        Parameters are those of `predict`.
        """
        rises, drift = self._basis.of_rises, self.scales.drift_variance
        found = {}
        for name, part in (
            ('temperatures and axes' if self._basis.screws else 'temperatures', slice(0, rises)),
            ('spindle speed', slice(rises, self._basis.features)),
        ):
            row = features[part]
            block = self._covariance[part, part]
            found[name] = float(portable.matmul(portable.matmul(block, row), row))
        kept = portable.exp((self._time - max(time, self._time)) / DRIFT_TIME)
        found['drift'] = kept * kept * (float(self._covariance[-1, -1]) - drift) + drift
        return found

    @property
    def due(self) -> bool:
        """True if the scales are to be learnt anew after the last probe."""
        return len(self._probes) in TUNED or len(self._probes) > WINDOW

    @property
    def state(self) -> Array:
        """Flat array of finite doubles, from which the same digits follow as from this one."""
        doubted = 0.0 if self._doubted is None else self._doubted.noise
        head = [self._run, self._time, self._fastest, self._square, self._squares, *self.scales]
        parts = [np.array([*head, doubted, len(self._probes), self._base is not None], np.float64)]
        if self._base is not None:
            run, mean, covariance = self._base
            parts += [np.array([float(run)]), mean, covariance[np.triu_indices(len(mean))]]
        for probe in self._probes:
            measured = [float(probe.run), probe.time, probe.error, probe.noise]
            parts += [np.array(measured), probe.features]
        return np.concatenate(parts)

    @state.setter
    def state(self, values: Array) -> None:
        size = self._basis.features
        triangle = size * (size + 1) // 2
        if len(values) < _HEAD or not np.isfinite(values).all():
            raise ValueError(f'state: expected {_HEAD} finite numbers or more')
        head = np.asarray(values[:_HEAD], dtype=np.float64)
        doubted, count, based = float(head[-3]), int(head[-2]), bool(head[-1])
        rest = np.asarray(values[_HEAD:], dtype=np.float64)
        of_base = based * (1 + size + triangle)
        if not 0 <= count <= WINDOW + 1 or len(rest) != of_base + count * (4 + size):
            raise ValueError(
                f'state: expected {count} probes of {size} features, but found {len(rest)} numbers'
            )
        if not (head[2:9] > 0.0).all() or head[:2].min() < 0.0 or not doubted >= 0.0:
            raise ValueError('state: expected scales and times of 0 or more')
        base = None
        if based:
            covariance = np.zeros((size, size))
            covariance[np.triu_indices(size)] = rest[1 + size : of_base]
            covariance = covariance + np.triu(covariance, 1).T
            base = (int(rest[0]), rest[1 : 1 + size], covariance)
        table = rest[of_base:].reshape(count, 4 + size)
        probes = [
            Probe(int(row[0]), float(row[1]), row[4:], *map(float, row[2:4])) for row in table
        ]
        runs = [base[0] if base else 0, *(probe.run for probe in probes), int(head[0])]
        if runs != sorted(runs) or runs[-1] - runs[0] > RUNS_MAX or (doubted and not probes):
            raise ValueError('state: expected probes in the order of their runs')
        if any(probe.noise <= 0.0 for probe in probes):
            raise ValueError('state: expected probes with a noise above 0')
        self._run, self._time, self._fastest = int(head[0]), float(head[1]), float(head[2])
        self._square, self._squares = float(head[3]), int(head[4])
        self.scales = Scales(*head[5:9].tolist())
        self._base, self._probes = base, probes
        self._doubted = probes[-1]._replace(noise=doubted) if doubted else None
        self._rebuild()
        if not (np.isfinite(self._covariance).all() and self._covariance.diagonal().min() > 0.0):
            raise ValueError('state: expected a positive covariance')

    def begin_run(self) -> None:
        """Begin a run at its thermal reference: the weights change a little, the drift anew."""
        self._run, self._time = self._run + 1, 0.0
        self._carry()

    def predict(self, features: Array, time: float) -> tuple[float, float]:
        """Return the expected error and its standard deviation [m].

        Nothing is written: the drift forgets between the last event and this time.

        Parameters
        ----------
        features : ndarray, shape (p,)
            Features of the sample.
        time : float
            Time since the thermal reference of the run [s].
        """
        kept = portable.exp((self._time - max(time, self._time)) / DRIFT_TIME)
        row = np.append(features, kept)
        variance = portable.matmul(portable.matmul(self._covariance, row), row)
        variance += (1.0 - kept * kept) * self.scales.drift_variance
        variance *= self._square / self._squares
        return float(portable.matmul(row, self._mean)), float(np.sqrt(max(variance, KNOWN_MIN)))

    def update(self, features: Array, time: float, error: float, noise: float) -> Verdict:
        """Learn from a probe.

        Parameters
        ----------
        features : ndarray, shape (p,)
            Features of the sample at which was probed.
        time : float
            Time since the thermal reference of the run [s]; a probe from before the last one
            counts as taken together with it.
        error : float
            Measured error [m].
        noise : float
            Standard deviation of the measurement [m].

        Returns
        -------
        Verdict
            Whether it is believed.
        """
        self._elapse(max(time - self._time, 0.0))
        probe = Probe(self._run, self._time, features, error, noise)
        doubted, self._doubted = self._doubted, None
        if doubted is not None:
            self._probes.pop()
            self._rebuild()
        if self._probable(probe) or self._probable_on_other_scales(probe):
            self._believe(probe)
            if doubted is not None and self._probable(doubted):
                self._probes.insert(-1, doubted)
                self._rebuild()
            return Verdict.ACCEPTED
        if doubted is not None and self._agree(doubted, probe):
            self.forget()
            for item in (doubted, probe):
                self._believe(item)
            return Verdict.ACCEPTED
        self._doubted = probe
        expected, deviation = self.predict(features, self._time)
        excess = abs(error - expected) / (WIDTH * deviation) - 1.0
        variance = deviation * deviation * self._squares / self._square  # as the filter has it
        self._take(probe._replace(noise=float(np.sqrt(excess * variance))))
        return Verdict.REJECTED

    def tune(self) -> None:
        """Learn the scales from the last probes by marginal likelihood, then the weights anew.

        The search goes along each scale's logarithm in turn, from where it stands.
        """
        if not self._probes:
            return
        if len(self._probes) > WINDOW:
            self._condense()
        self.scales, _ = self._likeliest(self._evidence(self._probes))
        self._rebuild()

    def _evidence(self, probes: list[Probe]) -> '_Evidence':
        speeds = [self._speed_of(probe.features) for probe in probes]
        self._fastest = max(self._fastest, *speeds)
        of_rises, beforehand = self._basis.of_rises, (self._expected, self._breadth)
        return _Evidence(probes, self._base, of_rises, self._units(), beforehand)

    def _likeliest(self, evidence: '_Evidence') -> tuple[Scales, float]:
        """Return the likeliest scales, searched from those in force, and their surprise."""
        found = self.scales
        best = evidence.surprise(found)
        for step in (0.4, 0.2):
            for number in range(len(found)):
                for factor in (portable.exp(step), portable.exp(-step)):
                    while True:
                        tried = list(found)
                        tried[number] *= factor
                        surprise = evidence.surprise(Scales(*tried))
                        if not surprise < best - 1e-6:
                            break
                        best, found = surprise, Scales(*tried)
        return found, best

    def _probable_on_other_scales(self, probe: Probe) -> bool:
        """Return whether scales that this probe speaks for as well make it probable.

        Of a machine that moves more than most the first probes are improbable, and true.  One is
        rather false where other scales would explain all probes before much worse.  If it is
        true these scales are in force, else those from before.
        """
        if len(self._probes) >= FIRST:
            return False
        before = self.scales
        usual = self._evidence(self._probes).surprise(before) if self._probes else 0.0
        self.scales, found = self._likeliest(self._evidence([*self._probes, probe]))
        self._rebuild()
        if found - usual < FALSE_PROBE and self._probable(probe):
            return True
        self.scales = before
        self._rebuild()
        return False

    def _agree(self, one: Probe, other: Probe) -> bool:
        """Return whether two improbable probes are off alike: the machine has changed."""
        first, of_first = self.predict(one.features, self._time)
        second, of_second = self.predict(other.features, self._time)
        apart = (one.error - first) - (other.error - second)
        variance = of_first * of_first + of_second * of_second
        variance += one.noise * one.noise + other.noise * other.noise
        return apart * apart <= GATE * GATE * variance

    def forget(self) -> None:
        """Know the weights less, by all that may be known beforehand, and no probes."""
        weights = self._covariance[:-1, :-1] + np.diag(self._prior(self.scales))
        self._base = (self._run, self._mean[:-1].copy(), weights)
        self._probes = []
        self._rebuild()

    def _probable(self, probe: Probe) -> bool:
        expected, deviation = self.predict(probe.features, probe.time)
        off = probe.error - expected
        return off * off <= GATE * GATE * (deviation * deviation + probe.noise * probe.noise)

    def _believe(self, probe: Probe) -> None:
        """Learn from a probe, and let the band follow how far it was off.

        Scales that fit the last probes promise more than the next one keeps.
        """
        expected, deviation = self.predict(probe.features, probe.time)
        off = probe.error - expected
        square = off * off / (deviation * deviation + probe.noise * probe.noise)
        self._square += min(square, GATE * GATE) * self._square / self._squares
        self._squares += 1
        self._take(probe)

    def _take(self, probe: Probe) -> None:
        self._probes.append(probe)
        self._learn(probe)

    def _learn(self, probe: Probe) -> None:
        """Update mean and covariance."""
        row = np.append(probe.features, 1.0)
        gain = portable.matmul(self._covariance, row)
        variance = portable.matmul(gain, row) + probe.noise * probe.noise
        surprise = probe.error - portable.matmul(row, self._mean)
        self._mean += gain * (surprise / variance)
        self._covariance -= gain[:, np.newaxis] * gain / variance

    def _carry(self) -> None:
        """Go to the next run."""
        kept = self.scales.kept
        self._mean *= kept
        self._mean[-1] = 0.0
        self._covariance *= kept * kept
        self._covariance[-1] = self._covariance[:, -1] = 0.0
        at = np.arange(self._basis.features)
        self._covariance[at, at] += (1.0 - kept * kept) * self._prior(self.scales)
        self._covariance[-1, -1] = self.scales.drift_variance

    def _rebuild(self) -> None:
        """Learn all probes of the window anew with the scales in force."""
        run, time = self._run, self._time
        self._run, self._mean, self._covariance = self._begun()
        for probe in self._probes:
            self._reach(probe.run, probe.time)
            self._learn(probe)
        self._reach(run, time)

    def _elapse(self, time: float) -> None:
        """Let `time` [s] pass, in which the drift forgets."""
        self._time += time
        kept = portable.exp(-time / DRIFT_TIME)
        self._mean[-1] *= kept
        self._covariance[-1] *= kept
        self._covariance[:, -1] *= kept
        self._covariance[-1, -1] += (1.0 - kept * kept) * self.scales.drift_variance

    def _begun(self) -> tuple[int, Array, Array]:
        """Return number, mean and covariance of the run in which the window begins."""
        size = self._basis.features
        first = self._probes[0].run if self._probes else self._run
        run, mean, covariance = self._base or (first, np.zeros(size), None)
        whole = np.zeros((size + 1, size + 1))
        whole[:-1, :-1] = np.diag(self._prior(self.scales)) if covariance is None else covariance
        whole[-1, -1] = self.scales.drift_variance
        self._time = 0.0
        return run, np.append(mean, 0.0), whole

    def _reach(self, run: int, time: float) -> None:
        while self._run < run:
            self.begin_run()
        self._elapse(time - self._time)

    def _condense(self) -> None:
        """Keep the older half of the window as mean and covariance of the weights.

        It ends with a run if it can; within one the drift is taken to have been forgotten.
        """
        runs = np.array([probe.run for probe in self._probes])
        half = len(runs) // 2
        end = int(np.searchsorted(runs, runs[half])) or half
        run, time, later = self._run, self._time, self._probes[end:]
        within = runs[end - 1] == runs[end]
        self._probes, self._run = self._probes[:end], later[0].run
        self._time = later[0].time if within else 0.0
        self._rebuild()
        self._base = (self._run, self._mean[:-1].copy(), self._covariance[:-1, :-1].copy())
        self._probes, self._run, self._time = later, run, time

    def _prior(self, scales: Scales) -> Array:
        """Return the variance of each weight (p,) before anything is known."""
        rises = self._basis.of_rises
        part = np.full(self._basis.features, scales.rise)
        part[rises:] = scales.speed
        return np.square(part * self._units())

    def _units(self) -> Array:
        """Return the weights (p,) by which all features together are one scale, see `Scales`."""
        size, rises = self._basis.features, self._basis.of_rises
        units = np.full(size, 1.0 / (RISE_UNIT * np.sqrt(rises)))
        if size > rises:
            fastest = np.repeat([self._fastest, self._fastest * self._fastest], len(SPINDLE_LAGS))
            units[rises:] = 1.0 / (fastest * np.sqrt(size - rises))
        return units

    def _speed_of(self, features: Array) -> float:
        """Return the largest lagged speed among the features [rad/s]."""
        rises = self._basis.of_rises
        return float(np.max(features[rises : rises + len(SPINDLE_LAGS)], initial=0.0))


class _Evidence:
    """Products of the features of probes, for the likelihood of scales.

    Parameters
    ----------
    probes : list of Probe
        Probes in their order.
    base : tuple of int, ndarray, ndarray, or None
        Run, mean (p,) and covariance (p, p) of the weights that earlier probes left.
    of_rises : int
        Number of features that are rises or their lags.
    units : ndarray, shape (p,)
        Factors that a scale is multiplied by for each weight.
    beforehand : (Scales, Scales)
        Medians of the scales, and the standard deviations of their logarithms.
    """

    def __init__(
        self,
        probes: list[Probe],
        base: tuple[int, Array, Array] | None,
        of_rises: int,
        units: Array,
        beforehand: tuple[Scales, Scales] = (EXPECTED, BREADTH),
    ) -> None:
        self._beforehand = beforehand
        features = np.array([probe.features for probe in probes])
        run = np.array([probe.run for probe in probes])
        time = np.array([probe.time for probe in probes])
        self._error = np.array([probe.error for probe in probes])
        self._noise = np.diag(np.square(np.array([probe.noise for probe in probes])))
        scaled = features * units
        rises, speeds = scaled[:, :of_rises], scaled[:, of_rises:]
        self._of_rises = portable.matmul(rises, rises.T)
        self._of_speeds = portable.matmul(speeds, speeds.T)
        apart = np.abs(run[:, np.newaxis] - run)
        self._drift = (apart == 0) * portable.exp(-np.abs(time[:, np.newaxis] - time) / DRIFT_TIME)
        first = run[0] if base is None else base[0]
        self._apart, self._since = apart, run - first
        self._known, self._of_base = np.zeros(len(run)), None
        if base is not None:
            self._known = portable.matmul(features, base[1])
            self._of_base = portable.matmul(portable.matmul(features, base[2]), features.T)

    def surprise(self, scales: Scales) -> float:
        """Return the negative logarithm of likelihood times prior, up to a constant."""
        rho = portable.whole_powers(scales.kept, int(self._apart.max() + self._since.max()))
        weights = scales.rise * scales.rise * self._of_rises
        weights += scales.speed * scales.speed * self._of_speeds
        error = self._error - rho[self._since] * self._known
        if self._of_base is not None:
            old = np.square(rho[np.minimum(self._since[:, np.newaxis], self._since)])
            weights = old * self._of_base + (1.0 - old) * weights
        covariance = rho[self._apart] * weights + scales.drift_variance * self._drift + self._noise
        total = 0.0
        for value, median, breadth in zip(scales, *self._beforehand, strict=True):
            off = portable.log(value / median) / breadth
            total += off * off
        return 0.5 * (total + _improbability(covariance, error))


def _improbability(covariance: Array, error: Array) -> float:
    """Return minus twice the logarithm of a normal density, up to a constant."""
    rows = np.column_stack([covariance, error])
    for row in range(len(rows) - 1):
        share = rows[row + 1 :, row, np.newaxis] / rows[row, row]
        rows[row + 1 :, row + 1 :] -= share * rows[row, row + 1 :]
    pivot = rows.diagonal()
    return float(np.sum(portable.log(pivot)) + np.sum(np.square(rows[:, -1]) / pivot))


class Learner:
    """Posteriors of all channels of a machine, along its runs.

    Parameters
    ----------
    basis : Basis
        The features.
    channel : sequence of str, length c
        Channels, see `places`.
    """

    def __init__(self, basis: Basis, channel: Sequence[str]) -> None:
        self.basis = basis
        self.posteriors = tuple(Posterior(basis) for _ in channel)
        self._channel = tuple(channel)
        self.rest()

    def forget(self) -> None:
        """Know the weights less, by all that may be known beforehand: the machine has changed."""
        for posterior in self.posteriors:
            posterior.forget()

    def begin_run(self) -> None:
        """Begin another run at its thermal reference."""
        self.rest()
        for posterior in self.posteriors:
            posterior.begin_run()
            posterior.tune()

    def rest(self) -> None:
        """Go to the thermal reference of the run, where the machine is cold."""
        self._time = 0.0
        self._seen = tuple(self.basis.seen_by(name) for name in self._channel)
        self.lags = self.basis.initial_state()
        """State of the basis: lagged rises and speeds, temperatures of screws, shape (q,)."""
        self._features = self._before = np.zeros(self.basis.features)

    def resume(self, rise: Array, lags: Array, time: float) -> None:
        """Go to a sample of the run under way, whose `lags` were kept.

        Raises
        ------
        ValueError
            If they are not finite, or of other sensors.
        """
        if len(lags) != len(self.lags) or not np.isfinite(lags).all():
            raise ValueError(f'lags: expected {len(self.lags)} finite numbers')
        self._time, self.lags = time, np.array(lags, dtype=np.float64)
        self._features = self._before = self.basis.features_of(rise, self.lags)

    def step(self, rise: Array, speed: float, time: float, motion: Array | None = None) -> None:
        """Go on to the next sample.

        Parameters
        ----------
        rise : ndarray, shape (s,)
            Rises of the sensors [K].
        speed : float
            Spindle speed [rad/s].
        time : float
            Time since the thermal reference [s].
        motion : ndarray, shape (m, 4), optional
            Motion of each axis since the sample before; see `ScrewGrowth.step`.
        """
        self._time, self._before = time, self._features
        self._features, self.lags = self.basis.step(rise, speed, self.lags, motion)

    def predict(self) -> tuple[Array, Array]:
        """Return the expected errors of the last sample and their deviations, (c,) [m]."""
        found = [
            item.predict(seen * self._features, self._time)
            for item, seen in zip(self.posteriors, self._seen, strict=True)
        ]
        error, deviation = np.array(found).T
        return error, deviation

    def probe(self, error: Array, noise: Array, ago: float = 0.0) -> NDArray[np.int64]:
        """Learn from a probe, and return the verdicts (c,).

        Parameters
        ----------
        error : ndarray, shape (c,)
            Measured errors [m]; NaN where nothing was measured.
        noise : ndarray, shape (c,)
            Standard deviations of the measurement [m].
        ago : float
            Time from the probe to the last sample [s]; features are linear between samples.
        """
        share = min(ago / self.basis.interval, 1.0)
        features = self._features + share * (self._before - self._features)
        verdicts = np.full(len(error), int(Verdict.ABSENT), dtype=np.int64)
        for channel in np.flatnonzero(np.isfinite(error)):
            posterior = self.posteriors[channel]
            verdicts[channel] = posterior.update(
                self._seen[channel] * features,
                self._time - ago,
                float(error[channel]),
                float(noise[channel]),
            )
            if verdicts[channel] == Verdict.ACCEPTED and posterior.due:
                posterior.tune()
        return verdicts

    def unknown(self, channel: int) -> dict[str, float]:
        """Return the variance of a channel's prediction from each part of it alone [m^2]."""
        features = self._seen[channel] * self._features
        return self.posteriors[channel].unknown(features, self._time)

    @property
    def memory(self) -> Array:
        """Flat array of finite doubles: all that was learnt, without the run under way."""
        parts = [posterior.state for posterior in self.posteriors]
        return np.concatenate([np.array([len(part) for part in parts], np.float64), *parts])

    @memory.setter
    def memory(self, values: Array) -> None:
        channels = len(self.posteriors)
        lengths = np.array(values[:channels], dtype=np.float64)
        if len(lengths) < channels or not float(np.sum(lengths)) == len(values) - channels:
            raise ValueError(f'memory: expected {channels} channels, but found other lengths')
        learnt = tuple(copy(posterior) for posterior in self.posteriors)
        at = channels
        for posterior, length in zip(learnt, lengths.astype(np.int64).tolist(), strict=True):
            posterior.state = values[at : at + length]
            at += length
        self.posteriors = learnt
