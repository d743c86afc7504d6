# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The values of a report of a machine, one by one, with the reason where there is none."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

PARTS = (
    ('temperatures', 'temperature', 'degC'),
    ('offsets', 'offset', 'um'),
    ('errors', 'error', 'um'),
)
"""Parts of a report with values by name: their names, what a value is, its unit."""
SPINDLE = 'spindle_speed'
NO_VALUE, TOO_OLD = 'no value', 'too old'


@dataclass(frozen=True)
class ReportedValue:
    """One value.

    Attributes
    ----------
    kind : str
        `temperature`, `offset`, `error` or `spindle_speed`.
    name : str
        Of the sensor, axis or channel; empty for the spindle.
    unit : str
        `degC`, `um` or `rpm`.
    value : float, optional
        The value; None where it is not to be believed.
    trouble : str
        Why there is none: `NO_VALUE`, `TOO_OLD`, or the status in words.
    """

    kind: str
    name: str
    unit: str
    value: float | None
    trouble: str


def told(document: Mapping[str, Any], age_max: float) -> Iterator[ReportedValue]:
    """Yield the values of a report.

    Parameters
    ----------
    document : mapping
        What `MachineReport.document` returns.
    age_max : float
        Age [s] beyond which a value is none.
    """
    for part, kind, unit in PARTS:
        found = document[part]
        if found is None:
            continue
        for name, value in found[f'{kind}_{unit}'].items():
            status = found['status'][name] if kind == 'temperature' else 'ok'
            if not found.get('valid', True):
                status = 'not valid'
            yield _told(kind, name, unit, value, status, found['age_s'] > age_max)
    spindle = document['spindle']
    if spindle is not None:
        old = spindle['age_s'] > age_max
        yield _told(SPINDLE, '', 'rpm', spindle['speed_rpm'], spindle['status'], old)


def _told(
    kind: str, name: str, unit: str, value: float | None, status: str, old: bool
) -> ReportedValue:
    trouble = TOO_OLD if old else '' if status == 'ok' else status
    if value is None and not trouble:
        trouble = NO_VALUE
    return ReportedValue(kind, name, unit, None if trouble else value, trouble)
