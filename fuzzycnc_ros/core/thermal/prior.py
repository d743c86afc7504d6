# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Knowledge from calibration runs that learning from probes begins with."""

from base64 import b64decode, b64encode
from binascii import Error
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import LENGTH_MIN, NUMBER_MAX, Array
from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.learning import (
    SPEED_UNIT,
    Basis,
    Knowledge,
    Learner,
    Posterior,
    Scales,
)
from fuzzycnc_ros.core.thermal.places import SPAN_MIN, AxisSpan
from fuzzycnc_ros.core.thermal.screw_growth import ScrewGrowth

MODEL_SHARE = 1.0 / 3.0
"""Share of the trained model's prediction in the mean of an error [-], unless the model alone is
better beyond chance.

Model and weights miss in different ways, and their average beats either: on the simulated mill and
grinder, probed or not, a fifth to two fifths of the model do alike, none and all of it worse."""

LAGS = (900.0, 3600.0, 10800.0)
"""Lags of the rises where there are calibration runs [s]; the likeliest of four sets on the
simulated mill and grinder.  The slowest cannot be learnt from a few probes."""

PLACE_MAX = 100.0
"""Largest position along an axis that a file may have [m]."""

SCALE_MAX = 1.0
"""Largest scale that a file may have [m]."""

CORRELATION_MIN = -1e-6
"""Least eigenvalue of the correlations of weights [-]: rounding makes a zero negative."""


@dataclass(frozen=True, eq=False)
class LearningPrior:
    """Weights of all channels before the first probe, and what they are added to.

    An error is a share of the trained model's prediction, plus the features times the weights,
    plus the drift.

    Parameters
    ----------
    basis : Basis
        The features of the model's inputs.
    known : tuple of Knowledge, length c
        Knowledge of each channel.
    share : tuple of float, length c
        Share of the trained model's prediction in an error [-].
    """

    basis: Basis
    known: tuple[Knowledge, ...]
    share: tuple[float, ...]

    def learner(self, channel: Sequence[str]) -> Learner:
        """Return a learner that begins with this.

        It expects errors, and takes probes, less the share of the model's prediction.

        Parameters
        ----------
        channel : sequence of str, length c
            Channels of the model.
        """
        learner = Learner(self.basis, channel)
        learner.posteriors = tuple(Posterior.of(self.basis, known) for known in self.known)
        return learner

    def with_interval(self, interval: float) -> 'LearningPrior':
        """Return the same for another sampling interval [s]."""
        return replace(self, basis=replace(self.basis, interval=interval))

    def document(self) -> dict[str, Any]:
        """Return the prior as JSON values."""
        # Files of models without such axes keep their text.
        spans = [screw.span for screw in self.basis.screws]
        moving = {'motion': {span.axis: [span.low, span.high] for span in spans}} if spans else {}
        return {
            **moving,
            'speed': self.basis.speed,
            'lags': list(self.basis.lags),
            'channels': [
                {
                    'share': share,
                    'scales': known.scales._asdict(),
                    'fastest': known.fastest,
                    'mean': known.mean.tolist(),
                    'covariance': _written(known.covariance),
                }
                for share, known in zip(self.share, self.known, strict=True)
            ],
        }

    @staticmethod
    def read(node: Node, sensors: int, interval: float) -> 'LearningPrior':
        """Return the prior of a document.

        Parameters
        ----------
        node : Node
            What `document` returned.
        sensors : int
            Number of the model's inputs.
        interval : float
            Sampling interval of the model [s].

        Raises
        ------
        ModelFileError
            If a value is missing or of another type, or a matrix is no covariance.
        """
        with node.named():
            lags = node.get('lags').numbers(interval * LENGTH_MIN, NUMBER_MAX)
            screws = _read_screws(node.items().get('motion'))
            basis = Basis(sensors, node.get('speed').boolean(), interval, lags, screws)
        channels = node.get('channels').list()
        return LearningPrior(
            basis=basis,
            known=tuple(_read(item, basis.features) for item in channels),
            share=tuple(item.get('share').number(0.0, 1.0) for item in channels),
        )


def _read_screws(node: Node | None) -> tuple[ScrewGrowth, ...]:
    """Return the screws of axes, whose spans a document may name."""
    found = []
    if node is not None and isinstance(node.value, list):
        node.refuse('the span of each axis; the file is from before message set 4, train it anew')
    for axis, places in (node.items() if node is not None else {}).items():
        ends = places.numbers(-PLACE_MAX, PLACE_MAX)
        if len(ends) != 2 or ends[1] - ends[0] < SPAN_MIN:
            places.refuse('two increasing positions in m')
        found.append(ScrewGrowth(AxisSpan(axis, *ends)))
    return tuple(found)


def _read(node: Node, features: int) -> Knowledge:
    scales = node.get('scales')
    return Knowledge(
        scales=Scales(
            *(scales.get(name).number(LENGTH_MIN, SCALE_MAX) for name in Scales._fields)
        ),
        fastest=node.get('fastest').number(SPEED_UNIT, NUMBER_MAX),
        mean=node.get('mean').array(features, low=-NUMBER_MAX, high=NUMBER_MAX),
        covariance=_read_covariance(node.get('covariance'), features),
    )


def _written(covariance: Array) -> str:
    """Return the lower triangle of a symmetric matrix as text."""
    lower = covariance[np.tril_indices(len(covariance))]
    return b64encode(lower.astype('<f8').tobytes()).decode()


def _read_covariance(node: Node, size: int) -> Array:
    """Return the covariance whose lower triangle a text holds, shape (size, size)."""
    try:
        content = b64decode(node.text(), validate=True)
    except (Error, ValueError):
        node.refuse('numbers in base64')
    rows, columns = np.tril_indices(size)
    if len(content) != 8 * len(rows):
        node.refuse(f'{len(rows)} numbers in base64')
    found = np.zeros((size, size))
    found[rows, columns] = found[columns, rows] = np.frombuffer(content, '<f8')
    deviation = np.sqrt(np.maximum(found.diagonal(), 0.0))
    usable = np.isfinite(found).all() and (0.0 < deviation).all() and deviation.max() < NUMBER_MAX
    if usable:
        correlation = found / (deviation * deviation[:, np.newaxis])
        usable = bool(np.linalg.eigvalsh(correlation)[0] >= CORRELATION_MIN)
    if not usable:
        node.refuse('a positive definite matrix')
    return found


def of_one_kind(priors: Sequence[LearningPrior]) -> LearningPrior:
    """Return what machines of one kind teach of another one before its first probe.

    The weights of machines are normal about those of the kind: the mean is theirs, the covariance
    that of the sample, plus what is unknown of each machine on the average.

    Parameters
    ----------
    priors : sequence of LearningPrior
        What was learnt of each machine, two at least, with the same features and channels.

    Raises
    ------
    ValueError
        If there are fewer, or they differ in features, channels or the share of a model.
    """
    first, count = priors[0], len(priors)
    if count < 2:
        raise ValueError(f'machines: expected two of one kind or more, but found {count}')
    for other in priors[1:]:
        if (other.basis, other.share) != (first.basis, first.share):
            raise ValueError(
                'machines: expected the same number of sensors, lags, interval and share of a '
                'model in all of them, but found others'
            )
    known = []
    for channel in range(len(first.known)):
        each = [prior.known[channel] for prior in priors]
        mean = sum((item.mean for item in each), np.zeros(first.basis.features)) / count
        covariance = np.zeros((first.basis.features,) * 2)
        for item in each:
            apart = item.mean - mean
            # The mean of so few is not that of the kind.
            covariance += (1.0 + 1.0 / count) / (count - 1) * apart * apart[:, np.newaxis]
            covariance += item.covariance / count
        logs = np.array([portable.log(np.array(item.scales)) for item in each]).sum(axis=0)
        known.append(
            Knowledge(
                scales=Scales(*portable.exp(logs / count).tolist()),
                fastest=max(item.fastest for item in each),
                mean=mean,
                covariance=covariance,
            )
        )
    return replace(first, known=tuple(known))
