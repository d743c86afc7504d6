# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Growth of a ball screw along its travel, by the one-dimensional heat equation.

Explicit finite volumes, warmed where the nut runs and at both bearings, and cooled by air that
moves with the axis.  Of a machine only the span is known in which its error is told: dimensions,
losses and frictions are usual ones.  The growths by each source of heat, with half and with twice
the usual losses, are features, whose weights are learnt; so a screw may be another.

References
----------
[incropera2011]
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, pi, sqrt

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.places import AxisSpan, moving_spans

CELLS = 14
"""Cells of a screw, of equal length."""

SOURCES = 4
"""Sources of heat: friction of the nut, its rise with speed, the bearings below and above."""

GROWTH_KINDS = 4
"""Growths of each that are features: below the middle of the span, above it, slope and bend."""

OVERHANG = 0.1
"""Length of the screw beyond each end of the span [m]."""

SCREW_DIAMETER = 0.03
"""Diameter of the screw [m]."""

EXPANSION = 11.5e-6
"""Expansion of steel [1/K]."""

CAPACITY, CONDUCTIVITY = 3.6e6, 45.0
"""Heat capacity [J/(m3 K)] and conductivity [W/(m K)] of steel."""

CONVECTION, CONVECTION_RISE = 14.0, 50.0
"""Loss of the surface at rest [W/(m2 K)], and its rise with the speed [W/(m2 K) per m/s]."""

END_LOSS, NUT_LOSS = 1.0, 1.5
"""Loss through each bearing and through the nut, spread over its stroke [W/K]."""

FRICTION = np.array([150.0, 750.0, 40.0, 40.0])
"""Heat of the sources [W] per speed [m/s], that of the viscous one per squared speed."""

LOSS_FACTORS = (0.5, 2.0)
"""Factors on all losses [-].  Of six sets on random screws, runs and probes, one alone follows two
calibration runs a little better, and eight runs and probes alone worse."""

NUT_HALF = 0.04
"""Half of the length of a nut [m]."""


@dataclass(frozen=True)
class ScrewGrowth:
    """A screw of usual kind, seen in a span along its axis.

    Parameters
    ----------
    span : AxisSpan
        The span.
    """

    span: AxisSpan

    HEATS = SOURCES * len(LOSS_FACTORS)
    STATES = CELLS * HEATS
    FEATURES = GROWTH_KINDS * HEATS

    @cached_property
    def _edges(self) -> Array:
        """Ends of the cells [m]."""
        low, high = self.span.low - OVERHANG, self.span.high + OVERHANG
        return np.asarray(low + (high - low) / CELLS * np.arange(CELLS + 1))

    @cached_property
    def _cell(self) -> tuple[float, float, float]:
        """Heat capacity [J/K] of a cell, conductance to the next one [W/K], and surface [m2]."""
        length = float(self._edges[1] - self._edges[0])
        section = 0.25 * pi * SCREW_DIAMETER * SCREW_DIAMETER
        return (
            CAPACITY * section * length,
            CONDUCTIVITY * section / length,
            pi * SCREW_DIAMETER * length,
        )

    @cached_property
    def _grown(self) -> Array:
        """Growths by the temperatures of the cells, shape (growths, cells) [m/K]."""
        span = self.span
        places = np.array([span.low, span.middle, span.high])
        lengths = np.clip(places[:, np.newaxis] - self._edges[:-1], 0.0, np.diff(self._edges))
        below, above = lengths[1] - lengths[0], lengths[2] - lengths[1]
        return EXPANSION * np.array([below, above, 0.5 * (below + above), 0.5 * (below - above)])

    def step(self, state: Array, interval: float, motion: Array) -> Array:
        """Return the temperatures after a sample.

        Parameters
        ----------
        state : ndarray, shape (STATES,)
            Rise of each cell by each source, with each factor on the losses [K].
        interval : float
            Time since the sample before [s].
        motion : ndarray, shape (4,)
            Means since then: speed [m/s], squared speed [m2/s2], and speed times position [m2/s]
            and squared position [m3/s].  The last two are NaN where it is unknown where the axis
            moved; it is then taken to have been everywhere.
        """
        warm = state.reshape(CELLS, self.HEATS)
        speed, square = float(motion[0]), float(motion[1])
        capacity, between, surface = self._cell
        loss = surface * (CONVECTION + CONVECTION_RISE * speed) + np.zeros(CELLS)
        heat = np.zeros((CELLS, SOURCES))
        if speed > 0.0:
            share = self._covered(speed, *motion[2:].tolist())
            loss += NUT_LOSS * share
            heat[:, :2] = share[:, np.newaxis] * np.array([speed, square])
        heat[0, 2] = heat[-1, 3] = speed
        loss[[0, -1]] += END_LOSS
        losses = loss[:, np.newaxis] * np.repeat(LOSS_FACTORS, SOURCES)
        heats = np.tile(heat * FRICTION, len(LOSS_FACTORS))
        # Half of the longest step that does not swing.
        steps = ceil(interval * (2.0 * between + float(losses.max())) / (0.5 * capacity))
        part = interval / steps / capacity
        for _ in range(steps):
            flow = between * (warm[1:] - warm[:-1])
            power = heats - losses * warm
            power[:-1] += flow
            power[1:] -= flow
            warm = warm + part * power
        return np.array(warm, dtype=np.float64).ravel()

    def _covered(self, speed: float, first: float, second: float) -> Array:
        """Return the share of each cell in the way of the nut, shape (cells,) [-].

        It went evenly over the stroke that has the mean and the spread of its positions.
        """
        edges = self._edges
        low, high = float(edges[0]), float(edges[-1])
        middle, mean_square = first / speed, second / speed
        if np.isfinite(middle) and np.isfinite(mean_square):
            reach = sqrt(3.0 * max(mean_square - middle * middle, 0.0)) + NUT_HALF
            low, high = max(low, middle - reach), min(high, middle + reach)
            if high - low < NUT_HALF:  # out of the screw, as it is thought of
                at = min(max(middle, float(edges[0]) + NUT_HALF), float(edges[-1]) - NUT_HALF)
                low, high = at - NUT_HALF, at + NUT_HALF
        covered = np.minimum(edges[1:], high) - np.maximum(edges[:-1], low)
        return np.asarray(np.maximum(covered, 0.0) / (high - low))

    def growths(self, state: Array) -> Array:
        """Return the growths by each source with each factor, shape (FEATURES,) [m].

        Parameters
        ----------
        state : ndarray, shape (STATES,)
            Rise of each cell, see `step`.
        """
        grown = portable.matmul(self._grown, state.reshape(CELLS, self.HEATS))
        return np.asarray(grown).ravel()


def screws_of(
    channel: Sequence[str], drives: Sequence[Mapping[str, Array]] = ()
) -> tuple[ScrewGrowth, ...]:
    """Return the screws of axes whose motion is known; parameters as for `moving_spans`."""
    return tuple(ScrewGrowth(span) for span in moving_spans(channel, drives))
