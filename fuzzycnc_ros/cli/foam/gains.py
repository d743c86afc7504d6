# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Gains that bring a model of soft material to another sheet, foot or place, from one run."""

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.cli.foam.samples import Samples
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.model import GAIN_MAX, GAIN_MIN, DeformationModel

TURN_MAX = 10.0
"""How far a sample may lie beside the directions of a model whose gains are fitted to it [deg]."""


@dataclass(frozen=True, eq=False)
class GainFit:
    """A model with gains that were fitted to samples.

    Attributes
    ----------
    model : DeformationModel
        The model with its new gains.
    before : ndarray, shape (2,)
        Gains of X and Y that it had.
    samples, left_out : int
        Samples it was fitted to, and those that the model is not for.
    error_before, error : float
        Root mean square on these samples [mm per 50 mm].
    """

    model: DeformationModel
    before: Array
    samples: int
    left_out: int
    error_before: float
    error: float

    @property
    def gain(self) -> Array:
        """Gains of X and Y [-], shape (2,)."""
        return self.model.gain.value

    def lines(self) -> tuple[str, ...]:
        """Return what is to be said of it."""
        left = f'left out: {self.left_out} samples that the model is not for'
        return (
            *((left,) if self.left_out else ()),
            *(
                f'gain of {axis}: {first:.3f} -> {last:.3f}'
                + (', at its limit: train the model anew' if last in (GAIN_MIN, GAIN_MAX) else '')
                for axis, first, last in zip('XY', self.before, self.gain, strict=True)
            ),
            f'error on these {self.samples} samples: {self.error_before:.3f} -> {self.error:.3f} '
            'mm per 50 mm of feed; judge it on another run',
        )


def fit_gains(model: DeformationModel, samples: Samples) -> GainFit:
    """Fit the gains of a model to samples of a run.

    Raises
    ------
    ValueError
        If the model is for none of the samples.
    """
    # The foot of a compensated side goes a few degrees beside the direction of the pattern.
    cut = model.clip(samples.x)
    turned = np.abs(cut[:, 0] - samples.x[:, 0]) <= TURN_MAX
    known = turned & np.isclose(cut[:, 1:], samples.x[:, 1:]).all(axis=1) & model.accepts(cut)
    if not known.any():
        raise ValueError(
            f'expected samples that the model is for but found none among {len(known)}; train it '
            'on such samples'
        )
    x, s = cut[known], samples.s[known]
    adapted = model.adapted(x, s)
    return GainFit(
        adapted,
        model.gain.value,
        int(known.sum()),
        int((~known).sum()),
        *(_rms(item.predict(x) - s) for item in (model, adapted)),
    )


def _rms(error: Array) -> float:
    return float((error**2).mean() ** 0.5)
