# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Random streams of plausible temperatures, on which no model may leave its training range."""

import numpy as np

SNAPSHOTS = 3
GAIN_MAX = 1.2
SAMPLES = 600
NOISE = 0.1 / np.sqrt(5.0)


def random_streams(rise, *, count=100, seed=0):
    """Return streams made of what a machine has shown, each a list of runs (n, p) [K].

    Heat comes and goes in steps of 20 to 120 samples: the rises head for a mixture of training
    samples, up to 1.2 times as warm, with a lag of 10 to 90 samples.  The surroundings drift by
    up to 4 K.  Sensors drop out and are held, or show up to 2 K too much for a while; half of
    the streams restart warm, with the temperatures of the restart as new reference.

    Parameters
    ----------
    rise : ndarray, shape (n, p)
        Training rises [K].
    """
    return [_stream(rise, np.random.default_rng([seed, number])) for number in range(count)]


def largest_output(run, streams):
    """Return the largest absolute output over all streams; infinity if one is not finite.

    Parameters
    ----------
    run : callable
        Takes the rises (n, p) of one run and returns outputs of any shape.
    """
    largest = [np.abs(run(piece)).max() for stream in streams for piece in stream]
    return max(largest) if np.isfinite(largest).all() else np.inf


def _stream(rise, rng):
    truth = _temperatures(rise, rng)
    shown = truth + rng.normal(0.0, NOISE, truth.shape)
    for _ in range(rng.integers(1, 4)):
        sensor, start = rng.integers(rise.shape[1]), rng.integers(1, SAMPLES - 10)
        spell = slice(start, start + rng.integers(10, 90))
        if rng.random() < 0.5:
            shown[spell, sensor] = shown[start - 1, sensor]
        else:
            shown[spell, sensor] += rng.uniform(-2.0, 2.0)
    if rng.random() < 0.5:
        return [shown]
    restart = rng.integers(SAMPLES // 4, 3 * SAMPLES // 4)
    return [shown[:restart], shown[restart:] - shown[restart]]


def _temperatures(rise, rng):
    pole = np.exp(-1.0 / rng.uniform(10.0, 90.0))
    drift = rng.uniform(0.0, 4.0) * np.sin(np.arange(SAMPLES) / rng.uniform(100.0, 250.0))
    found = np.empty((SAMPLES, rise.shape[1]))
    state, target, until = np.zeros(rise.shape[1]), np.zeros(rise.shape[1]), 0
    for k in range(SAMPLES):
        if k == until:
            share = rng.dirichlet(np.ones(SNAPSHOTS))
            gain = rng.choice([0.0, rng.uniform(0.2, GAIN_MAX)], p=[0.25, 0.75])
            target = gain * (share @ rise[rng.integers(len(rise), size=SNAPSHOTS)])
            until = k + rng.integers(20, 120)
        state = target + pole * (state - target)
        found[k] = state
    return found + drift[:, np.newaxis]
