# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a fitted model does at run time: a recursion from rises to thermal error.

Every model ends up as one of two recursions, so that batch prediction, streaming, the model
file and the conversion between sampling intervals are written once.  Batch and stream execute
the same operations and therefore agree to the last digits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from fuzzycnc_ros.core.arrays import Array


@dataclass(frozen=True, eq=False)
class LinearRecursion:
    """Parallel first-order lags.

    u(k) = pole u(k-1) + drive x(k),  y(k) = readout u(k) + direct x(k) + offset.

    Parameters
    ----------
    pole : ndarray, shape (q,)
        Pole of each lag, in [0, 1) [-].
    drive : ndarray, shape (q, p)
        Input of each lag per kelvin.
    readout : ndarray, shape (c, q)
        Weight of each lag in each channel.
    direct : ndarray, shape (c, p)
        Weight of each rise in each channel [m/K].
    offset : ndarray, shape (c,)
        Constant of each channel [m].
    """

    pole: Array
    drive: Array
    readout: Array
    direct: Array
    offset: Array

    def __post_init__(self) -> None:
        """Refuse shapes that disagree and poles that are not stable."""
        lags, channels, inputs = len(self.pole), len(self.offset), self.direct.shape[-1]
        check_shapes(
            self,
            pole=(lags,),
            drive=(lags, inputs),
            readout=(channels, lags),
            direct=(channels, inputs),
            offset=(channels,),
        )
        if not ((self.pole >= 0.0) & (self.pole < 1.0)).all():
            raise ValueError(f'pole: expected poles in [0, 1), but found {self.pole}')

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return int(self.direct.shape[1])

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return len(self.offset)

    def initial_state(self) -> Array:
        """Return the state at the start of a run, where every rise is zero, shape (q,)."""
        return np.zeros(len(self.pole))

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        state = self.pole * state + self.drive @ rise
        return self.readout @ state + self.direct @ rise + self.offset, state

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        lagged = first_order_lags(self.pole, rise @ self.drive.T)
        return np.asarray(lagged @ self.readout.T + rise @ self.direct.T + self.offset)

    def with_interval(self, ratio: float) -> 'LinearRecursion':
        """Return the recursion for an interval `ratio` times as long, method sheet 001, 3.1."""
        pole = self.pole**ratio
        gain = (1.0 - pole) / (1.0 - self.pole)
        return replace(self, pole=pole, drive=self.drive * gain[:, np.newaxis])


@dataclass(frozen=True, eq=False)
class GreyRecursion:
    """Grey model of each channel, method sheet 001 eqs. (15)-(16) or their exact solution.

    Parameters
    ----------
    a : ndarray, shape (c,)
        Development coefficient of each channel [-].
    b : ndarray, shape (c, p)
        Driving coefficients [m/K].
    initial : ndarray, shape (c,)
        First value y(1) of each channel [m].
    exact : bool
        True solves eq. (12) as a recursion; False is the published time response (15), which
        takes the drivers' sum for constant.

    Notes
    -----
    The state is the sample number, then the accumulated drive and the previous value of each
    channel (accumulated for the published form, plain for the exact one).
    """

    a: Array
    b: Array
    initial: Array
    exact: bool

    def __post_init__(self) -> None:
        """Refuse shapes that disagree."""
        channels = len(self.a)
        check_shapes(self, a=(channels,), b=(channels, self.b.shape[-1]), initial=(channels,))

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return int(self.b.shape[1])

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return len(self.a)

    def initial_state(self) -> Array:
        """Return the state before the first sample, shape (1 + 2c,)."""
        return np.zeros(1 + 2 * self.channels)

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        drive = self.b @ rise
        number = state[0] + 1.0
        total = state[1 : 1 + self.channels] + drive
        previous = state[1 + self.channels :]
        # A form that diverges is meant to show it, as infinity, not to stop an evaluation.
        with np.errstate(all='ignore'):
            if self.exact:
                value = self._exact(number, drive, total, previous)
                kept = value
            else:
                steady = total / self.a
                kept = (self.initial - steady) * np.exp(-self.a * (number - 1.0)) + steady
                value = kept - previous
        return value, np.concatenate([[number], total, kept])

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        drive = rise @ self.b.T
        total = np.cumsum(drive, axis=0)
        with np.errstate(all='ignore'):
            if not self.exact:
                steady = total / self.a
                decay = np.exp(-self.a * np.arange(len(rise))[:, np.newaxis])
                accumulated = (self.initial - steady) * decay + steady
                return np.diff(accumulated, axis=0, prepend=np.zeros((1, self.channels)))
            half = 1.0 + self.a / 2.0
            forced = drive / half
            forced[:1] = self.initial
            # The second value follows from eq. (12) itself, not from the difference form.
            start = (total[1:2] - self.a * self.initial) / half
            forced[1:2] = start - pole_of(self.a) * self.initial
            return first_order_lags(pole_of(self.a), forced)

    def with_interval(self, ratio: float) -> 'GreyRecursion':
        """Return the recursion for an interval `ratio` times as long, method sheet 001, 3.1.

        Raises
        ------
        ValueError
            If the pole of the exact form is negative: it alternates from sample to sample and
            has no meaning at another interval.
        """
        if not self.exact:
            return replace(self, a=self.a * ratio, b=self.b * ratio)
        pole = pole_of(self.a)
        if (pole < 0.0).any():
            raise ValueError(
                f'interval: expected a model with poles of 0 or more, but found {pole.min():.3g}; '
                'fit the model anew at the other interval'
            )
        a = development_of(pole**ratio)
        gain = (1.0 - pole**ratio) / (1.0 - pole) * (1.0 + a / 2.0) / (1.0 + self.a / 2.0)
        return replace(self, a=a, b=self.b * gain[:, np.newaxis])

    def _exact(self, number: float, drive: Array, total: Array, previous: Array) -> Array:
        half = 1.0 + self.a / 2.0
        if number == 1.0:
            return self.initial
        if number == 2.0:
            return np.asarray((total - self.a * self.initial) / half)
        return np.asarray(pole_of(self.a) * previous + drive / half)


AnyRecursion = LinearRecursion | GreyRecursion
"""What a fitted model can be at run time."""


class Stream:
    """One pass of a recursion over samples as they come.

    Parameters
    ----------
    recursion : LinearRecursion or GreyRecursion
        What to run.
    """

    def __init__(self, recursion: AnyRecursion) -> None:
        self._recursion = recursion
        self._state = recursion.initial_state()

    def step(self, rise: ArrayLike) -> Array:
        """Take one sample of rises, shape (p,) [K], and return the thermal errors, shape (c,) [m].

        Raises
        ------
        ValueError
            If the sample has another length or holds NaN; the state then stays as it was.
        """
        sample = np.asarray(rise, dtype=np.float64)
        if sample.shape != (self._recursion.inputs,):
            raise ValueError(
                f'rise: expected {self._recursion.inputs} values, but found shape {sample.shape}'
            )
        # One sum is far cheaper than a test of each element; it is finite if all of them are.
        if not np.isfinite(sample.sum()):
            raise ValueError(f'rise: expected finite values, but found {sample}')
        value, self._state = self._recursion.step(sample, self._state)
        return value

    @property
    def state(self) -> Array:
        """Copy of the state, a flat array of doubles."""
        return np.array(self._state)

    @state.setter
    def state(self, values: ArrayLike) -> None:
        state = np.array(values, dtype=np.float64)
        if state.shape != self._state.shape or not np.isfinite(state).all():
            raise ValueError(
                f'state: expected {self._state.size} finite numbers, but found {state.tolist()}'
            )
        self._state = state


def combine(recursions: Sequence[AnyRecursion]) -> AnyRecursion:
    """Return one recursion whose channels are those of `recursions`, which share their inputs.

    Parameters
    ----------
    recursions : sequence of LinearRecursion or GreyRecursion
        Recursions of one or more channels each.

    Raises
    ------
    ValueError
        If there is none, or if forms are mixed.
    """
    grey = [item for item in recursions if isinstance(item, GreyRecursion)]
    linear = [item for item in recursions if isinstance(item, LinearRecursion)]
    if not recursions or (grey and linear) or len({item.exact for item in grey}) > 1:
        raise ValueError('recursions: expected one or more of the same form, but found a mixture')
    if grey:
        return GreyRecursion(
            a=np.concatenate([item.a for item in grey]),
            b=np.concatenate([item.b for item in grey]),
            initial=np.concatenate([item.initial for item in grey]),
            exact=grey[0].exact,
        )
    direct = np.concatenate([item.direct for item in linear])
    offset = np.concatenate([item.offset for item in linear])
    first = linear[0]
    if all(
        np.array_equal(item.pole, first.pole) and np.array_equal(item.drive, first.drive)
        for item in linear
    ):
        # The same lags of the same inputs: one bank serves all channels.
        readout = np.concatenate([item.readout for item in linear])
        return LinearRecursion(first.pole, first.drive, readout, direct, offset)
    return LinearRecursion(
        pole=np.concatenate([item.pole for item in linear]),
        drive=np.concatenate([item.drive for item in linear]),
        readout=block_diag(*[item.readout for item in linear]),
        direct=direct,
        offset=offset,
    )


def channel_of(recursion: AnyRecursion, channel: int) -> AnyRecursion:
    """Return the recursion of one channel out of several."""
    one = slice(channel, channel + 1)
    if isinstance(recursion, GreyRecursion):
        return replace(
            recursion, a=recursion.a[one], b=recursion.b[one], initial=recursion.initial[one]
        )
    # Lags that the channel does not read are left behind.
    used = recursion.readout[channel] != 0.0
    return LinearRecursion(
        pole=recursion.pole[used],
        drive=recursion.drive[used],
        readout=recursion.readout[one, used],
        direct=recursion.direct[one],
        offset=recursion.offset[one],
    )


def first_order_lags(pole: Array, drive: Array) -> Array:
    """Return u(k) = pole u(k-1) + drive(k) from u(0) = 0.

    Parameters
    ----------
    pole : ndarray, broadcast over the trailing axes of `drive`
        Poles [-].
    drive : ndarray, shape (n, ...)
        Inputs by rows.

    Returns
    -------
    ndarray, shape of `pole` and `drive` broadcast
        Lagged values in the units of `drive`.
    """
    shape = np.broadcast_shapes(np.shape(pole), drive.shape[1:])
    lagged = np.empty((len(drive), *shape))
    state = np.zeros(shape)
    for k, sample in enumerate(drive):
        state = pole * state + sample
        lagged[k] = state
    return lagged


def run_slices(runs: ArrayLike | None, samples: int) -> list[slice]:
    """Return the rows of each run.

    Parameters
    ----------
    runs : array_like, shape (n,), or None
        Label of the run that each sample belongs to; None is one run.
    samples : int
        Number n of samples.

    Raises
    ------
    ValueError
        If the length differs or the samples of one run do not lie together.
    """
    if runs is None:
        return [slice(0, samples)]
    labels: NDArray[np.generic] = np.asarray(runs)
    if labels.shape != (samples,):
        raise ValueError(f'runs: expected {samples} labels, but found shape {labels.shape}')
    cuts = [0, *(np.flatnonzero(labels[1:] != labels[:-1]) + 1).tolist(), samples]
    if len(cuts) - 1 != len(np.unique(labels)):
        raise ValueError('runs: expected the samples of each run together, but found them split')
    return [slice(first, last) for first, last in pairwise(cuts)]


def pole_of(a: Array) -> Array:
    """Return the pole (1 - a/2) / (1 + a/2) of a grey model, method sheet 001 section 3.1."""
    with np.errstate(divide='ignore'):
        return np.asarray((1.0 - a / 2.0) / (1.0 + a / 2.0))


def development_of(pole: Array) -> Array:
    """Return the development coefficient a of a pole, the inverse of `pole_of`."""
    return np.asarray(2.0 * (1.0 - pole) / (1.0 + pole))


def check_shapes(owner: object, **shapes: tuple[int, ...]) -> None:
    """Refuse arrays of other shapes or with values that are not finite.

    Raises
    ------
    ValueError
        The message names the array.
    """
    for name, shape in shapes.items():
        values = getattr(owner, name)
        if values.shape != shape or not np.isfinite(values).all():
            raise ValueError(
                f'{name}: expected finite numbers of shape {shape}, but found shape {values.shape}'
            )


def check_interval(interval: float) -> None:
    """Refuse an interval that is not a positive number of seconds."""
    if not (np.isfinite(interval) and interval > 0.0):
        raise ValueError(f'interval: expected a positive number of s, but found {interval}')
