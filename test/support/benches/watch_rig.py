# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of eight sensors that follow two slow courses, for tests of the watch over sensors."""

import numpy as np

from fuzzycnc_ros.core.thermal.run import ThermalRun

SENSORS = tuple(f's{number}' for number in range(8))
STEP = 60.0


def rises(samples=200, seed=0, phase=0.0, noise=0.05):
    """Return rises (n, 8) [K] that mix two slow courses, with noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(samples) / 60.0
    courses = np.column_stack(
        [8.0 * (1.0 - np.exp(-time)), 3.0 * np.sin(time + phase) - 3.0 * np.sin(phase)]
    )
    mixing = np.random.default_rng(1).uniform(0.3, 1.0, (2, len(SENSORS)))
    return courses @ mixing + rng.normal(0.0, noise, (samples, len(SENSORS)))


def recording(name, seed, phase):
    """Return a run of 200 minutes whose displacement follows the first sensor."""
    rise = rises(seed=seed, phase=phase)
    return ThermalRun(
        name=name,
        time=STEP * np.arange(len(rise)),
        sensor=SENSORS,
        temperature=20.0 + rise,
        channel=('Y',),
        axis=('Y',),
        displacement=1e-6 * rise[:, :1],
    )


def recordings():
    """Return three runs to learn from."""
    return [recording('a', 1, 0.0), recording('b', 2, 0.7), recording('c', 3, 1.4)]
