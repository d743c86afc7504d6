# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `temperature_acquisition`: raw readings in, checked and averaged samples out.

Why averaging: one reading carries sensor and converter noise of about 0.1 K; the mean of the
readings of one sampling interval costs a delay of half an interval, which is nothing beside the
time constants of a machine, and halves the noise or better.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.inputs.offsets import NEGLIGIBLE, describe
from fuzzycnc_ros.core.names import repeated_names
from fuzzycnc_ros.core.thermal.sensor_check import in_units
from fuzzycnc_ros.core.thermal.sensor_limits import SensorLimits
from fuzzycnc_ros.runtime.component import (
    LATCHED,
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.enums import Status
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Bools,
    Bytes,
    CompensationApplied,
    Floats,
    MachineState,
    Record,
    Temperatures,
    ThermalReference,
    nanoseconds,
)


@dataclass(frozen=True, kw_only=True)
class TemperatureAcquisitionConfig(Config):
    """Parameters of `temperature_acquisition`."""

    source: str = param(
        'topic',
        '-',
        'Where readings come from: topic = sensor_readings (simulated machine or another node), '
        'temperature_topics = sensor_msgs/Temperature topics, csv = a file, devices = those of '
        'device_file, by whatever protocol',
        choices=('topic', 'temperature_topics', 'csv', 'devices'),
    )
    temperature_topics: tuple[str, ...] = param(
        (),
        '-',
        'Topics of sensor_msgs/Temperature as name=topic, or name=topic@frame_id where several '
        'sensors share one, for that source',
    )
    named_topics: bool = param(
        False,
        '-',
        'Publish each sensor on a topic of its own too, temperature/<sensor>, for viewers that '
        'plot by name',
    )
    reading_period: float = param(
        12.0,
        's',
        'Longest wait for all of the temperature_topics before those that are there are taken',
        low=0.01,
        high=3600.0,
    )
    csv_file: str = param(
        '',
        '-',
        'File to play, for the source csv: a time column in s and one column per sensor in degC',
    )
    csv_time: str = param('time', '-', 'Name of the time column of csv_file')
    csv_rate: float = param(
        1.0,
        '-',
        'Speed at which a file is played; at 1 its readings are stamped now, else with the times '
        'of the file',
        low=1e-3,
        high=1e6,
    )
    device_file: str = param(
        '',
        '-',
        'File that names devices and where their values lie, for the source devices '
        '(docs/how-to/your-sensors.md)',
    )
    interval: float = param(60.0, 's', 'Sampling interval of the output', low=0.01, high=3600.0)
    range_low: float = param(
        -20.0, 'degC', 'Lowest plausible reading', low=-273.15, high=1000.0, live=True
    )
    range_high: float = param(
        120.0, 'degC', 'Highest plausible reading', low=-273.15, high=1000.0, live=True
    )
    rate_max: float = param(
        10.0 / 60.0,
        'K/s',
        'Fastest plausible change of a reading',
        low=1e-6,
        high=100.0,
        live=True,
    )
    noise_band: float = param(
        2.0,
        'K',
        'Change between two readings that is never an error',
        low=0.0,
        high=50.0,
        live=True,
    )
    sensor_limits: tuple[str, ...] = param(
        (),
        '-',
        'Limits of single sensors in place of those above, as SENSOR:LIMIT:VALUE, such as '
        'bed*:rate_max:0.7; limits: range_low, range_high [degC], rate_max [K/s], noise_band [K]',
    )
    stuck_time: float = param(
        600.0,
        's',
        'Time after which a reading that has not changed by a bit is stuck; 0 is never',
        low=0.0,
        high=86400.0,
        live=True,
    )
    reference_samples: int = param(
        3, '-', 'Samples averaged into the thermal reference', low=1, high=100
    )


LATE = 120.0
"""Time after which the machine may be warm [s]: the zero can no longer be measured."""
ROOM = 5.0, 45.0
"""Temperatures of a machine that is not hot [degC], by which a wrong unit is recognised."""
TINY = 1e-6
"""Size of a temperature below which it is none [degC], unless it is 0: bytes in a wrong order."""


class TemperatureAcquisition(Component[TemperatureAcquisitionConfig]):
    """Check, average and publish the readings; set the thermal reference at a cold start."""

    NAME = 'temperature_acquisition'
    SUMMARY = 'Averages raw readings into samples and checks range, rate, stuck sensors and gaps.'
    CONFIG = TemperatureAcquisitionConfig
    APPLIED = Input('compensation_applied', CompensationApplied, quiet=True, sole=True)
    INPUTS = (
        Input('sensor_readings', Temperatures, driving=True, sole=True),
        Input('machine_state', MachineState, sole=True),
        APPLIED,
    )
    OUTPUTS = (
        Output('thermal_reference', ThermalReference, LATCHED, persistent=True),
        Output('temperatures', Temperatures),
    )

    def __init__(self, config: TemperatureAcquisitionConfig | None = None) -> None:
        super().__init__(config)
        if self._config.range_low >= self._config.range_high:
            raise ValueError(
                f'range_low = {self._config.range_low} degC must lie below '
                f'range_high = {self._config.range_high} degC'
            )
        self._own_limits = SensorLimits.of(self._config.sensor_limits)
        self._sensor: tuple[str, ...] = ()
        self._boundary: int | None = None
        self._reference: ThermalReference | None = None
        self._cold_since: int | None = None
        self._asked_by = ''
        self._forced = False
        self._collected: list[Temperatures] = []
        self._refused = ''
        self._read_at = 0
        self._start_afresh(0)

    def reconfigure(self, config: TemperatureAcquisitionConfig) -> None:
        """Take limits; they hold from the next reading on."""
        super().reconfigure(config)
        self._own_limits = SensorLimits.of(config.sensor_limits)

    def on_machine_state(self, state: MachineState) -> None:
        """Start to collect a reference when the machine reports a new cold start."""
        if state.cold_since > state.stamp:
            return  # nobody knows what will be; the machine's word of it would outlast all others
        if state.cold_since == 0 and self._cold_since is None:
            return
        if self._reference is not None and self._reference.cold_since >= state.cold_since:
            return
        if self._cold_since is None or state.cold_since > self._cold_since:
            self._collect_reference(state.cold_since, self.NAME)

    def on_compensation_applied(self, applied: CompensationApplied) -> None:
        """Note that offsets have come to zero: a forced reference moves none of them any more."""
        if not _standing(applied):
            self._forced = False

    def on_sensor_readings(self, reading: Temperatures) -> Iterator[Emission]:
        """Check one set of readings; publish a sample when an interval is full."""
        if not self._accept_sensors(reading):
            return
        if reading.stamp - self._read_at > nanoseconds(3.0 * self._config.interval):
            self._start_afresh(reading.stamp)
        self._read_at = reading.stamp
        if self._reference is not None and self._reference.stamp > reading.stamp:
            self._reference = None  # the clock was set, or the machine has begun anew: void
        status = self._verdict(reading)
        good = status == Status.OK
        self._sum[good] += reading.temperature[good]
        self._good += good
        self._count += 1
        # The latest bad verdict speaks for a sensor without one good reading.
        self._bad[~good] = status[~good]
        self._raw = np.where(np.isfinite(reading.temperature), reading.temperature, np.nan)
        interval = nanoseconds(self._config.interval)
        if self._boundary is None:
            self._boundary = -(-reading.stamp // interval) * interval
        if reading.stamp < self._boundary:
            return
        self._boundary = (reading.stamp // interval + 1) * interval
        sample = self._sample(reading)
        yield from self._reference_from(sample)
        yield Emission('temperatures', sample)

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """`set_thermal_reference`: the next samples become the reference.

        It would move the offsets that are in force with the zero that they are counted from, so
        then it has to be forced.
        """
        if name != 'set_thermal_reference':
            return super().on_request(name, arguments, stamp)
        count, standing = self._config.reference_samples, self._offsets
        # Recordings from before there was `force` hold only requests that were carried out.
        if standing and not arguments.get('force', True):
            return Answer(
                False,
                f'expected a machine without offsets but {standing} are in force: the next '
                f'{count} samples would become their zero, and they would go to what the rises '
                'against it say; deactivate the compensator and wait until they are zero, or '
                'force it',
            )
        self._collect_reference(stamp, str(arguments.get('set_by') or 'operator'))
        self._forced = bool(standing)
        text = f'the next {count} samples become the thermal reference'
        if standing:
            text += (
                f' although {standing} are in force: these go to what the rises against the new '
                'reference say, which begin at zero'
            )
        return Answer(True, text)

    def renewed(self, step: int) -> 'tuple[TemperatureAcquisition, list[Emission]]':
        """Start afresh, but for the reference: it was set that long ago as before."""
        fresh = self._afresh()
        known = self._reference
        if known is None:
            return fresh, []
        fresh._reference = replace(
            known, stamp=max(0, known.stamp + step), cold_since=max(0, known.cold_since + step)
        )
        return fresh, [Emission('thermal_reference', fresh._reference)]

    def restore(self, output: str, record: Record) -> None:
        """Take back the reference that was set before a restart."""
        if output == 'thermal_reference' and isinstance(record, ThermalReference):
            self._reference = record

    def health(self) -> list[Health]:
        """Report refused readings, bad sensors and the reference."""
        items = []
        if self._refused:
            items.append(Health('readings', Level.ERROR, self._refused))
        bad = {
            name: Status(verdict).name.lower() + self._why(place)
            for place, (name, verdict) in enumerate(zip(self._sensor, self._status, strict=True))
            if verdict != Status.OK
        }
        if bad:
            named = ', '.join(f'{name} {verdict}' for name, verdict in bad.items())
            items.append(Health('sensors', Level.WARN, f'bad sensors: {named}', bad))
        else:
            items.append(Health('sensors', Level.OK, f'{len(self._sensor)} sensors good'))
        if self._reference is None:
            text = 'no thermal reference; start from a cold machine or call set_thermal_reference'
            items.append(Health('reference', Level.WARN, text))
        else:
            text = f'set by {self._reference.set_by} at {self._reference.stamp / SECOND:.0f} s'
            items.append(Health('reference', Level.OK, text))
        if self._forced:
            text = (
                f'reference forced by {self._asked_by} while offsets are in force, now '
                f'{self._offsets}: they go to what the rises against it say'
            )
            items.append(Health('forced reference', Level.WARN, text))
        return items

    @property
    def _offsets(self) -> str:
        """Offsets in force as far as the machine has told, in words; empty if there are none."""
        applied = self.last(self.APPLIED)
        return '' if applied is None else _standing(applied)

    def _accept_sensors(self, reading: Temperatures) -> bool:
        """Refuse readings that do not fit the sensors of the run; set up at the first ones."""
        names = reading.sensor
        if not names:
            self._refused = 'expected readings of sensors but found no sensor name'
            return False
        if names == self._sensor:
            self._refused = ''
            return True
        duplicates = repeated_names(names)
        if duplicates:
            self._refused = f'duplicate sensor names: {", ".join(duplicates)}'
            return False
        if self._sensor:
            gone = sorted(set(self._sensor) - set(names))
            new = sorted(set(names) - set(self._sensor))
            what = f'missing {gone}, new {new}'
            if not gone and not new:
                place, (was, now) = next(
                    (place, pair)
                    for place, pair in enumerate(zip(self._sensor, names, strict=True), start=1)
                    if pair[0] != pair[1]
                )
                what = f'in place {place} expected {was} but found {now}'
            self._refused = f'sensors changed during the run: {what}; restart'
            return False
        self._sensor = names
        self._refused = ''
        self._read_at = reading.stamp
        self._start_afresh(reading.stamp)
        return True

    def _start_afresh(self, stamp: int) -> None:
        """Forget what earlier readings say: after a long gap any plausible value is news."""
        size = len(self._sensor)
        self._status: Bytes = np.zeros(size, np.uint8)
        self._sum: Floats = np.zeros(size)
        self._good = np.zeros(size, np.int64)
        self._count = 0
        self._bad: Bytes = np.full(size, int(Status.MISSING), np.uint8)
        self._last = np.full(size, np.nan)
        self._alive = np.zeros(size, np.bool_)
        """Sensors that have read something else than 0: one that never did is none."""
        self._changed = np.full(size, stamp, np.int64)
        self._trusted = np.full(size, np.nan)
        self._trusted_at = np.full(size, stamp, np.int64)
        self._boundary = None

    def _verdict(self, reading: Temperatures) -> Bytes:
        """Judge every reading; where nothing is found, its publisher's own verdict counts."""
        config, value = self._config, reading.temperature
        status = np.zeros(len(value), np.uint8)
        with np.errstate(invalid='ignore'):
            status[self._too_fast(value, reading.stamp)] = Status.RATE
            low, high = self._limit('range_low'), self._limit('range_high')
            status[(value < low) | (value > high)] = Status.OUT_OF_RANGE
        moved = value != self._last
        self._changed[moved] = reading.stamp
        self._last = value.copy()
        if config.stuck_time > 0.0:
            still = reading.stamp - self._changed >= nanoseconds(config.stuck_time)
            status[still & (status == Status.OK)] = Status.STUCK
        told = np.where(reading.status <= max(Status), reading.status, int(Status.MISSING))
        status = np.where(status == Status.OK, told, status).astype(np.uint8)
        self._alive |= np.isfinite(value) & (value != 0.0)
        nothing = np.where(value == 0.0, ~self._alive, np.abs(value) < TINY)
        status[~np.isfinite(value) | nothing] = Status.MISSING
        good = status == Status.OK
        self._trusted[good] = value[good]
        self._trusted_at[good] = reading.stamp
        return status

    def _why(self, place: int) -> str:
        """Return what a sensor reads that is no reading, if it reads anything."""
        value, status = float(self._last[place]), self._status[place]
        if status == Status.OUT_OF_RANGE and np.isfinite(value):
            low, high = ROOM
            found = in_units(value).items()
            fits = [f'{real:.1f} degC if in {unit}' for unit, real in found if low < real < high]
            return f' (reads {value:.5g} degC; that is {", ".join(fits)})' if fits else ''
        if status != Status.MISSING or not abs(value) < TINY:
            return ''
        if value == 0.0:
            return ' (has read 0 since the start)'
        return f' (reads {value:.3g} degC, which no sensor does)'

    def _too_fast(self, value: Floats, stamp: int) -> Bools:
        """Return which readings left the last trusted one faster than metal can.

        The allowance grows with the time since the last trusted reading, but no further than
        five noise bands, or a minute at the fastest rate: a plug that came loose must not become
        plausible by waiting.
        """
        age = (stamp - self._trusted_at) / SECOND
        rate, band = self._limit('rate_max'), self._limit('noise_band')
        slow = np.minimum(rate * age, np.maximum(5.0 * band, rate * 60.0))
        too_fast: Bools = np.abs(value - self._trusted) > band + slow
        return too_fast

    def _limit(self, name: str) -> Floats | float:
        """Return a limit: one for all sensors, or of each, where some have their own."""
        usual: float = getattr(self._config, name)
        if not self._own_limits.entries:
            return usual
        return self._own_limits.values(name, self._sensor, usual)

    def _sample(self, reading: Temperatures) -> Temperatures:
        """Average the readings since the last sample and start afresh."""
        enough = 2 * self._good > self._count
        mean = np.where(enough, self._sum / np.maximum(self._good, 1), self._raw)
        self._status = np.where(enough, np.uint8(Status.OK), self._bad).astype(np.uint8)
        sample = Temperatures(
            stamp=reading.stamp,
            frame_id=self.frame('machine'),
            sensor=self._sensor,
            temperature=mean,
            status=self._status,
            readings=self._count,
        )
        self._sum[:] = 0.0
        self._good[:] = 0
        self._count = 0
        self._bad[:] = Status.MISSING
        return sample

    def _collect_reference(self, cold_since: int, asked_by: str) -> None:
        self._cold_since = cold_since
        self._asked_by = asked_by
        self._forced = False
        self._collected = []

    def _reference_from(self, sample: Temperatures) -> Iterator[Emission]:
        """Collect the samples of a cold start; publish the reference when there are enough."""
        if self._cold_since is None:
            return
        if self._reference is not None and self._reference.cold_since >= self._cold_since:
            return
        if not self._collected:
            if sample.stamp - self._cold_since > nanoseconds(
                max(2.0 * self._config.interval, LATE)
            ):
                return
        self._collected.append(sample)
        if len(self._collected) < self._config.reference_samples:
            return
        values = np.array([item.temperature for item in self._collected])
        values[np.array([item.status for item in self._collected]) != Status.OK] = np.nan
        good = np.isfinite(values)
        total = np.where(good, values, 0.0).sum(axis=0)
        known = good.sum(axis=0)
        self._reference = ThermalReference(
            stamp=sample.stamp,
            frame_id=self.frame('machine'),
            cold_since=self._cold_since,
            set_by=self._asked_by,
            sensor=self._sensor,
            temperature=np.where(known > 0, total / np.maximum(known, 1), np.nan),
            samples=len(self._collected),
        )
        self._collected = []
        yield Emission('thermal_reference', self._reference)


def _standing(applied: CompensationApplied) -> str:
    """Return the offsets that a read-back says are not zero, in words."""
    return describe(applied.axis, applied.offset, ~(np.abs(applied.offset) <= NEGLIGIBLE))
