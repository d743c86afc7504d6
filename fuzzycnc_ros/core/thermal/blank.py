# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A thermal model that predicts nothing: the mean from which all of the error is learnt."""

from collections.abc import Sequence

import numpy as np

from fuzzycnc_ros.core.thermal.band import PredictionBand
from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED, Candidate
from fuzzycnc_ros.core.thermal.domain import Domain
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.places import channel_axis
from fuzzycnc_ros.core.thermal.recursions.base import LinearRecursion
from fuzzycnc_ros.core.thermal.sensor_watch import InputCluster, InputSelection

LABEL = 'learnt'
"""Name under which errors are published that are learnt from nothing."""


def blank_model(inputs: Sequence[str], channel: Sequence[str], interval: float) -> ThermalModel:
    """Return a model of any temperatures that predicts no error.

    Parameters
    ----------
    inputs : sequence of str, length p
        Sensors.
    channel : sequence of str, length c
        ISO 841 axes, and their slopes and bends, see `places`.
    interval : float
        Sampling interval [s].

    Raises
    ------
    ValueError
        If a sensor or an axis is named twice, or there is none, or the interval is none.
    """
    sensors, channels = len(inputs), len(channel)
    nothing = LinearRecursion.of_nothing(channels, sensors)
    unknown = np.full(channels, np.nan)
    alone = [InputCluster((name,), (1.0,), name, (), (), ()) for name in inputs]
    return ThermalModel(
        inputs=tuple(inputs),
        interval=interval,
        channel=tuple(channel),
        axis=tuple(channel_axis(name) for name in channel),
        runs=(),
        candidates={
            UNCOMPENSATED: Candidate(
                UNCOMPENSATED, ({},) * channels, nothing, (), unknown, unknown
            )
        },
        default=(UNCOMPENSATED,) * channels,
        selection=InputSelection('all', tuple(alone), 1.0, np.nan, (), ()),
        domain=Domain(np.zeros(sensors), np.empty((0, sensors)), np.empty(0), np.inf),
        band=PredictionBand(np.zeros(channels), 0.0),
    )
