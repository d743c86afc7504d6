# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parallel first-order lags: what static, grey and lagged linear models are at run time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import block_diag

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, check_shapes


@dataclass(frozen=True, eq=False)
class LinearRecursion(Recursion):
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

    FORM: ClassVar[str] = 'linear'

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

    def channel(self, channel: int) -> 'LinearRecursion':
        """Return the recursion of one channel, without the lags that it does not read."""
        one = slice(channel, channel + 1)
        used = self.readout[channel] != 0.0
        return LinearRecursion(
            pole=self.pole[used],
            drive=self.drive[used],
            readout=self.readout[one, used],
            direct=self.direct[one],
            offset=self.offset[one],
        )

    @classmethod
    def merge(cls, items: Sequence['LinearRecursion']) -> 'LinearRecursion':
        """Return one recursion for all channels; the same lags of the same inputs are shared."""
        direct = np.concatenate([item.direct for item in items])
        offset = np.concatenate([item.offset for item in items])
        first = items[0]
        if all(
            np.array_equal(item.pole, first.pole) and np.array_equal(item.drive, first.drive)
            for item in items
        ):
            readout = np.concatenate([item.readout for item in items])
            return LinearRecursion(first.pole, first.drive, readout, direct, offset)
        return LinearRecursion(
            pole=np.concatenate([item.pole for item in items]),
            drive=np.concatenate([item.drive for item in items]),
            readout=block_diag(*[item.readout for item in items]),
            direct=direct,
            offset=offset,
        )

    def document(self) -> dict[str, Any]:
        """Return the numbers as JSON values."""
        return {
            'pole': self.pole.tolist(),
            'drive': self.drive.tolist(),
            'readout': self.readout.tolist(),
            'direct': self.direct.tolist(),
            'offset': self.offset.tolist(),
        }

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'LinearRecursion':
        """Return the recursion of a document."""
        pole = node.get('pole').vector()
        return cls(
            pole=pole,
            drive=node.get('drive').matrix(inputs),
            readout=node.get('readout').matrix(len(pole)),
            direct=node.get('direct').matrix(inputs),
            offset=node.get('offset').vector(),
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
