# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Stability of a position loop over all that an identified axis may be.

Sampled models have every pole inside the unit circle at every gain; at each frequency the loop of
the nominal model stays further from -1 than the axis may differ from the model there.

References
----------
[ljung1999], chapter 14, for the deviation by frequency.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, log, pi

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.identify.response_fit import LEVEL
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.core.servo.axis import exponential
from fuzzycnc_ros.core.servo.controller import AxisController, closed_loop

ROBUST_GAINS = (0.48, 0.7, 1.0, 1.3, 1.55)
"""Factors on the gain at which a loop has to be stable: half to one and a half times, and a little
more."""

MARGIN = 0.05
"""Distance from -1 that a loop keeps, whatever the axis is [-]."""

_LOWEST, _LINES = 0.3, 240
"""First of the frequencies at which the distance is judged [Hz], and their number."""

_SAMPLES = 16
"""Models that are drawn."""

_DECAY = 0.01
"""Damping that every pole of a sampled loop keeps [-]."""

_UNKNOWN, _UNKNOWN_MAX, _UNKNOWN_OCTAVES = 2.3, 9.3, 4.0
"""Response over that of the model where an unknown mode may begin, the largest one, and the ratio
of the frequencies between the two [-].

A mode of 5 % damping raises the response tenfold, but one that strong so near to what is known
would show there.
"""

_FORCES, _WEAK = 20.0, 0.7
"""Frequency up to which forces act on an axis [Hz], and gain at which what they do is reckoned
[-]."""

_SLOW = 0.6
"""Deviation that counts at most where the response is known [-]: far below the crossover the
loop's
gain is high, and friction makes the response there smaller, not less stable."""


@dataclass(frozen=True, kw_only=True)
class LoopMargin:
    """Distance of a loop from instability.

    Attributes
    ----------
    distance : float
        Least distance from -1 less what the axis may differ [-]; it has to be `MARGIN` or more.
    frequency : float
        Where that is [Hz].
    radius : float
        Largest magnitude of a pole over all sampled models and gains; below 1 it settles.
    crossover : float
        Highest frequency at which the gain of the nominal loop is 1 [rad/s]; 0 if nowhere.
    yielding : float
        Geometric mean of how far a force moves the loop, over the slow frequencies, at a
        lower gain
        [m per unit of the duty].
    """

    distance: float
    frequency: float
    radius: float
    crossover: float
    yielding: float

    @property
    def robust(self) -> bool:
        """True if the loop is stable with margin whatever the axis is, and holds a position."""
        return self.distance >= MARGIN and self.radius < 1.0 and self.crossover > 0.0

    @property
    def shortfall(self) -> float:
        """Missing part of the margin; 0 if the loop is robust [-].

        Without a crossover the loop is open: what is fed forward moves the axis, and nothing
        brings it back.
        """
        short = max(MARGIN - self.distance, 0.0) + max(50.0 * (self.radius - 1.0), 0.0)
        return short + (0.0 if self.crossover else 1.0)


@dataclass(frozen=True, eq=False)
class _Sampled:
    """A model with its duty held for a period: states, entry of the duty, row of the reading."""

    dynamics: Array
    duty: Array
    reading: Array


class AxisModels:
    """The set of models that an identified axis stands for.

    Parameters
    ----------
    data : AxisData
        The axis, with a mass as plant.

    Raises
    ------
    ValueError
        If it has another plant or none.
    """

    def __init__(self, data: AxisData) -> None:
        plant = data.known_plant()
        if not isinstance(plant, BallscrewAxisConfig):
            raise ValueError(f'plant: expected a mass but found {data.model}')
        self.data, self.plant, self.period = data, plant, plant.period

    @cached_property
    def frequency(self) -> Array:
        """Frequencies at which the distance is judged [Hz], shape (n,)."""
        return np.asarray(np.geomspace(_LOWEST, 0.49 / self.period, _LINES), np.float64)

    @cached_property
    def response(self) -> NDArray[np.complex128]:
        """Response of the nominal model from duty to reading there [m]."""
        return _response(sampled(self.plant), self.frequency, self.period)

    @cached_property
    def deviation(self) -> Array:
        """Largest deviation of the axis from the model at each frequency, relative [-]."""
        known, frequency = self.data.knowledge, self.frequency
        found = np.full(len(frequency), 0.1)
        pairs = known.remainders
        measured = found
        if pairs:
            places, shares = np.array(pairs).T
            measured = np.exp(
                np.interp(np.log(frequency), np.log(places), np.log(np.maximum(shares, 1e-3)))
            )
            inside = frequency <= known.known_to
            found = np.where(inside, np.minimum(measured, _SLOW), found)
        start = known.known_to if known.mode_high else max(known.mode_low, known.known_to)
        if start:
            ratio = np.clip(frequency / start, 1.0, _UNKNOWN_OCTAVES)
            growth = log(_UNKNOWN_MAX / _UNKNOWN) / log(_UNKNOWN_OCTAVES)
            unknown = _UNKNOWN * ratio**growth - 1.0
            if pairs:
                unknown = np.minimum(measured, unknown)
            found = np.where(frequency > start, np.maximum(unknown, found), found)
            # what a mode further up than that does here, which at the known lines does not show
            between = (frequency > known.known_to) & (frequency <= start)
            square = np.minimum((frequency / start) ** 2, 0.99)
            rise = np.clip(square / (1.0 - square), 0.1, _UNKNOWN - 1.0)
            found = np.where(between, np.minimum(measured, rise), found)
        return np.asarray(found)

    @cached_property
    def samples(self) -> tuple[_Sampled, ...]:
        """Models drawn from the intervals, the ends of the dead time among them."""
        return tuple(sampled(one) for one in self._drawn())

    def _drawn(self) -> Iterator[BallscrewAxisConfig]:
        known, plant = self.data.knowledge, self.plant
        draw = np.random.default_rng(0)
        turn = 2j * pi * LEVEL
        rubs = 0.5 * (plant.viscous_forward + plant.viscous_backward) / plant.mass
        yield plant
        for number in range(_SAMPLES):
            gain, friction, damping, ratio, mode, late = draw.random(6)
            share = known.gain_low * (known.gain_high / known.gain_low) ** gain
            viscous = 0.5 * 3.0**friction
            # what rubs less answers as strongly at the loop's frequencies: that is what is known
            share *= abs(turn + viscous * rubs) / abs(turn + rubs)
            short = min(known.delay_low, plant.delay)
            changes = {
                'force_constant': plant.force_constant * share,
                'viscous_forward': max(plant.viscous_forward * viscous, 1.0),
                'viscous_backward': max(plant.viscous_backward * viscous, 1.0),
                'delay': (plant.delay, short, short + late * (plant.delay - short))[number % 3],
            }
            if plant.mode:
                low, high = known.mode_low or plant.mode, known.mode_high or plant.mode
                least = min(known.damping_low, plant.mode_damping)
                changes |= {
                    'mode': low + mode * (high - low),
                    'mode_damping': least + damping * (1.5 * plant.mode_damping - least),
                    'mode_ratio': plant.mode_ratio * (0.85 + 0.3 * ratio),
                }
            yield replace(plant, **changes)

    def margin(self, controller: AxisController, *, spread: bool = True) -> LoopMargin:
        """Return how far the loop of a controller is from instability.

        Parameters
        ----------
        controller : AxisController
            Controller, whose state is of no matter.
        spread : bool
            Whether the sampled models are asked, too, if the distance suffices.
        """
        law = controller.feedback_law()
        inner, entry, row, direct = law
        z = np.exp(2j * pi * self.frequency * self.period)[:, np.newaxis, np.newaxis]
        answers = np.linalg.solve(
            z * np.eye(len(inner)) - inner,
            np.broadcast_to(entry[:, np.newaxis], (len(z), len(entry), 1)),
        )[..., 0]
        loop = -self.response * (answers @ row + direct)
        distance = np.full(len(loop), inf)
        for gain in (*ROBUST_GAINS[1:-1], 0.5, 1.5):
            here = np.abs(1.0 + gain * loop) - gain * np.abs(loop) * self.deviation
            distance = np.minimum(distance, here)
        place = int(distance.argmin())
        least, where = float(distance[place]), float(self.frequency[place])
        radius = _radius(law, self.samples[:1])
        if spread and least >= MARGIN and radius < 1.0:
            radius = _radius(law, self.samples)
        above = np.flatnonzero(np.abs(loop) >= 1.0)
        crossover = 2.0 * pi * float(self.frequency[above[-1]]) if len(above) else 0.0
        slow = self.frequency <= _FORCES
        gives = np.abs(self.response / (1.0 + _WEAK * loop))[slow]
        return LoopMargin(
            distance=least,
            frequency=where,
            radius=radius,
            crossover=crossover,
            yielding=float(np.exp(np.log(gives).mean())),
        )

    def judge(self, controller: AxisController, *, spread: bool = True) -> tuple[float, float]:
        """Return shortfall and yielding of `margin`."""
        found = self.margin(controller, spread=spread)
        return found.shortfall, found.yielding


def sampled(plant: BallscrewAxisConfig) -> _Sampled:
    """Return the linear model of an axis with its mode and its dead time, sampled exactly.

    Parameters
    ----------
    plant : BallscrewAxisConfig
        The axis; Coulomb friction is left out.
    """
    gain = plant.direction * plant.force_max / plant.mass
    viscous = 0.5 * (plant.viscous_forward + plant.viscous_backward) / plant.mass
    # position, velocity; swing of the mode and its rate
    size = 4 if plant.mode else 2
    a, b, c = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    a[0, 1], a[1, 1], b[1], c[0] = 1.0, -viscous, gain, 1.0
    if plant.mode:
        rate, push = 2.0 * pi * plant.mode, plant.mode_ratio - 1.0
        a[2, 3] = 1.0
        a[3, 1] = -push * viscous
        a[3, 2], a[3, 3] = -rate * rate, -2.0 * plant.mode_damping * rate
        b[3], c[2] = push * gain, 1.0
    whole, part = divmod(plant.delay / plant.period, 1.0)
    late = int(whole)
    dynamics, early = _held(a, b, plant.period * (1.0 - part))
    before, last = _held(a, b, plant.period * part)
    # for the first part of a period the duty of the period before acts
    dynamics, last = dynamics @ before, dynamics @ last
    held = late + 1
    total = np.zeros((size + held, size + held))
    entry, reading = np.zeros(size + held), np.zeros(size + held)
    total[:size, :size] = dynamics
    reading[:size] = c
    # held duties, the newest first
    total[:size, size + late] = last
    if late:
        total[:size, size + late - 1] = early
        for place in range(1, held):
            total[size + place, size + place - 1] = 1.0
    else:
        entry[:size] = early
    entry[size] = 1.0
    return _Sampled(total, entry, reading)


def _held(a: Array, b: Array, time: float) -> tuple[Array, Array]:
    size = len(b)
    whole = np.zeros((size + 1, size + 1))
    whole[:size, :size], whole[:size, size] = a * time, b * time
    found = exponential(whole)
    return found[:size, :size], found[:size, size]


def _response(model: _Sampled, frequency: Array, period: float) -> NDArray[np.complex128]:
    z = np.exp(2j * pi * frequency * period)[:, np.newaxis, np.newaxis]
    entry = np.broadcast_to(model.duty[:, np.newaxis], (len(z), len(model.duty), 1))
    states = np.linalg.solve(z * np.eye(len(model.duty)) - model.dynamics, entry)[..., 0]
    return np.asarray(states @ model.reading)


def _radius(law: tuple[Array, Array, Array, float], models: tuple[_Sampled, ...]) -> float:
    """Return the largest magnitude of a pole over models and gains, as if damped less."""
    worst = 0.0
    for model in models:
        # a loop does not care where in it the gain is: here at the reading
        whole = np.array(
            [
                closed_loop(model.dynamics, model.duty, gain * model.reading, law)
                for gain in ROBUST_GAINS
            ]
        )
        values = np.linalg.eigvals(whole).ravel()
        angle = np.abs(np.angle(values))
        worst = max(worst, float((np.abs(values) * np.exp(_DECAY * angle)).max()))
    return worst
