# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `simulated_machine`: the thermal mill of method sheet 001 as a machine on topics.

It is the only component that makes time: `tick` moves the machine on by one period.  Whoever
hosts it decides when that happens, a lock-step sequencer or a clock.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.components.component import Component, Emission, Health, Input, Level, Output
from fuzzycnc_ros.components.records import (
    Compensation,
    CompensationApplied,
    Displacement,
    MachineMode,
    MachineState,
    Temperatures,
    nanoseconds,
)
from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.machine.duties import DUTIES, Duty
from fuzzycnc_ros.core.machine.mill import DISPLACEMENT_NOISE, MILL_AXES, MILL_SENSORS, ThermalMill
from fuzzycnc_ros.core.machine.offset_input import OffsetInput, OffsetInputConfig
from fuzzycnc_ros.core.machine.sensor_faults import parse_sensor_fault

DAY_START = 6 * 3600.0
"""Machine time at which the first duty starts [s]: six in the morning of day one."""
DAY = 24 * 3600.0
"""Time between the starts of two duties [s]: every duty starts from a cold machine."""


@dataclass(frozen=True, kw_only=True)
class SimulatedMachineConfig(Config):
    """Parameters of `simulated_machine`."""

    duties: tuple[str, ...] = param(
        ('T2',), '-', 'Duties to run, one a day, each from cold: D0, D0b, T1, T2, T3'
    )
    duty_duration: float = param(
        0.0, 's', 'Time after which each duty is cut off; 0 runs it whole', low=0.0, high=864000.0
    )
    seed: int = param(0, '-', 'Seed of all measuring noise', low=0, high=2**31 - 1)
    tick_period: float = param(
        12.0, 's', 'Machine time between two sets of readings', low=0.1, high=60.0
    )
    rate: float = param(
        1.0, '-', 'Speed of machine time without lock-step; 1 is real time', low=0.01, high=1e4
    )
    displacement_interval: float = param(
        60.0, 's', 'Machine time between two displacement measurements', low=0.1, high=3600.0
    )
    sensor_faults: tuple[str, ...] = param(
        (), '-', 'Sensor faults as sensor:kind:start[:value], start in s after a duty began'
    )
    offset_max: float = param(
        60e-6, 'm', "The machine's own limit of an offset", low=1e-6, high=1e-3
    )
    slew_max: float = param(
        0.5e-6, 'm/s', "The machine's own limit of an offset's change", low=1e-9, high=1e-3
    )
    lockstep_nodes: tuple[str, ...] = param(
        ('temperature_acquisition', 'sensor_selector', 'thermal_predictor', 'compensator'),
        '-',
        'Nodes of the run: in lock-step they get turns in this order, else the start awaits them',
    )
    start_timeout: float = param(
        10.0,
        's',
        'Wall time after which a run without lock-step starts without nodes that are missing',
        low=0.0,
        high=600.0,
    )
    lockstep_recorder: bool = param(
        False, '-', 'Whether the run starts with a recorder, and in lock-step waits for it'
    )
    answer_timeout: float = param(
        1.0,
        's',
        'Wall time after which a silent node of a lock-step run is lost',
        low=0.05,
        high=60.0,
    )


class SimulatedMachine(Component):
    """Run duties on the simulated mill and apply the compensation that arrives."""

    NAME = 'simulated_machine'
    SUMMARY = 'The simulated mill: temperatures, displacement, state; applies compensation.'
    CONFIG = SimulatedMachineConfig
    INPUTS = (Input('compensation', Compensation),)
    OUTPUTS = (
        Output('machine_state', MachineState),
        Output('compensation_applied', CompensationApplied),
        Output('displacement', Displacement),
        Output('sensor_readings', Temperatures),
    )
    _config: SimulatedMachineConfig

    def __init__(self, config: SimulatedMachineConfig | None = None) -> None:
        super().__init__(config)
        unknown = [name for name in self._config.duties if name not in DUTIES]
        if unknown or not self._config.duties:
            raise ValueError(
                f'duties: expected names among {", ".join(DUTIES)} but found '
                f'{", ".join(unknown) or "none"}'
            )
        self._faults = tuple(parse_sensor_fault(text) for text in self._config.sensor_faults)
        self._offsets = OffsetInput(
            MILL_AXES,
            OffsetInputConfig(offset_max=self._config.offset_max, slew_max=self._config.slew_max),
        )
        self._run = 0
        self._ticks = 0
        self._enter(0)

    @property
    def next_tick(self) -> int | None:
        """Machine time of the next tick [ns]; None when all duties are done."""
        if self._run >= len(self._config.duties):
            return None
        return self._start + (self._ticks + 1) * nanoseconds(self._config.tick_period)

    @property
    def total_ticks(self) -> int:
        """Number of ticks of the whole programme."""
        period = nanoseconds(self._config.tick_period)
        return sum(nanoseconds(self._length(name)) // period for name in self._config.duties)

    def on_compensation(self, command: Compensation) -> None:
        """Take an offset command; the offset input decides whether it is followed."""
        self._offsets.command(
            command.epoch,
            command.axis,
            command.offset,
            command.slope,
            command.reference_position,
            stamp=command.stamp,
            valid_until=command.valid_until,
        )

    def tick(self) -> Iterator[Emission]:
        """Move on to the next tick and report everything that is measured there.

        Raises
        ------
        RuntimeError
            If all duties are done.
        """
        stamp = self.next_tick
        if stamp is None:
            raise RuntimeError('all duties are done; there is no next tick')
        period = self._config.tick_period
        elapsed = self._ticks * period
        speed = self._duty.spindle_speed(elapsed)
        self._mill.advance(period, speed)
        self._offsets.advance(stamp)
        self._ticks += 1
        machine = self.frame('machine')
        yield Emission(
            'machine_state',
            MachineState(
                stamp=stamp,
                frame_id=machine,
                state=int(MachineMode.RUNNING if speed else MachineMode.ON),
                homed=True,
                offsets_allowed=True,
                cold_since=self._start,
                spindle_speed=speed,
                axis=MILL_AXES,
                position=np.zeros(len(MILL_AXES)),
            ),
        )
        yield Emission('compensation_applied', self._applied(stamp))
        interval = nanoseconds(self._config.displacement_interval)
        if (stamp - self._start) % interval < nanoseconds(period):
            yield Emission(
                'displacement',
                Displacement(
                    stamp=stamp,
                    frame_id=self.frame('workpiece'),
                    axis=MILL_AXES,
                    channel=MILL_AXES,
                    displacement=self._mill.measure_displacement(),
                    standard_deviation=np.full(len(MILL_AXES), DISPLACEMENT_NOISE),
                    includes_compensation=False,
                ),
            )
        reading = self._mill.read()
        yield Emission(
            'sensor_readings',
            Temperatures(
                stamp=stamp,
                frame_id=machine,
                sensor=MILL_SENSORS,
                temperature=reading,
                status=np.where(np.isfinite(reading), 0, 1).astype(np.uint8),
                readings=1,
            ),
        )
        following = (self._ticks + 1) * nanoseconds(period)
        if following > nanoseconds(self._length(self._duty.name)):
            self._enter(self._run + 1)

    def health(self) -> list[Health]:
        """Report the duty, the offsets in force and why a command was refused."""
        values = {
            f'offset {axis} [um]': f'{1e6 * offset:.2f}'
            for axis, offset in zip(MILL_AXES, self._offsets.applied, strict=True)
        }
        level = Level.WARN if self._offsets.reason else Level.OK
        text = self._offsets.reason or self._offsets.status.name.lower()
        done = self._run >= len(self._config.duties)
        duty = 'all duties done' if done else f'duty {self._duty.name}'
        return [Health('duty', Level.OK, duty), Health('compensation', level, text, values)]

    def _length(self, duty: str) -> float:
        """Return for how long a duty is run [s]; at least one tick."""
        whole = DUTIES[duty].duration
        wanted = min(whole, self._config.duty_duration or whole)
        return max(wanted, self._config.tick_period)

    def _enter(self, run: int) -> None:
        """Set the machine up, cold, for one duty of the programme."""
        self._run = run
        self._ticks = 0
        if run >= len(self._config.duties):
            return
        self._start = nanoseconds(DAY_START + run * DAY)
        self._duty: Duty = DUTIES[self._config.duties[run]]
        self._mill: ThermalMill = self._duty.mill(
            seed=self._config.seed + 1000 * run, faults=self._faults
        )

    def _applied(self, stamp: int) -> CompensationApplied:
        return CompensationApplied(
            stamp=stamp,
            frame_id=self.frame('machine'),
            epoch=self._offsets.epoch,
            status=int(self._offsets.status),
            reason=self._offsets.reason,
            axis=MILL_AXES,
            offset=self._offsets.applied,
            at_limit=self._offsets.at_limit,
        )
