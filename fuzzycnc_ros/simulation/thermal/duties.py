# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Duties of the simulated mill and seeded recordings of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.simulation.thermal.ball_screw import Stroke
from fuzzycnc_ros.simulation.thermal.mill import (
    DISPLACEMENT_NOISE,
    MILL_AXES,
    MILL_SENSORS,
    RPM,
    TEMPERATURE_NOISE,
    ThermalMill,
)
from fuzzycnc_ros.simulation.thermal.sensor_faults import FaultInjector, SensorFault

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal.run import ThermalRun


@dataclass(frozen=True)
class DutyBlock:
    """A stretch of constant spindle speed and of axes that go back and forth.

    Parameters
    ----------
    spindle_speed : float
        Spindle speed [rad/s].
    duration : float
        Length [s].
    strokes : tuple of (str, Stroke)
        What each axis does meanwhile; one that is left out stands.
    """

    spindle_speed: float
    duration: float
    strokes: tuple[tuple[str, Stroke], ...] = ()

    def __post_init__(self) -> None:
        if not isfinite(self.spindle_speed):
            raise ValueError(
                f'spindle_speed: expected a finite number but found {self.spindle_speed}'
            )
        if not (isfinite(self.duration) and self.duration > 0.0):
            raise ValueError(f'duration: expected more than 0 s but found {self.duration} s')


@dataclass(frozen=True)
class Duty:
    """Duty of a mill for a while, and the temperature of the shop meanwhile.

    Parameters
    ----------
    name : str
        Name of the duty.
    blocks : tuple of DutyBlock
        Stretches of constant spindle speed, one after the other.
    base : float
        Ambient temperature at the start [degC].
    amplitude : float
        Half of the daily swing of the ambient temperature [K].
    phase_hours : float
        Time of day at the start [h].
    """

    name: str
    blocks: tuple[DutyBlock, ...]
    base: float
    amplitude: float
    phase_hours: float

    @property
    def duration(self) -> float:
        """Length of the duty [s]."""
        return sum(block.duration for block in self.blocks)

    def spindle_speed(self, time: float) -> float:
        """Return the spindle speed in force from `time` [s] on [rad/s]; 0 outside the duty."""
        block, _ = self._block(time)
        return 0.0 if block is None else block.spindle_speed

    def motion(self, time: float) -> tuple[dict[str, Stroke], float]:
        """Return what the axes do from `time` [s] on, and since when they have [s]."""
        block, since = self._block(time)
        return ({} if block is None else dict(block.strokes)), since

    def _block(self, time: float) -> tuple[DutyBlock | None, float]:
        """Return the block in force from `time` [s] on and for how long it has been [s]."""
        begin = 0.0
        for block in self.blocks:
            if begin <= time < begin + block.duration:
                return block, time - begin
            begin += block.duration
        return None, 0.0

    def mill(self, *, seed: int = 0, faults: Sequence[SensorFault] = ()) -> ThermalMill:
        """Return a mill in this duty's surroundings, at its start."""
        return ThermalMill(
            base=self.base,
            amplitude=self.amplitude,
            phase_hours=self.phase_hours,
            seed=seed,
            faults=faults,
        )


def _duty(
    name: str, rpm_and_minutes: Iterable[tuple[float, float]], ambient: tuple[float, float, float]
) -> Duty:
    """Build a duty from the units of its table."""
    blocks = tuple(DutyBlock(rpm * RPM, 60.0 * minutes) for rpm, minutes in rpm_and_minutes)
    return Duty(name, blocks, *ambient)


_T3_RPM = (2e3, 0, 0, 500, 0, 2e3, 2e3, 1e3, 0, 0, 500, 1e3, 1500, 1e3, 500, 0, 1500, 1500, 0, 0)

DUTIES = {
    duty.name: duty
    for duty in (
        _duty('D0', [(1000, 80), (2000, 120)], (20, 2, 0)),
        _duty('D0b', [(1000, 80), (2000, 120)], (26, 2, 6)),
        _duty('T1', [(2000, 60), (0, 40), (1500, 100)], (20, 2, 10)),
        _duty('T2', [(1500, 60), (500, 60), (2000, 80)], (17, 2, 0)),
        _duty('T3', [(rpm, 20) for rpm in _T3_RPM], (24, 3, 1)),
    )
}
"""The five duties by name, in the order in which their noise is drawn."""

STANDING = 6
"""Time for which duties with axis motion begin cold [min]."""

_LONG, _MIDDLE, _SHORT = (-0.45, -0.05), (-0.3, -0.1), (-0.45, -0.35)


def _moving(
    name: str,
    blocks: Iterable[tuple[float, float, Mapping[str, tuple[tuple[float, float], float]]]],
    ambient: tuple[float, float, float],
) -> Duty:
    """Build a duty of rpm, minutes, and per axis the ends of its stroke [m] and speed [m/s].

    The machine stands for the first minutes, in which the reference is taken.
    """
    return Duty(
        name,
        tuple(
            DutyBlock(
                rpm * RPM,
                60.0 * minutes,
                tuple((axis, Stroke(*ends, speed)) for axis, (ends, speed) in strokes.items()),
            )
            for rpm, minutes, strokes in ((0, STANDING, {}), *blocks)
        ),
        *ambient,
    )


AXIS_DUTIES = {
    duty.name: duty
    for duty in (
        _moving('axis_Y', [(0, 120, {'Y': (_LONG, 0.25)}), (0, 60, {})], (20, 0, 0)),
        _moving(
            'axis_A',
            [
                (1000, 70, {'Y': (_LONG, 0.2), 'Z': (_MIDDLE, 0.05)}),
                (0, 50, {}),
                (2000, 60, {'Y': (_LONG, 0.08), 'Z': (_LONG, 0.2)}),
                (1500, 60, {'Y': (_MIDDLE, 0.2), 'Z': (_LONG, 0.1)}),
            ],
            (20, 2, 0),
        ),
        _moving(
            'axis_B',
            [
                (0, 60, {'Y': (_LONG, 0.15), 'Z': (_LONG, 0.2)}),
                (2000, 60, {'Y': (_MIDDLE, 0.06)}),
                (500, 40, {}),
                (1000, 80, {'Y': (_LONG, 0.25), 'Z': (_MIDDLE, 0.15)}),
            ],
            (24, 2, 6),
        ),
        _moving(
            'axis_work',
            [
                (1500, 45, {'Y': (_LONG, 0.24), 'Z': (_LONG, 0.15)}),
                (1500, 60, {'Y': (_LONG, 0.12), 'Z': (_MIDDLE, 0.08)}),
                (0, 30, {}),
                (2000, 75, {'Y': (_LONG, 0.22), 'Z': (_LONG, 0.2)}),
                (500, 30, {'Y': (_MIDDLE, 0.1), 'Z': (_MIDDLE, 0.05)}),
            ],
            (22, 2, 3),
        ),
        _moving(
            'axis_short',
            [(1000, 150, {'Y': (_SHORT, 0.25), 'Z': (_SHORT, 0.1)}), (0, 30, {})],
            (21, 1, 4),
        ),
    )
}
"""Duties with axis motion by name: a warm-up of Y alone, two to calibrate with, a working day, and
one that works a short stroke again and again."""


@lru_cache(maxsize=16)
def simulate_duty(duty: Duty, interval: float = 60.0) -> ThermalRun:
    """Run a duty and record it without noise; its displacement is the truth.

    Parameters
    ----------
    duty : Duty
        What to run.
    interval : float
        Time between two rows [s]; a divisor of every block's duration.

    Returns
    -------
    ThermalRun
        Rows from time 0 to the end of the duty, both included: 201 rows for 200 min at the
        default interval.  A row's spindle speed is that of the interval before it.

    Raises
    ------
    ValueError
        If the interval does not divide a block's duration.
    """
    mill = duty.mill()
    temperature, displacement = [mill.sensor_temperatures()], [mill.displacement()]
    speed = [0.0]
    for block in duty.blocks:
        rows = round(block.duration / interval) if interval > 0.0 else 0
        if rows < 1 or abs(rows * interval - block.duration) > 1e-6:
            raise ValueError(
                f'interval: expected a divisor of the block of {block.duration:g} s in duty '
                f'{duty.name} but found {interval:g} s'
            )
        for _ in range(rows):
            mill.advance(interval, block.spindle_speed)
            temperature.append(mill.sensor_temperatures())
            displacement.append(mill.displacement())
            speed.append(block.spindle_speed)
    return _run(
        duty.name,
        interval * np.arange(len(temperature), dtype=np.float64),
        temperature,
        np.array(displacement),
        np.array(speed),
    )


def record_runs(
    names: Iterable[str] = tuple(DUTIES),
    seed: int = 0,
    *,
    faults: Sequence[SensorFault] = (),
) -> dict[str, ThermalRun]:
    """Record duties with seeded noise, one row a minute.

    Parameters
    ----------
    names : iterable of str
        Duties of `DUTIES`.
    seed : int
        Seed s: noise comes from `default_rng(1000 + s)`, drawn for D0, D0b, T1,
        T2, T3 in this order, per run first all temperatures row by row, then Y, then Z.  A
        run's noise is the same whichever names are asked for.
    faults : sequence of SensorFault
        Sensor faults, the same in every run.

    Returns
    -------
    dict of str to ThermalRun
        The runs in the order asked for.  The true displacement is `simulate_duty`'s.

    Raises
    ------
    ValueError
        If a name is no duty of the sheet.
    """
    wanted = tuple(names)
    unknown = [name for name in wanted if name not in DUTIES]
    if unknown:
        raise ValueError(
            f'names: expected duties among {", ".join(DUTIES)} but found {", ".join(unknown)}'
        )
    rng = np.random.default_rng(1000 + seed)
    # A run that was not asked for still takes its noise, else the later ones would change.
    recorded = {name: _add_noise(simulate_duty(duty), rng) for name, duty in DUTIES.items()}
    return {name: _with_faults(recorded[name], faults) for name in wanted}


def record_run(
    duty: Duty | str, seed: int = 0, *, faults: Sequence[SensorFault] = ()
) -> ThermalRun:
    """Record one duty with seeded noise, one row a minute.

    Parameters
    ----------
    duty : Duty or str
        A duty of the sheet, by name or as it stands in `DUTIES`, gets the noise of
        `record_runs`; any other duty the first noise of `default_rng(1000 + seed)`.
    seed : int
        Seed of the noise.
    faults : sequence of SensorFault
        Sensor faults.

    Returns
    -------
    ThermalRun
        The noisy run.

    Raises
    ------
    ValueError
        If a name is no duty of the sheet.
    """
    name = duty if isinstance(duty, str) else duty.name
    if isinstance(duty, str) or DUTIES.get(name) == duty:
        return record_runs([name], seed, faults=faults)[name]
    rng = np.random.default_rng(1000 + seed)
    return _with_faults(_add_noise(simulate_duty(duty), rng), faults)


def _run(
    name: str,
    time: NDArray[np.float64],
    temperature: Sequence[NDArray[np.float64]] | NDArray[np.float64],
    displacement: NDArray[np.float64],
    spindle_speed: NDArray[np.float64] | None,
) -> ThermalRun:
    # Here, as a machine that runs needs no recorded runs.
    from fuzzycnc_ros.core.thermal.run import ThermalRun

    return ThermalRun(
        name=name,
        time=time,
        sensor=MILL_SENSORS,
        temperature=np.asarray(temperature),
        channel=MILL_AXES,
        axis=MILL_AXES,
        displacement=displacement,
        spindle_speed=spindle_speed,
    )


def _add_noise(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
    temperature = run.temperature + rng.normal(0.0, TEMPERATURE_NOISE, run.temperature.shape)
    noise = [rng.normal(0.0, DISPLACEMENT_NOISE, len(run.time)) for _ in MILL_AXES]
    displacement = run.displacement + np.column_stack(noise)
    return _run(run.name, run.time, temperature, displacement, run.spindle_speed)


def _with_faults(run: ThermalRun, faults: Sequence[SensorFault]) -> ThermalRun:
    if not faults:
        return run
    injector = FaultInjector(MILL_SENSORS, faults)
    rows = [injector.apply(t, row) for t, row in zip(run.time, run.temperature, strict=True)]
    return _run(run.name, run.time, rows, run.displacement, run.spindle_speed)
