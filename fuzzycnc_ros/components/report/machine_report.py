# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The state of one machine as a document for programs that know nothing of ROS.

It is pure: records, health and the time of the one who watches go in, a document for JSON comes
out.  Lengths are in micrometres and speeds in rpm, as people read them; what is not known is None.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from fuzzycnc_ros.components.dashboard.node_report import NODE_SILENT
from fuzzycnc_ros.components.dashboard.values import word
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.enums import SpeedStatus, Status
from fuzzycnc_ros.runtime.records import (
    SECOND,
    CompensationApplied,
    Record,
    SpindleSpeed,
    Temperatures,
    ThermalError,
)

SOURCES: Mapping[str, type[Record]] = {
    'temperatures': Temperatures,
    'thermal_error': ThermalError,
    'compensation_applied': CompensationApplied,
    'spindle_speed': SpindleSpeed,
}
"""Topics that a report is made of, and their records."""
MICROMETRES = 1e6
RPM = 60.0 / (2.0 * math.pi)


class MachineReport:
    """Put together what the nodes of one machine say.

    Parameters
    ----------
    machine : str
        Its name.
    """

    def __init__(self, machine: str) -> None:
        self._machine = machine
        self._newest: dict[str, tuple[Any, float]] = {}
        self._health: dict[str, tuple[tuple[Health, ...], float]] = {}
        self._sequence = 0

    def take(self, topic: str, record: Record, now: float) -> None:
        """Take a record of one of `SOURCES` that came at `now` [s]."""
        self._newest[topic] = record, now

    def take_health(self, node: str, items: Iterable[Health], now: float) -> None:
        """Take what a node reported of itself at `now` [s]."""
        self._health[node] = tuple(items), now

    def document(self, time: str, now: float) -> dict[str, Any]:
        """Return the report.

        Parameters
        ----------
        time : str
            Time of day, for readers.
        now : float
            Time [s] on the clock of `take`.
        """
        self._sequence += 1
        return {
            'machine': self._machine,
            'sequence': self._sequence,
            'time': time,
            'offsets': self._part('compensation_applied', now, _offsets),
            'errors': self._part('thermal_error', now, _errors),
            'temperatures': self._part('temperatures', now, _temperatures),
            'spindle': self._part('spindle_speed', now, _spindle),
            'alarms': self._alarms(now),
        }

    def _part(
        self, topic: str, now: float, tell: Callable[[Any], dict[str, Any]]
    ) -> dict[str, Any] | None:
        """Return what a record says, with its stamp and how long ago it came."""
        if topic not in self._newest:
            return None
        record, came = self._newest[topic]
        age = round(max(0.0, now - came), 3)
        return {'stamp_s': record.stamp / SECOND, 'age_s': age, **tell(record)}

    def _alarms(self, now: float) -> list[dict[str, str]]:
        found = []
        for node, (items, came) in sorted(self._health.items()):
            if now - came > NODE_SILENT:
                text = f'does not report for {now - came:.0f} s; look whether it still runs'
                items = (Health('report', Level.ERROR, text),)
            found += [
                {
                    'level': 'warning' if item.level is Level.WARN else 'error',
                    'node': visible(node),
                    'name': visible(item.name),
                    'text': visible(item.message),
                }
                for item in items
                if item.level > Level.OK
            ]
        return sorted(found, key=lambda alarm: alarm['level'])


def _known(value: float, factor: float = 1.0, digits: int = 4) -> float | None:
    return round(factor * float(value), digits) if math.isfinite(value) else None


def _values(names: Iterable[str], values: Any, factor: float = 1.0) -> dict[str, float | None]:
    """Return values by name."""
    pairs = zip(names, values, strict=False)
    return {visible(name): _known(value, factor) for name, value in pairs}


def _offsets(record: CompensationApplied) -> dict[str, Any]:
    return {
        'offset_um': _values(record.axis, record.offset, MICROMETRES),
        'status': word(OffsetStatus, record.status, 'status'),
    }


def _errors(record: ThermalError) -> dict[str, Any]:
    return {
        'error_um': _values(record.channel, record.error, MICROMETRES),
        'standard_deviation_um': _values(record.channel, record.standard_deviation, MICROMETRES),
        'valid': bool(record.valid),
        'in_domain': bool(record.in_domain),
    }


def _temperatures(record: Temperatures) -> dict[str, Any]:
    pairs = zip(record.sensor, record.status, strict=False)
    return {
        'temperature_degC': _values(record.sensor, record.temperature),
        'status': {visible(name): word(Status, code, 'status') for name, code in pairs},
    }


def _spindle(record: SpindleSpeed) -> dict[str, Any]:
    return {
        'speed_rpm': _known(record.speed, RPM, 2),
        'status': word(SpeedStatus, record.status, 'status'),
    }
