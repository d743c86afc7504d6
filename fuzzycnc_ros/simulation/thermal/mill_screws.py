# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The ball screws of a simulated mill: moved by a duty, read by sensors, with named faults."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import NamedTuple

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.inputs.offsets import AXES
from fuzzycnc_ros.simulation.thermal.ball_screw import (
    MOUNTINGS,
    SCREW_SENSORS,
    BallScrew,
    BallScrewConfig,
    Stroke,
)
from fuzzycnc_ros.simulation.thermal.mill import MILL_STEP, TEMPERATURE_NOISE
from fuzzycnc_ros.simulation.thermal.sensor_faults import FaultInjector, SensorFault

NUT_SENSOR_OFF, STRETCH_LOST = 'nut_sensor_off', 'stretch_lost'
SCREW_FAULTS = (NUT_SENSOR_OFF, STRETCH_LOST)
"""Faults of a screw: the sensor of its nut has come off and reads the air; the locknut of its
pre-stretch has given way."""

_STEP_NS = MILL_STEP * 1_000_000_000


class ScrewFault(NamedTuple):
    """Fault of the screw of an axis from a time after a duty began on [s]."""

    axis: str
    kind: str
    start: float


def screw_configs(screws: Sequence[str], data: Sequence[str]) -> dict[str, BallScrewConfig]:
    """Return what the screw of each axis is like.

    Parameters
    ----------
    screws : sequence of str
        Axes and mountings, as `Y:fixed_free`.
    data : sequence of str
        What differs from the defaults, as `Y:length:0.9`.

    Raises
    ------
    ValueError
        If one is malformed, or a screw cannot be like that.
    """
    given: dict[str, dict[str, float | str]] = {}
    for text in screws:
        axis, _, mounting = text.partition(':')
        if axis not in AXES or mounting not in MOUNTINGS or axis in given:
            raise ValueError(
                'screws: expected each axis once with one of the mountings '
                f'{", ".join(MOUNTINGS)}, as Y:fixed_free, but found {text!r}'
            )
        given[axis] = {'mounting': mounting}
    names = [item.name for item in fields(BallScrewConfig)][1:]
    for text in data:
        axis, _, rest = text.partition(':')
        name, _, value = rest.partition(':')
        if axis not in given or name not in names:
            raise ValueError(
                f'screw_data: expected an axis among {", ".join(given)} and a field among '
                f'{", ".join(names)}, as Y:length:0.9, but found {text!r}'
            )
        try:
            given[axis][name] = float(value)
        except ValueError:
            raise ValueError(
                f'screw_data: expected a number as in Y:length:0.9 but found {text!r}'
            ) from None
    found = {}
    for axis, values in given.items():
        try:
            found[axis] = BallScrewConfig(**values)  # type: ignore[arg-type]
        except ValueError as error:
            raise ValueError(f'screw of {axis}: {error}') from error
    return found


def screw_faults(texts: Sequence[str], screws: Sequence[str]) -> tuple[ScrewFault, ...]:
    """Return the faults of screws.

    Parameters
    ----------
    texts : sequence of str
        Faults as `Y:stretch_lost:3600`.
    screws : sequence of str
        Axes that have a screw, as `screw_configs` takes them.

    Raises
    ------
    ValueError
        If one is malformed or of an axis without a screw.
    """
    axes = [text.partition(':')[0] for text in screws]
    found = []
    for text in texts:
        axis, kind, start = [*text.split(':'), '', ''][:3]
        try:
            time = float(start)
        except ValueError:
            time = -1.0
        if axis not in axes or kind not in SCREW_FAULTS or not 0.0 <= time < np.inf:
            raise ValueError(
                f'screw_faults: expected an axis among {", ".join(axes)}, a fault among '
                f'{", ".join(SCREW_FAULTS)} and a start in s, as Y:stretch_lost:3600, '
                f'but found {text!r}'
            )
        found.append(ScrewFault(axis, kind, time))
    return tuple(found)


class MillScrews:
    """Ball screws of some axes of a mill.

    Parameters
    ----------
    configs : mapping of str to BallScrewConfig
        What the screw of each axis is like.
    faults : sequence of ScrewFault
        What gives way, and when.
    positions : sequence of float
        Positions at which these axes are measured [m].

    Attributes
    ----------
    sensors : tuple of str
        Temperature sensors, such as `Y_nut`.
    position : dict of str to float
        Where each axis is [m].
    motion : dict of str to ndarray, shape (4,)
        Integrals of `Stroke.motion` over time since the beginning, by axis.
    moving : bool
        Whether an axis moves.

    Notes
    -----
    Noise has streams of its own: a mill without screws reads the same with and without them.
    """

    def __init__(
        self,
        configs: Mapping[str, BallScrewConfig],
        faults: Sequence[ScrewFault] = (),
        positions: Sequence[float] = (0.0,),
    ) -> None:
        self._configs, self._named_faults = dict(configs), tuple(faults)
        self._positions = tuple(positions)
        if not positions or len(set(positions)) != len(positions):
            raise ValueError(
                'displacement_positions: expected positions, each once, but found '
                f'{", ".join(f"{place:g}" for place in positions) or "none"}'
            )
        self.sensors = tuple(
            f'{axis}_{place}' for axis in self._configs for place in SCREW_SENSORS
        )
        self.begin(0.0, 0)

    def begin(self, ambient: float, seed: int, faults: Sequence[SensorFault] = ()) -> None:
        """Set all screws up, cold.

        Parameters
        ----------
        ambient : float
            Temperature of everything [degC].
        seed : int
            Seed of the noise.
        faults : sequence of SensorFault
            What is wrong with the sensors.
        """
        self._screws = {axis: BallScrew(config, ambient) for axis, config in self._configs.items()}
        self._time_ns = self._steps = 0
        self._ambient = ambient
        self._strokes = {axis: Stroke(0.0, 0.0, 0.0) for axis in self._configs}
        self._injector = FaultInjector(self.sensors, faults)
        self._reading_rng = np.random.default_rng([seed, 2])
        self._displacement_rng = np.random.default_rng([seed, 3])
        self.position = dict.fromkeys(self._configs, 0.0)
        self.motion = dict.fromkeys(self._configs, np.zeros(4))
        self.moving = False

    def with_axes(self, axes: Sequence[str]) -> tuple[str, ...]:
        """Return these axes and those that have a screw, each once."""
        return (*axes, *(axis for axis in self._configs if axis not in axes))

    def move(self, period: float, strokes: Mapping[str, Stroke], since: float) -> None:
        """Let axes go on for a period [s]; heat is what `advance` makes of it.

        Parameters
        ----------
        period : float
            How long [s].
        strokes : mapping of str to Stroke
            What axes do; one that is left out stays where it is.
        since : float
            For how long they have done so at the beginning of the period [s].
        """
        self.moving = False
        for axis in self._configs:
            stroke = strokes.get(axis)
            if stroke is None:
                place = self.position[axis]
                self._strokes[axis] = Stroke(place, place, 0.0)
                continue
            self._strokes[axis] = stroke
            self.position[axis] = stroke.position(since + period)
            speed = stroke.speed
            self.motion[axis] = self.motion[axis] + period * stroke.motion
            self.moving = self.moving or speed > 0.0

    def advance(self, duration: float, ambient: Callable[[float], float]) -> None:
        """Let the screws warm up by what the axes do.

        Parameters
        ----------
        duration : float
            How long [s]; steps lie at multiples of `MILL_STEP`, the rest is carried over.
        ambient : callable
            Temperature of the surroundings [degC] at a time of the run [s].
        """
        self._time_ns += round(duration * 1e9)
        for step in range(self._steps + 1, self._time_ns // _STEP_NS + 1):
            time = float(step * MILL_STEP)
            self._ambient = ambient(time)
            for fault in self._named_faults:
                if fault.kind == STRETCH_LOST and time >= fault.start:
                    self._screws[fault.axis].stretched = False
            for axis, screw in self._screws.items():
                screw.advance(self._ambient, self._strokes[axis])
        self._steps = self._time_ns // _STEP_NS

    def read(self) -> Array:
        """Read every sensor once, with noise and faults, in the order of `sensors` [degC]."""
        true = np.concatenate([screw.temperatures() for screw in self._screws.values()])
        time = self._time_ns / 1e9
        for fault in self._named_faults:
            if fault.kind == NUT_SENSOR_OFF and time >= fault.start:
                true[self.sensors.index(f'{fault.axis}_nut')] = self._ambient
        noise = self._reading_rng.normal(0.0, TEMPERATURE_NOISE, len(true))
        return self._injector.apply(time, true + noise)

    def places(self, axes: Sequence[str]) -> tuple[tuple[str, ...], Array]:
        """Return the axis and the position [m] of each measurement; NaN without a screw."""
        found = [
            (axis, place)
            for axis in axes
            for place in (self._positions if axis in self._configs else (np.nan,))
        ]
        return tuple(axis for axis, _ in found), np.array([place for _, place in found])

    def error(self, axes: Sequence[str], position: Array) -> Array:
        """Return the true error of axes at positions [m], shape (n,) [m]; 0 without a screw."""
        return np.array(
            [
                float(self._screws[axis].error(np.array([place]))[0])
                if axis in self._screws
                else 0.0
                for axis, place in zip(axes, position.tolist(), strict=True)
            ]
        )

    def displacement_noise(self, deviation: float, count: int) -> Array:
        """Draw the noise of measurements, shape (count,) [m]."""
        return self._displacement_rng.normal(0.0, deviation, count)
