# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a real LinuxCNC commands to its joints in every servo period, judged by the true path."""

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.adapters.linuxcnc.recorder import PERIOD, Recorder
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.motion.contour import WINDOW_LENGTH, WINDOW_TIME, Contour
from fuzzycnc_ros.simulation.motion.contouring_axes import ContouringAxes

__all__ = ['Judged', 'Recorder', 'cut_of', 'judge']

REST = 0.2
"""Rest that tells the cut from the way to its start [s]; exact stops are shorter."""
_STILL = 1e-10  # a sample nearer to the last one has not moved [m]: HAL prints nanometres

LOOP = ContouringConfig(velocity_max=10.0, acceleration_max=1000.0)
"""Position and velocity loops of the simulated machine, whose axes never reach their limits."""


@dataclass(frozen=True)
class Judged:
    """A cut that LinuxCNC commanded.

    Attributes
    ----------
    duration : float
        Time from the first move to the last [s].
    deviation, deviation_rms : float
        Distance of the commanded positions from the true path, largest and rms [m].
    contour, contour_rms : float
        The same of where axes would be that follow the commands with the loops `LOOP` [m].
    acceleration, jerk : float
        Largest of the commanded motion, as vectors [m/s^2, m/s^3].
    """

    duration: float
    deviation: float
    deviation_rms: float
    contour: float
    contour_rms: float
    acceleration: float
    jerk: float


def cut_of(samples: Array) -> Array:
    """Return the last motion between two rests of `REST`: the cut, without the way to it.

    Parameters
    ----------
    samples : ndarray, shape (n, d)
        Commanded positions [m].

    Returns
    -------
    ndarray, shape (m, d)
        From the last sample at rest before it to the first one at rest after it [m].
    """
    moved = np.flatnonzero(np.linalg.norm(np.diff(samples, axis=0), axis=1) > _STILL)
    begins = np.flatnonzero(np.diff(moved) > REST / PERIOD)
    first = moved[begins[-1] + 1] if len(begins) else moved[0]
    return samples[first : moved[-1] + 2]


def judge(cut: Array, path: Contour) -> Judged:
    """Judge a cut by the true path.

    Parameters
    ----------
    cut : ndarray, shape (n, d)
        Commanded positions, `PERIOD` apart [m].
    path : Contour
        The true path, in as many dimensions.
    """
    step = np.linalg.norm(np.diff(cut, axis=0), axis=1)
    way = np.append(0.0, np.cumsum(step))
    way *= path.length / way[-1]
    reach = WINDOW_LENGTH + WINDOW_TIME * float(step.max()) / PERIOD
    asked = path.distance(cut, way, reach).distance
    out = round(LOOP.run_out / PERIOD)
    reference = np.concatenate([cut, np.repeat(cut[-1:], out, axis=0)])
    axes = np.concatenate([cut[:1], ContouringAxes(cut[0], LOOP).follow(reference[:-1])])
    place = np.append(way, np.full(out, way[-1]))
    index = np.arange(len(place))
    delayed = np.interp(index - LOOP.delay / PERIOD, index, place)
    left = path.distance(axes, delayed, reach).distance
    rest = np.repeat(cut[:1], 3, axis=0), cut, np.repeat(cut[-1:], 3, axis=0)
    second, third = (
        np.linalg.norm(np.diff(np.concatenate(rest), order, axis=0), axis=1).max() / PERIOD**order
        for order in (2, 3)
    )
    return Judged(
        duration=PERIOD * (len(cut) - 1),
        deviation=float(asked.max()),
        deviation_rms=float(np.sqrt(np.mean(asked**2))),
        contour=float(left.max()),
        contour_rms=float(np.sqrt(np.mean(left**2))),
        acceleration=float(second),
        jerk=float(third),
    )
