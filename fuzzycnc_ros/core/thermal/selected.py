# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a selection of sensors says, as it is published and kept in model files."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SensorCluster:
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
class SensorSelection:
    """The chosen sensors and the clusters that they stand for.

    Parameters
    ----------
    method : str
        'correlation', 'grey_grade', or 'all' where every usable sensor is an input.
    clusters : tuple of SensorCluster
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
    clusters: tuple[SensorCluster, ...]
    partition_coefficient: float
    xie_beni: float
    dropped: tuple[str, ...]
    calibration: tuple[str, ...]

    @property
    def chosen(self) -> tuple[str, ...]:
        """The chosen sensors, one per cluster."""
        return tuple(cluster.chosen for cluster in self.clusters)
