# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Drives one component through the merge, with records that are quick to write down."""

from typing import Any

import numpy as np

from fuzzycnc_ros.runtime.component import Component, Emission
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.merge import Merger
from fuzzycnc_ros.runtime.records import (
    CompensationApplied,
    MachineState,
    Record,
    Temperatures,
    ThermalError,
    nanoseconds,
)


class Bench:
    """A component, its merge and what it has emitted."""

    def __init__(self, component: Component) -> None:
        self.component = component
        component.machine = 'mill'
        self.merger = Merger(component)
        self.emitted: list[Emission] = []

    def push(self, name: str, record: Record) -> bool:
        """Hand over a record without working."""
        return self.merger.push(name, record)

    def give(self, name: str, record: Record) -> list[Emission]:
        """Hand over a record and work up to its stamp; return what came of it."""
        self.push(name, record)
        return self.until(record.stamp * 1e-9)

    def until(self, time: float) -> list[Emission]:
        """Work up to machine time [s]; return what came of it."""
        found = self.merger.advance(nanoseconds(time))
        self.emitted += found
        return found

    def request(self, name: str, **arguments: Any) -> Any:
        """Send a request at the present machine time."""
        answer = self.component.on_request(name, arguments, self.merger.time)
        self.emitted += answer.emissions
        return answer

    def clock_step(self, step: float, now: float) -> list[Emission]:
        """Set the clock forward by a step [s], to machine time `now` [s], as a host does."""
        active = getattr(self.component, '_active', False)
        before = self.component
        self.component, emissions = before.renewed(nanoseconds(step))
        self.merger = Merger(self.component, time=nanoseconds(now))
        self.emitted += emissions
        if active and self.component is not before:
            assert self.request('activate').success
        return emissions

    def records(self, output: str) -> list[Any]:
        """Return all records of an output so far."""
        return [item.record for item in self.emitted if item.output == output]

    def health(self) -> str:
        """Return all health lines as one text."""
        return '\n'.join(
            f'{item.level.name} {item.name}: {item.message}' for item in self.component.health()
        )


def machine_state(time: float, **changes: Any) -> MachineState:
    """Return the state of a machine that runs and allows offsets."""
    values: dict[str, Any] = {
        'state': int(MachineMode.RUNNING),
        'homed': True,
        'offsets_allowed': True,
        'cold_since': 0,
        'spindle_speed': 100.0,
        'axis': ('Y', 'Z'),
        'position': np.zeros(2),
    }
    return MachineState(stamp=nanoseconds(time), frame_id='mill/machine', **(values | changes))


def applied(
    time: float, offset: Any = (0.0, 0.0), epoch: int = 0, **changes: Any
) -> CompensationApplied:
    """Return the read-back of offsets [m]."""
    return CompensationApplied(
        stamp=nanoseconds(time),
        frame_id='mill/machine',
        epoch=epoch,
        status=0,
        reason='',
        axis=('Y', 'Z'),
        offset=np.array(offset, dtype=np.float64),
        at_limit=np.zeros(2, bool),
        **changes,
    )


def thermal_error(time: float, error: Any = (0.0, 0.0), **changes: Any) -> ThermalError:
    """Return a valid thermal error [m] of Y and Z."""
    values: dict[str, Any] = {
        'axis': ('Y', 'Z'),
        'channel': ('Y', 'Z'),
        'error': np.array(error, dtype=np.float64),
        'standard_deviation': np.full(2, 1e-6),
        'valid': True,
        'reason': 0,
        'in_domain': True,
        'model': 'test',
        'substituted': (),
        'substitute': (),
    }
    return ThermalError(stamp=nanoseconds(time), frame_id='mill/workpiece', **(values | changes))


def readings(time: float, temperature: Any, sensor: tuple[str, ...] | None = None) -> Temperatures:
    """Return one raw reading of every sensor [degC]."""
    values = np.array(temperature, dtype=np.float64)
    names = sensor or tuple(f'T{number}' for number in range(1, len(values) + 1))
    return Temperatures(
        stamp=nanoseconds(time),
        frame_id='mill/machine',
        sensor=names,
        temperature=values,
        status=np.where(np.isfinite(values), 0, 1).astype(np.uint8),
        readings=1,
    )
