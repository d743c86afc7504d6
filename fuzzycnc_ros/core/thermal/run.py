# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A recorded thermal run: temperatures and displacements on one time axis, and windows of it.

One rule holds for every command.  A window says which samples count.  It never moves the
reference: temperatures and displacements stay referred to the first samples of the recording,
and what lies before the window warms up the lags, as it did on the machine.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil, floor, pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array, mean_of_measured
from fuzzycnc_ros.core.names import repeated_names
from fuzzycnc_ros.core.remedies import RemediedError, Remedy
from fuzzycnc_ros.core.thermal.sensor_limits import LIMIT_BOUNDS, USUAL, SensorLimits


def _even_blocks(
    time: Array, values: Array, interval: float, jitter_max: float
) -> tuple[Array, Array] | None:
    """Return readings in even blocks of one interval each.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing times of the readings [s].
    values : ndarray, shape (n, w)
        Readings; NaN where one is missing.
    interval : float
        Length of a block [s].
    jitter_max : float
        Deviation of a reading from the even grid that is ignored, as a fraction of a step [-].

    Returns
    -------
    time : ndarray, shape (blocks,)
        Time of the last reading of each block [s].
    values : ndarray, shape (blocks, block, w)
        Readings of each block.

    Or None if the readings already are one per interval.

    Notes
    -----
    Readings off the even grid are interpolated linearly onto it.  Columns with gaps are not, as
    each gap would swallow its neighbours: their readings move to the nearest grid point.
    """
    step = float(np.median(np.diff(time)))
    block = max(1, round(interval / step))
    step = interval / block
    # Half a jitter of slack keeps a last reading that came a little early.
    count = int(np.floor((time[-1] - time[0]) / step + 0.5 * jitter_max)) + 1
    grid = time[0] + np.arange(count) * step
    on_grid = count == len(time) and float(np.abs(time - grid).max()) <= jitter_max * step
    if on_grid and block == 1:
        return None
    blocks = count // block
    grid = grid[: blocks * block]
    even = values[: len(grid)] if on_grid else _moved(time, values, grid)
    return grid[block - 1 :: block], even.reshape(blocks, block, values.shape[1])


def _mean_of_most(values: Array) -> Array:
    """Return the mean over axis 1 of what is not NaN, NaN unless that is more than half."""
    enough = 2 * np.isfinite(values).sum(axis=1) > values.shape[1]
    return np.where(enough, mean_of_measured(values, 1), np.nan)


def _gaps_of(values: Array) -> Iterator[tuple[int, int, int]]:
    """Yield column, first and last row of each stretch of NaN in values (n, w)."""
    for column, readings in enumerate(values.T):
        lost = np.concatenate([[False], np.isnan(readings), [False]])
        edges = np.flatnonzero(lost[1:] != lost[:-1])
        for first, end in edges.reshape(-1, 2):
            yield column, int(first), int(end) - 1


def _bridged(time: Array, values: Array, longest: float, free: float, begin: int) -> Array:
    """Return readings whose short gaps are filled.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing times of the readings [s].
    values : ndarray, shape (n, w)
        Readings; NaN where one is missing.
    longest : float
        Longest time between two readings that is bridged [s].
    free : float
        Time up to which nothing depends on the values [s]: gaps that end by then are bridged
        however long they are.
    begin : int
        Number of first samples whose mean the readings are meant against.

    Returns
    -------
    ndarray, shape (n, w)
        A straight line from the last reading before a gap to the first one behind it; at the end
        the last reading is held.  What lacks of the first samples takes the mean of those that
        are there, so that this mean stays as it is; a column without any of them keeps its gaps.
        `values` itself where nothing was filled.
    """
    filled = values
    for column, first, last in _gaps_of(values):
        before, behind = max(first - 1, 0), min(last + 1, len(time) - 1)
        head = values[:begin, column]
        too_long = time[behind] - time[before] > longest and time[behind] > free
        if too_long or np.isnan(head).all():
            continue
        if filled is values:
            filled = values.copy()
        own = filled[:, column]
        if first < begin:
            own[first : last + 1] = np.nanmean(head)
            first = min(begin, last + 1)
        rows, before = slice(first, last + 1), first - 1
        if last + 1 == len(time):
            own[rows] = own[before]
        else:
            own[rows] = np.interp(time[rows], time[[before, behind]], own[[before, behind]])
    return filled


def _moved(time: Array, values: Array, grid: Array) -> Array:
    """Return the columns on the grid points, shape (len(grid), w)."""
    moved = np.full((len(grid), values.shape[1]), np.nan)
    if len(grid) < 2:
        return moved
    nearest = np.rint((time - grid[0]) / (grid[1] - grid[0])).astype(np.int64)
    nearest = np.clip(nearest, 0, len(grid) - 1)
    for column, readings in enumerate(values.T):
        measured = np.isfinite(readings)
        if measured.all():
            moved[:, column] = np.interp(grid, time, readings)
        else:
            moved[nearest[measured], column] = readings[measured]
    return moved


SAMPLES_MIN = 8
"""Fewest samples of a run; below that not even one heating slope is visible."""

TEMPERATURE_MIN, TEMPERATURE_MAX = -20.0, 120.0
"""Plausible range of a machine's temperature [degC]; beyond it the sensor or its unit is wrong."""

DISPLACEMENT_MAX = 500e-6
"""Largest plausible thermal displacement [m]; beyond it mm and um were mixed up."""

RISE_RATE_MAX = 10.0
"""Fastest plausible rise within one minute [K]; beyond it a plug is loose."""

SPINDLE_SPEED_MAX = 20000.0
"""Largest plausible spindle speed [rad/s], 190,000 rpm; beyond it units were mixed up."""

DRIVE_NAMES = (
    'axis_speed/X, axis_square_speed/X, axis_moment/X, axis_second_moment/X (with any axis), '
    'spindle_load or coolant'
)
MOMENT = 'axis_moment/'
"""Beginning of the name of a drive that has a sign, as positions have."""
DRIVE_NAME = re.compile(
    f'axis_(square_)?speed/.+|{MOMENT}.+|axis_second_moment/.+|spindle_load|coolant'
)
"""Names of what else than the spindle speed a control tells of heat."""

DRIVE_MAX = 1000.0
"""Largest plausible value of it, in its own unit: an axis at 30 m/s, 1000 times the rated load."""

RISE_MIN = 0.5
"""Smallest range of a rise that teaches anything [K]; below it there is only noise."""

JITTER_MAX = 0.1
"""Largest deviation of a sampling interval from the median, as a fraction of the median [-]."""

GAP_MAX = 1200.0
"""Longest gap in the readings that is bridged [s], by training and by the predictor alike: 19 min
along a straight line right after a change of speed cost 0.6 um on the simulated mill."""

SETTLE_TIME = 14400.0
"""Time after a longer gap from which the history that was lost no longer matters [s]."""

HOLE_MAX = 7.0 * 86400.0
"""Longest time without any sample that is filled where nothing depends on it [s]."""

STEPS_MAX = 10.0
"""Most samples that are made of one step of the readings [-]: they cannot be made up."""

REFERENCE_SAMPLES = 3
"""Number of first samples whose mean is the reference of a run, so that noise averages out."""


class ThermalDataError(RemediedError):
    """A run or its samples cannot be used; the message says why and what to do."""


class Gap(NamedTuple):
    """Samples in which a sensor reads nothing.

    Parameters
    ----------
    sensor : str
        Its name.
    samples : int
        Number of samples without a reading.
    start, stop : float
        Times of the readings before and behind it [s]; where there is none, those of the first
        or the last sample of the run.
    """

    sensor: str
    samples: int
    start: float
    stop: float


@dataclass(frozen=True, eq=False)
class ThermalRun:
    """Temperatures and displacements of one run, checked.

    Parameters
    ----------
    name : str
        Name of the run, as tables and model files show it.
    time : array_like, shape (n,)
        Strictly increasing time of each sample [s].
    sensor : sequence of str, length s
        Names of the temperature sensors, each once.
    temperature : array_like, shape (n, s)
        Temperatures [degC]; NaN marks a reading that is not to be used.
    channel : sequence of str, length c
        Names of the displacement channels, each once.
    axis : sequence of str, length c
        ISO 841 axis that each channel belongs to.
    displacement : array_like, shape (n, c)
        Thermal error, actual minus nominal [m]; NaN where nothing was probed.
    spindle_speed : array_like, shape (n,), optional
        Measured spindle speed [rad/s]; NaN where unknown, absent where it was not recorded.
    drives : mapping of str to array_like, shape (n,)
        Drives of heat that the control told, each a mean since the sample before: `axis_speed/X`
        [m/s], `axis_square_speed/X` [m2/s2], `axis_moment/X` [m2/s] and `axis_second_moment/X`
        [m3/s], which tell where it moved (see `places.MOTION_MEANS`), `spindle_load` [-],
        `coolant` [share of the time]; NaN where unknown.
    limits : SensorLimits
        Ranges and rates of sensors that are not those of a machine's metal.

    Raises
    ------
    ThermalDataError
        If shapes disagree, names repeat, there are fewer than 8 samples, time does not
        increase, or values are infinite or implausible.

    Notes
    -----
    Uneven sampling is accepted here and refused by `interval`; `resample` makes it even.
    The arrays are kept as read-only copies.
    """

    name: str
    time: NDArray[np.float64]
    sensor: tuple[str, ...]
    temperature: NDArray[np.float64]
    channel: tuple[str, ...]
    axis: tuple[str, ...]
    displacement: NDArray[np.float64]
    spindle_speed: NDArray[np.float64] | None = None
    drives: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    limits: SensorLimits = USUAL

    def __post_init__(self) -> None:
        """Take read-only copies and check them."""
        for name in ('sensor', 'channel', 'axis'):
            object.__setattr__(self, name, tuple(str(item) for item in getattr(self, name)))
        for name in ('time', 'temperature', 'displacement'):
            object.__setattr__(self, name, _read_only(getattr(self, name)))
        if self.spindle_speed is not None:
            object.__setattr__(self, 'spindle_speed', _read_only(self.spindle_speed))
        drives = {name: _read_only(values) for name, values in self.drives.items()}
        object.__setattr__(self, 'drives', drives)
        _check_shapes(self)
        _check_names(self)
        _check_time(self)
        _check_values(self)

    @property
    def interval(self) -> float:
        """Sampling interval [s], the median step.

        Raises
        ------
        ThermalDataError
            If a step deviates from the median by more than 10 %.
        """
        steps = np.diff(self.time)
        median = float(np.median(steps))
        worst = int(np.argmax(np.abs(steps - median)))
        if abs(steps[worst] - median) > JITTER_MAX * median:
            raise ThermalDataError(
                f'run {self.name!r}: expected even sampling, but found a step of '
                f'{steps[worst]:.6g} s after sample {worst} where the median is {median:.6g} s; '
                'resample the run first'
            )
        # The mean is exact where the median of noisy stamps is not.
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))

    def reference(self) -> NDArray[np.float64]:
        """Return the mean of what each sensor read in the first three samples, shape (s,) [degC].

        NaN for one that read nothing.
        """
        return mean_of_measured(self.temperature[:REFERENCE_SAMPLES], 0)

    def rise(self, reference: ArrayLike | None = None) -> NDArray[np.float64]:
        """Return temperature minus reference.

        Parameters
        ----------
        reference : array_like, shape (s,), optional
            Reference of each sensor [degC]; the mean of its first three samples if absent.

        Returns
        -------
        ndarray, shape (n, s)
            Rise [K].

        Raises
        ------
        ThermalDataError
            If `reference` has another length than `sensor`.
        """
        base = self.reference() if reference is None else np.asarray(reference, dtype=np.float64)
        if base.shape != (len(self.sensor),):
            raise ThermalDataError(
                f'reference: expected {len(self.sensor)} temperatures, one per sensor of run '
                f'{self.name!r}, but found shape {base.shape}'
            )
        return np.asarray(self.temperature - base)

    def columns(self, sensors: Sequence[str]) -> NDArray[np.int64]:
        """Return the column of each named sensor.

        Raises
        ------
        ThermalDataError
            If the run lacks one of the sensors; the message names all that are missing.
        """
        position = {name: index for index, name in enumerate(self.sensor)}
        missing = [name for name in sensors if name not in position]
        if missing:
            raise ThermalDataError(
                f'run {self.name!r}: expected the sensors {", ".join(sensors)}, but found no '
                f'{", ".join(missing)}; the run has {", ".join(self.sensor)}'
            )
        return np.array([position[name] for name in sensors], dtype=np.int64)

    def resample(self, interval: float) -> 'ThermalRun':
        """Return the run at another interval, each sample the mean of one block of readings.

        What `bridged` can fill is filled.

        Parameters
        ----------
        interval : float
            New sampling interval [s], positive.

        Returns
        -------
        ThermalRun
            Samples stamped with the last reading of their block, so that nothing is known
            before its time; an incomplete last block is dropped.

        Raises
        ------
        ThermalDataError
            If `interval` is not positive, far below the run's step or leaves fewer than 8
            samples, or if no sensor has readings for more than `GAP_MAX`.
        """
        return self.averaged(interval).bridged()

    def averaged(self, interval: float) -> 'ThermalRun':
        """Return what `resample` does, before gaps are bridged.

        Notes
        -----
        Uneven readings, or an interval that is no multiple of theirs, are interpolated
        linearly onto an even grid first.  A sensor is averaged over its readings where it has
        more than half of the block, as by `temperature_acquisition`, and is NaN else.  Channels
        with gaps are averaged over what was measured in the block; a block without a measurement
        stays NaN.
        """
        if not (np.isfinite(interval) and interval > 0.0):
            raise ThermalDataError(
                f'interval: expected a positive number of s, but found {interval}'
            )
        steps = np.diff(self.time)
        shortest = float(np.median(steps)) / STEPS_MAX
        if interval < shortest:
            raise ThermalDataError(
                f'interval: expected at least {shortest:g} s, a tenth of the step of run '
                f'{self.name!r}, but found {interval:g} s; readings cannot be made up'
            )
        self._check_steps(_bridged_max(max(interval, float(np.median(steps)))))
        columns = [self.temperature, self.displacement]
        if self.spindle_speed is not None:
            columns.append(self.spindle_speed[:, np.newaxis])
        columns += [values[:, np.newaxis] for values in self.drives.values()]
        even = _even_blocks(self.time, np.hstack(columns), interval, JITTER_MAX)
        if even is None:
            return self
        time, values = even
        if len(time) < SAMPLES_MIN:
            raise ThermalDataError(
                f'run {self.name!r}: expected at least {SAMPLES_MIN} samples, but found '
                f'{len(time)} blocks of {interval:g} s; choose a shorter interval or record longer'
            )
        sensors, channels = len(self.sensor), len(self.channel)
        ends = np.cumsum([sensors, channels, self.spindle_speed is not None])
        temperature, displacement, speed, drives = np.split(values, ends, axis=2)
        return replace(
            self,
            time=time,
            temperature=_mean_of_most(temperature),
            displacement=mean_of_measured(displacement, 1),
            spindle_speed=None
            if self.spindle_speed is None
            # Heat goes with the square of the speed, and so must its mean.
            else np.sqrt(mean_of_measured(speed * speed, 1))[:, 0],
            drives=dict(zip(self.drives, mean_of_measured(drives, 1).T, strict=True)),
        )

    def bridged(self) -> 'ThermalRun':
        """Return the run with the short gaps of its sensors filled, as the predictor does.

        A straight line goes over gaps of up to `GAP_MAX`; at the end the last reading is held.
        What lacks of the first three samples takes the mean of those that are there.  Longer gaps
        are bridged where the first displacement comes `SETTLE_TIME` later, else they stay, and so
        do all of a sensor without any of the first three samples.
        """
        longest = _bridged_max(float(np.median(np.diff(self.time))))
        values = _bridged(
            self.time, self.temperature, longest, self._settled_until, REFERENCE_SAMPLES
        )
        return self if values is self.temperature else replace(self, temperature=values)

    @property
    def _settled_until(self) -> float:
        """Time up to which the temperatures do not matter to any displacement [s]."""
        measured = np.isfinite(self.displacement).any(axis=1)
        return float(self.time[measured.argmax()]) - SETTLE_TIME

    def _check_steps(self, longest: float) -> None:
        """Refuse times without any sample that are longer than what is bridged [s]."""
        steps = np.diff(self.time)
        matters = (self.time[1:] > self._settled_until) | (steps > HOLE_MAX)
        refused = np.where((steps > longest) & matters, steps, 0.0)
        gap = int(np.argmax(refused))
        if not refused[gap]:
            return
        settled = float(self.time[gap + 1]) + SETTLE_TIME
        before = f'{self.time[gap]:.10g}'
        remedies = [Remedy(f'use the part before it, up to {before} s', {'end': before})]
        if settled < self.time[-1] and steps[gap] <= HOLE_MAX:
            hours = f'{SETTLE_TIME / 3600.0:g} h'
            words = f'use what comes {hours} behind it, from {settled:.10g} s'
            remedies.append(Remedy(words, {'start': f'{settled:.10g}'}))
        raise ThermalDataError(
            f'run {self.name!r}: expected gaps of at most {longest:g} s, but found '
            f'{steps[gap]:.6g} s after sample {gap}',
            *remedies,
        )

    def gaps(self) -> tuple[Gap, ...]:
        """Return where sensors read nothing, sensor by sensor."""
        end = len(self.time) - 1
        return tuple(
            Gap(
                self.sensor[column],
                last + 1 - first,
                float(self.time[max(first - 1, 0)]),
                float(self.time[min(last + 1, end)]),
            )
            for column, first, last in _gaps_of(self.temperature)
        )

    def window(self, start: float | None = None, stop: float | None = None) -> 'ThermalRun':
        """Return the samples with `start` <= time <= `stop` [s].

        Raises
        ------
        ThermalDataError
            If fewer than 8 samples lie in the window.
        """
        inside = self.inside(start, stop)
        return replace(
            self,
            time=self.time[inside],
            temperature=self.temperature[inside],
            displacement=self.displacement[inside],
            spindle_speed=None if self.spindle_speed is None else self.spindle_speed[inside],
            drives=_rows_of(self, inside),
        )

    def inside(self, start: float | None = None, stop: float | None = None) -> NDArray[np.bool_]:
        """Return which samples have `start` <= time <= `stop` [s], shape (n,)."""
        low = -np.inf if start is None else start
        high = np.inf if stop is None else stop
        return np.asarray((self.time >= low) & (self.time <= high))


def _bridged_max(interval: float) -> float:
    """Return the longest time between two readings that is bridged [s]; the stamps round."""
    return GAP_MAX + interval + 1e-6


def _read_only(values: ArrayLike) -> NDArray[np.float64]:
    copy = np.array(values, dtype=np.float64)
    copy.flags.writeable = False
    return copy


def _rows_of(run: ThermalRun, rows: NDArray[Any] | slice) -> dict[str, NDArray[np.float64]]:
    return {name: values[rows] for name, values in run.drives.items()}


def _check_shapes(run: ThermalRun) -> None:
    samples = len(run.time) if run.time.ndim == 1 else -1
    expected = {
        'time': (samples,),
        'temperature': (samples, len(run.sensor)),
        'displacement': (samples, len(run.channel)),
    }
    if run.spindle_speed is not None:
        expected['spindle_speed'] = (samples,)
    found_of = {name: getattr(run, name).shape for name in expected}
    for name, values in run.drives.items():
        expected[name], found_of[name] = (samples,), values.shape
    for name, shape in expected.items():
        found = found_of[name]
        if samples < 0 or found != shape:
            raise ThermalDataError(
                f'run {run.name!r}: expected {name} of shape '
                f'{shape if samples >= 0 else "(n,)"}, but found {found}'
            )
    if len(run.axis) != len(run.channel):
        raise ThermalDataError(
            f'run {run.name!r}: expected one axis per channel ({len(run.channel)}), '
            f'but found {len(run.axis)}'
        )
    if samples < SAMPLES_MIN:
        raise ThermalDataError(
            f'run {run.name!r}: expected at least {SAMPLES_MIN} samples, but found {samples}'
        )
    if not run.sensor:
        raise ThermalDataError(f'run {run.name!r}: expected at least one sensor, found none')


def _check_names(run: ThermalRun) -> None:
    for kind in ('sensor', 'channel'):
        names: tuple[str, ...] = getattr(run, kind)
        repeated = repeated_names(names)
        if repeated:
            raise ThermalDataError(
                f'run {run.name!r}: expected each {kind} once, but found '
                f'{", ".join(repeated)} more than once; rename the columns'
            )


def _check_time(run: ThermalRun) -> None:
    if not np.isfinite(run.time).all():
        at = int(np.flatnonzero(~np.isfinite(run.time))[0])
        raise ThermalDataError(
            f'run {run.name!r}: expected finite times, but found {run.time[at]} at sample {at}'
        )
    backwards = np.flatnonzero(np.diff(run.time) <= 0.0)
    if len(backwards):
        at = int(backwards[0])
        raise ThermalDataError(
            f'run {run.name!r}: expected increasing times, but found {run.time[at + 1]:.6g} s '
            f'after {run.time[at]:.6g} s at sample {at + 1}'
        )


def _check_values(run: ThermalRun) -> None:
    low, high = temperature_range(run.limits, run.sensor)
    outside = (run.temperature < low) | (run.temperature > high)
    if outside.any():
        row, column = (int(index) for index in np.argwhere(outside)[0])
        value = float(run.temperature[row, column])
        raise ThermalDataError(
            f'run {run.name!r}: expected temperatures within {low[column]:g} and '
            f'{high[column]:g} degC, but found {value:g} of sensor '
            f'{run.sensor[column]!r} at sample {row}; check its unit and mark the reading as NaN',
            without_sensors(run.sensor[column]),
            *within_range(run.sensor[column], value, too_hot=value > high[column]),
        )
    far = np.abs(run.displacement) > DISPLACEMENT_MAX
    if far.any():
        row, column = np.argwhere(far)[0]
        raise ThermalDataError(
            f'run {run.name!r}: expected displacements within +-{DISPLACEMENT_MAX * 1e6:g} µm, '
            f'but found {run.displacement[row, column] * 1e6:.6g} µm in channel '
            f'{run.channel[column]!r} at sample {row}; check whether mm, µm and m were mixed up'
        )
    if run.spindle_speed is not None:
        fastest = float(np.nanmax(np.abs(run.spindle_speed), initial=0.0))
        if fastest > SPINDLE_SPEED_MAX:
            raise ThermalDataError(
                f'run {run.name!r}: expected a spindle speed of at most {SPINDLE_SPEED_MAX:g} '
                f'rad/s, but found {fastest:g} rad/s; check whether it is in rpm'
            )
    for name, values in run.drives.items():
        if not DRIVE_NAME.fullmatch(name):
            raise ThermalDataError(
                f'run {run.name!r}: expected drives named {DRIVE_NAMES}, but found {name!r}'
            )
        least = -DRIVE_MAX if name.startswith(MOMENT) else 0.0
        wrong = values[(values < least) | (values > DRIVE_MAX)]
        if len(wrong):
            raise ThermalDataError(
                f'run {run.name!r}: expected {name} from {least:g} to {DRIVE_MAX:g}, but found '
                f'{wrong[0]:g}; check its unit'
            )


def temperature_range(limits: SensorLimits, sensors: Sequence[str]) -> tuple[Array, Array]:
    """Return the lowest and the highest plausible temperature of each sensor [degC]."""
    return (
        limits.values('range_low', sensors, TEMPERATURE_MIN),
        limits.values('range_high', sensors, TEMPERATURE_MAX),
    )


def within_range(sensor: str, value: float, *, too_hot: bool) -> list[Remedy]:
    """Return the remedy to take a temperature [degC] of a sensor for plausible, if it can be."""
    low, high = LIMIT_BOUNDS['range_high']
    if not low <= value <= high:
        return []
    limit = 'range_high' if too_hot else 'range_low'
    words = f'if {sensor} gets so {"hot" if too_hot else "cold"}, give it limits of its own'
    rounded = ceil(value / 10.0) * 10 if too_hot else floor(value / 10.0) * 10
    return [Remedy(words, {'sensor_limits': f'{sensor}:{limit}:{rounded}'})]


def without_sensors(*names: str) -> Remedy:
    """Return the remedy to do without some sensors."""
    return Remedy(f'leave {", ".join(names)} out', {'drop_sensor': ','.join(names)})


def counted(run: ThermalRun, start: float | None = None, stop: float | None = None) -> ThermalRun:
    """Return a run of which only the samples from `start` to `stop` [s] are measured.

    Samples before `start` keep their temperatures, which warm up the lags, and lose their
    displacements; samples after `stop` are dropped.

    Raises
    ------
    ThermalDataError
        If no sample lies in the window.
    """
    inside = run.inside(start, stop)
    if not inside.any():
        raise ThermalDataError(
            f'run {run.name!r}: expected samples between {start} and {stop} s, but found it to '
            f'last from {run.time[0]:.6g} to {run.time[-1]:.6g} s'
        )
    last = int(np.flatnonzero(inside)[-1]) + 1
    return replace(
        run,
        time=run.time[:last],
        temperature=run.temperature[:last],
        displacement=np.where(inside[:last, np.newaxis], run.displacement[:last], np.nan),
        spindle_speed=None if run.spindle_speed is None else run.spindle_speed[:last],
        drives=_rows_of(run, slice(last)),
    )


def hidden(run: ThermalRun, inside: NDArray[np.bool_]) -> ThermalRun:
    """Return a run that tells nothing of some of its samples, for training on the others.

    Parameters
    ----------
    run : ThermalRun
        An even run.
    inside : ndarray of bool, shape (n,)
        Samples to hide.

    Returns
    -------
    ThermalRun
        It ends with the last sample that is not hidden.  In the hidden ones before there is no
        displacement, each temperature goes in a straight line from the last
        sample before to the first one after, and the speed stays what it was before: the lags of
        later samples need some value, and it must not come from what is held out.  The first
        three samples keep their temperatures, since all later ones are referred to them.
    """
    last = int(np.flatnonzero(~inside)[-1]) + 1
    run, inside = run.window(stop=float(run.time[last - 1])), inside[:last]
    untold = inside & (np.arange(len(inside)) >= REFERENCE_SAMPLES)
    seen, gone = np.flatnonzero(~untold), np.flatnonzero(untold)
    temperature = run.temperature.copy()
    for readings in temperature.T:
        readings[gone] = np.interp(run.time[gone], run.time[seen], readings[seen])
    # Of each row the last that is seen.
    row = np.arange(len(inside))
    row[gone] = seen[np.maximum(np.searchsorted(seen, gone) - 1, 0)]
    return replace(
        run,
        temperature=temperature,
        displacement=np.where(inside[:, np.newaxis], np.nan, run.displacement),
        spindle_speed=None if run.spindle_speed is None else run.spindle_speed[row],
        drives=_rows_of(run, row),
    )


SPINDLE_SPEED = 'spindle_speed'
"""Name of the driver that follows from the spindle speed."""

SPEED_UNIT = 2.0 * pi * 1000.0 / 60.0
"""Spindle speed whose square is the unit of the driver [rad/s]."""


def speed_drive(speed: Array) -> Array:
    """Return the driver [-] of spindle speeds [rad/s]: their square over that of 1000 rpm."""
    return np.asarray(np.square(speed / SPEED_UNIT))


def driven_speed(drive: Array) -> Array:
    """Return the size of the spindle speeds [rad/s] of drivers [-], undoing `speed_drive`."""
    return np.asarray(SPEED_UNIT * np.sqrt(drive))


def speed_known(run: ThermalRun) -> bool:
    """Return whether a run has its spindle speed in every sample."""
    return run.spindle_speed is not None and bool(np.isfinite(run.spindle_speed).all())


def driver_known(run: ThermalRun, name: str) -> bool:
    """Return whether a run has a driver in every sample."""
    if name == SPINDLE_SPEED:
        return speed_known(run)
    return name in run.drives and bool(np.isfinite(run.drives[name]).all())


def drivers_of(runs: Sequence[ThermalRun]) -> tuple[str, ...]:
    """Return the drivers that all runs have without a gap, the spindle speed first."""
    # What never changes tells nothing that a constant would not.
    speed = all(map(speed_known, runs)) and any(
        float(np.ptp(run.spindle_speed)) > 0.0  # type: ignore[arg-type]
        for run in runs
    )
    drives = [
        name
        for name in sorted(set.intersection(*(set(run.drives) for run in runs)))
        if 'moment' not in name  # they tell where an axis moved, not how much heat it made
        and all(driver_known(run, name) for run in runs)
        and any(float(np.ptp(run.drives[name])) > 0.0 for run in runs)
    ]
    return ((SPINDLE_SPEED,) if speed else ()) + tuple(drives)


def drive_of(run: ThermalRun, drivers: Sequence[str]) -> Array:
    """Return the drivers of a run, shape (n, d).

    Raises
    ------
    ThermalDataError
        If the run lacks a driver or has gaps in it.
    """
    columns = np.empty((len(run.time), len(drivers)))
    for column, name in zip(columns.T, drivers, strict=True):
        values = run.spindle_speed if name == SPINDLE_SPEED else run.drives.get(name)
        words = 'a spindle speed' if name == SPINDLE_SPEED else name
        topics = 'machine_state or spindle_speed' if name == SPINDLE_SPEED else 'machine_state'
        if values is None:
            raise ThermalDataError(
                f'run {run.name!r}: expected {words} in every sample, since the model reads '
                f'it, but found none; record {topics}, or train without it'
            )
        lost = np.flatnonzero(~np.isfinite(values))
        if len(lost):
            raise ThermalDataError(
                f'run {run.name!r}: expected {words} in every sample, since the model reads '
                f'it, but found none at sample {lost[0]}; train without it'
            )
        column[:] = speed_drive(values) if name == SPINDLE_SPEED else values
    return columns
