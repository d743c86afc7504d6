# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A thermal test as tables and as a document."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan, pi
from typing import Any, NamedTuple

import numpy as np

from fuzzycnc_ros.bags.errors import RunError
from fuzzycnc_ros.studies.page.document import to_document
from fuzzycnc_ros.studies.page.recorded import recorded_date
from fuzzycnc_ros.studies.page.table import Column, Table, case_table
from fuzzycnc_ros.studies.thermal_test.evaluation import (
    COMBINED,
    Drift,
    Floats,
    JudgedPhase,
    MeasuredValue,
    combined_probes,
    judge_phase,
)
from fuzzycnc_ros.studies.thermal_test.phases import PhaseList
from fuzzycnc_ros.studies.thermal_test.recording import TestRecording, TimeSeries
from fuzzycnc_ros.studies.thermal_test.set_up import (
    TILTS,
    TestSetUp,
    check_distances,
    probe_channels,
)
from fuzzycnc_ros.studies.thermal_test.uncertainty import COVERAGE, Budget, find_budget

NOT_STATED = 'not stated'
"""Text in place of a missing statement."""

STATED, BAG = 'stated', 'bag'

_ONE_SPEED = 0.02
"""Share of the usual spindle speed within which a speed is one [-]."""

_AIR = re.compile(r'(^|[^a-z])(ambient|room|air|hall|shop)([^a-z]|$)')
"""Names of sensors that read the air."""


@dataclass(frozen=True, eq=False)
class ThermalTest:
    """A thermal test, judged.

    Parameters
    ----------
    recording : TestRecording
        What was recorded.
    set_up : TestSetUp
        What is stated.
    probes : mapping of str to int
        Column of each probe.
    phases : tuple of JudgedPhase
        What was judged.
    source : str
        What told of the phases.
    ambient : str
        Sensor that reads the air; empty if none does.
    budget : Budget
        Uncertainty of the ranges.
    """

    recording: TestRecording
    set_up: TestSetUp
    probes: Mapping[str, int]
    phases: tuple[JudgedPhase, ...]
    source: str
    ambient: str
    budget: Budget

    @property
    def compensated(self) -> bool:
        """True if anything is known with compensation."""
        return any(item.compensated for item in self.phases)


class Fact(NamedTuple):
    """A line of the head of a report."""

    name: str
    value: str
    source: str


def judge_test(recording: TestRecording, set_up: TestSetUp, phases: PhaseList) -> ThermalTest:
    """Judge a thermal test.

    Parameters
    ----------
    recording : TestRecording
        The test.
    set_up : TestSetUp
        What is stated.
    phases : PhaseList
        Its phases.

    Raises
    ------
    RunError
        If the set-up names a channel, a pair of probes or a sensor that there is not.
    """
    probes = probe_channels(set_up, recording)
    check_distances(set_up, probes)
    judged = tuple(judge_phase(recording, item, probes, set_up) for item in phases.phases)
    return ThermalTest(
        recording=recording,
        set_up=set_up,
        probes=probes,
        phases=judged,
        source=phases.source,
        ambient=_air_sensor(recording.temperatures, set_up.ambient),
        budget=find_budget(recording, probes, set_up, judged),
    )


def _air_sensor(temperatures: TimeSeries | None, wanted: str) -> str:
    """Return the sensor that reads the air: the one that is named, or the one that says so."""
    names = () if temperatures is None else temperatures.names
    if wanted and wanted not in names:
        raise RunError(
            f'ambient: expected a sensor of {", ".join(names) or "the bag, which has none"} but '
            f'found {wanted!r}'
        )
    by_name = [name for name in names if _AIR.search(name.casefold())]
    return wanted or (by_name[0] if len(by_name) == 1 else '')


def facts(test: ThermalTest) -> list[Fact]:
    """Return what is known of a test, and who says so."""
    set_up, recording = test.set_up, test.recording
    stated = [
        ('Instrument', set_up.instrument),
        (
            'Uncertainty of the instrument',
            f'U = {_length(set_up.uncertainty)}, k = {COVERAGE:g}'
            if isfinite(set_up.uncertainty)
            else '',
        ),
        ('History before the test', set_up.history),
    ]
    by = list(dict.fromkeys(mark.by for mark in recording.marks if mark.by))
    return [
        _either('Machine', set_up.machine, recording.machine),
        _either('Date', set_up.date, recorded_date(recording.start, recording.zone)),
        _either('Operator', set_up.operator, f'marks by {", ".join(by)}' if by else ''),
        *(_either(name, text, '') for name, text in stated),
        *(_probe_fact(test, name, column) for name, column in test.probes.items()),
        *(_distance_fact(test, axis) for axis in sorted(axis for axis, _ in TILTS.values())),
        Fact('Compensation', compensation_text(recording), BAG),
        Fact(*_ambient_text(test)),
        Fact('Bag', recording.name, BAG),
    ]


def _either(name: str, stated: str, found: str) -> Fact:
    """Return what is stated, else what the bag says."""
    if stated:
        return Fact(name, stated, STATED)
    return Fact(name, found, BAG) if found else Fact(name, NOT_STATED, '')


def _probe_fact(test: ThermalTest, name: str, column: int) -> Fact:
    channel = test.recording.channel[column]
    place = test.set_up.places.get(name, '')
    source = STATED if name in test.set_up.probes else f'{BAG}: order of the channels of its axis'
    return Fact(
        f'Probe {name}',
        f'channel {channel} along {test.recording.axis[column]}; position {place or NOT_STATED}',
        source,
    )


def _distance_fact(test: ThermalTest, axis: str) -> Fact:
    name = f'Distance {axis}1 to {axis}2'
    if axis not in test.set_up.distance:
        return Fact(name, NOT_STATED, '')
    distance = test.set_up.distance[axis]
    side = '+Z' if distance > 0.0 else '-Z'
    return Fact(name, f'{1e3 * abs(distance):.6g} mm; {axis}1 is farther in {side}', STATED)


def compensation_text(recording: TestRecording) -> str:
    """Return whether offsets were in force, by the read-back and by the displacements."""
    share = float(recording.includes.mean())
    measured = (
        'no displacement includes it'
        if share == 0.0
        else 'all displacements include it'
        if share == 1.0
        else f'{100.0 * share:.0f} % of the displacements include it'
    )
    if recording.offset is None or not np.isfinite(recording.offset).any():
        return f'offsets not in the bag; {measured}'
    known = recording.offset[np.isfinite(recording.offset).any(axis=1)]
    on = float((np.nan_to_num(known) != 0.0).any(axis=1).mean())
    largest = float(np.nanmax(np.abs(known)))
    if on == 0.0:
        return f'off: all offsets are zero; {measured}'
    return f'on in {100.0 * on:.0f} % of the time, at most {_length(largest)}; {measured}'


def _ambient_text(test: ThermalTest) -> Fact:
    name = 'Ambient temperature'
    course = test.recording.temperatures
    if course is None or not test.ambient:
        return Fact(name, NOT_STATED, '')
    values = course.values[:, course.names.index(test.ambient)]
    known = values[np.isfinite(values)]
    if not known.size:
        return Fact(name, f'{test.ambient} has no good reading', BAG)
    return Fact(
        name,
        f'{test.ambient}: {known[0]:.1f} °C at the start, {known.min():.1f} to '
        f'{known.max():.1f} °C',
        BAG,
    )


def facts_table(test: ThermalTest) -> Table:
    """Return the head of a report."""
    columns = tuple(Column(name, numeric=False) for name in ('Item', 'Value', 'Source'))
    return Table('Test conditions', columns, tuple(facts(test)))


def phases_table(test: ThermalTest) -> Table:
    """Return the phases of a test."""
    return case_table(
        f'Phases, {test.source}; time from the first displacement',
        enumerate(test.phases, start=1),
        {
            Column('No.'): lambda number, item: str(number),
            Column('Phase', numeric=False): lambda number, item: item.phase.name,
            Column('Kind', numeric=False): lambda number, item: item.phase.kind,
            Column('From [h]'): lambda number, item: f'{item.phase.start / 3600.0:.2f}',
            Column('To [h]'): lambda number, item: f'{item.phase.end / 3600.0:.2f}',
            Column('Spindle [rpm]'): lambda number, item: _speed_cell(test, item),
            Column('Ambient [°C]'): lambda number, item: _ambient_cell(test, item),
        },
    )


def _speed_cell(test: ThermalTest, item: JudgedPhase) -> str:
    """Return the speed of a phase, or from where to where it goes in nine tenths of it [rpm].

    The median of a spindle that turns half of the time may be a speed that it never had.
    """
    speed, phase = test.recording.speed, item.phase
    if speed is None:
        return 'not known'
    time = test.recording.time
    inside = speed[(time >= phase.start) & (time < phase.end) & np.isfinite(speed)]
    if not inside.size:
        return 'not known'
    share = np.quantile(inside, (0.05, 0.5, 0.95), method='nearest')
    low, usual, high = (60.0 * share / (2.0 * pi)).tolist()
    steady = high - low <= _ONE_SPEED * abs(usual)
    return f'{usual:.0f}' if steady else f'{low:.0f} to {high:.0f}'


def _ambient_cell(test: ThermalTest, item: JudgedPhase) -> str:
    """Return from where to where the air went in a phase [degC]."""
    course, phase = test.recording.temperatures, item.phase
    if course is None or not test.ambient:
        return NOT_STATED
    values = course.values[:, course.names.index(test.ambient)]
    inside = (course.time >= phase.start) & (course.time < phase.end) & np.isfinite(values)
    if not inside.any():
        return 'not known'
    return f'{values[inside].min():.1f} to {values[inside].max():.1f}'


def phase_table(test: ThermalTest, number: int) -> Table:
    """Return what all probes, tilts and the combined drift did in a phase, counted from 1."""
    item = test.phases[number - 1]
    sides = [(f'without, {_how(item, bare=True)}', item.bare)]
    if test.compensated:
        sides.append((f'with, {_how(item, bare=False)}', item.compensated))
    columns = [Column('Quantity', numeric=False)]
    for group, _ in sides:
        columns += [
            Column('first hour', group),
            Column('whole phase', group),
            Column('change', group),
            Column('to 90 % [min]', group),
        ]
    rows = []
    for name in (*test.probes, *_wanted_tilts(test), COMBINED):
        row = [_label(test, name)]
        for _, drifts in sides:
            row += _cells(name, drifts.get(name))
        rows.append(tuple(row))
    title = (
        f'{number} {item.phase.name}: {item.phase.kind}, {item.phase.duration / 3600.0:.2f} h; '
        f'ranges and change without{" and with" if test.compensated else ""} compensation'
    )
    return Table(title, tuple(columns), tuple(rows))


def axis_targets(recording: TestRecording) -> dict[str, list[int]]:
    """Return the columns of each axis that was measured at several places, low end first."""
    found: dict[str, list[int]] = {}
    for column in np.argsort(recording.position, kind='stable').tolist():
        if isfinite(recording.position[column]):
            found.setdefault(recording.axis[column], []).append(column)
    return {axis: columns for axis, columns in sorted(found.items()) if len(columns) > 1}


def axes_table(test: ThermalTest) -> Table | None:
    """Return how the error along linear axes changed in each phase; None if nobody measured it.

    In the style of the test of linear axes in ISO 230-3: targets near both ends of the travel, and
    between them, before and after the axis was moved.
    """
    recording, rows = test.recording, []
    for axis, columns in axis_targets(recording).items():
        place = recording.position[columns]
        for item in test.phases:
            inside = (recording.time >= item.phase.start) & (recording.time <= item.phase.end)
            sides = [('without', recording.bare)]
            if item.compensated:
                sides.append(('with', recording.compensated))
            for side, values in sides:
                change = np.array([_change(values[inside, column]) for column in columns])
                known = np.isfinite(change)
                if known.sum() < 2:
                    continue
                slope, offset = np.polyfit(place[known], change[known], 1)
                rest = np.abs(change - offset - slope * place)[known].max()
                at = '; '.join(
                    f'{1e6 * value:+.1f} at {1e3 * where:g} mm' if isfinite(value) else 'not known'
                    for value, where in zip(change, place, strict=True)
                )
                line = f'{1e6 * rest:.1f}' if known.sum() > 2 else NOT_STATED
                rows.append((item.phase.name, axis, side, at, f'{1e6 * slope:+.1f}', line))
    if not rows:
        return None
    columns_ = (
        *(Column(name, numeric=False) for name in ('Phase', 'Axis', 'Compensation')),
        Column('Change from the beginning to the end of the phase [µm]', numeric=False),
        Column('Slope [µm/m]'),
        Column('Line leaves [µm]'),
    )
    return Table('Linear axes', columns_, tuple(rows))


def _change(values: Floats) -> float:
    """Return the last less the first of the values that are known."""
    known = values[np.isfinite(values)]
    return float(known[-1] - known[0]) if len(known) > 1 else nan


def _how(item: JudgedPhase, *, bare: bool) -> str:
    """Return whether a side of a phase was measured or computed."""
    if item.includes == 'some':
        return 'partly computed'
    return 'measured' if bare == (item.includes == 'none') else 'computed'


def how_remark(test: ThermalTest) -> str:
    """Return how both sides follow from what was measured."""
    if not test.compensated:
        return (
            'The bag holds no applied offsets (compensation_applied): nothing is said of the '
            'machine with compensation.'
        )
    return (
        'A displacement is the actual minus the nominal position of the tool relative to the '
        'workpiece. With compensation = without it + the offset in force (compensation_applied), '
        'axis by axis; the headings say which of both was measured and which is computed so.'
    )


def _wanted_tilts(test: ThermalTest) -> list[str]:
    """Return the tilts that two probes would show."""
    return [
        tilt for tilt, (axis, _) in TILTS.items() if {f'{axis}1', f'{axis}2'} <= test.probes.keys()
    ]


def _label(test: ThermalTest, name: str) -> str:
    if name in TILTS:
        return f'{name} [µm/m]'
    if name == COMBINED:
        return f'{name} {", ".join(combined_probes(test.probes))} [µm]'
    channel = test.recording.channel[test.probes[name]]
    return f'{name} [µm]' if channel == name else f'{name} ({channel}) [µm]'


def _cells(name: str, drift: Drift | None) -> list[str]:
    if drift is None:  # a tilt without a distance, or a side that the bag does not know
        return [NOT_STATED if name in TILTS else 'not known'] * 2 + [''] * 2
    return [
        *(_micro(value) for value in (drift.first_hour, drift.whole, drift.change)),
        drift.rise_time.why or _minutes(drift.rise_time.value),
    ]


def _micro(found: MeasuredValue) -> str:
    if found.why:
        return found.why
    return f'{1e6 * found.value:.2f}' if isfinite(found.value) else ''


def _minutes(duration: float) -> str:
    return f'{duration / 60.0:.1f}' if isfinite(duration) else ''


def _length(length: float) -> str:
    return f'{1e6 * length:.3g} µm'


def budget_table(test: ThermalTest) -> Table:
    """Return the uncertainty of a range, term by term."""
    budget, probes = test.budget, test.probes
    columns = (
        Column('Term', numeric=False),
        Column('Source', numeric=False),
        Column('Standard uncertainty', numeric=False),
        *(Column(name) for name in probes),
    )
    rows = [
        (
            term.name,
            term.source or NOT_STATED,
            term.rule,
            *(_budget_cell(term.uncertainty[name]) for name in probes),
        )
        for term in budget.terms
    ]
    rows.append(
        (
            'Combined',
            'terms above that have a number',
            'root of the sum of squares',
            *(_budget_cell(budget.combined(name)) for name in probes),
        )
    )
    rows.append(
        (
            f'Expanded, k = {COVERAGE:g}{", at least" if _incomplete(test) else ""}',
            '',
            f'combined times {COVERAGE:g}',
            *(_budget_cell(budget.expanded(name)) for name in probes),
        )
    )
    return Table(
        'Uncertainty of a range [µm]',
        columns,
        tuple(rows),
        highlight=frozenset({len(rows) - 1}),
        highlight_means='expanded uncertainty',
    )


def _incomplete(test: ThermalTest) -> list[str]:
    """Return the terms that some probe has no number for."""
    missing = (name for probe in test.probes for name in test.budget.missing(probe))
    return list(dict.fromkeys(missing))


def _budget_cell(size: float) -> str:
    return f'{1e6 * size:.3f}' if isfinite(size) else NOT_STATED


def budget_remarks(test: ThermalTest) -> list[str]:
    """Return what the budget leaves out, and what it means for tilts."""
    found = ['Combined and expanded as the GUM has it; a range is the difference of two readings.']
    missing = list(
        dict.fromkeys(name for probe in test.probes for name in test.budget.missing(probe))
    )
    if missing:
        found.append(
            f'Incomplete: {", ".join(missing)} without a number. The true uncertainty is larger.'
        )
    for tilt in _wanted_tilts(test):
        axis, _ = TILTS[tilt]
        if axis in test.set_up.distance:
            one, two = (test.budget.expanded(f'{axis}{number}') for number in (1, 2))
            size = float(np.hypot(one, two)) / abs(test.set_up.distance[axis])
            if isfinite(size):
                found.append(
                    f'Tilt {tilt}: U = {1e6 * size:.2f} µm/m, k = {COVERAGE:g}, by both probes '
                    'as if independent; the distance counts as exact.'
                )
    return found


def figures_document(test: ThermalTest) -> dict[str, Any]:
    """Return the figures of a test.

    Returns
    -------
    dict
        Lengths in um, tilts in um/m, times in s; None where there is no number, with the reason
        under `why`.
    """
    return {
        'facts': {fact.name: fact.value for fact in facts(test)},
        'phases_source': test.source,
        'phases': [
            {
                'name': item.phase.name,
                'kind': item.phase.kind,
                'start_s': item.phase.start,
                'end_s': item.phase.end,
                'includes_compensation': item.includes,
                'without': {name: _figures(drift) for name, drift in item.bare.items()},
                'with': {name: _figures(drift) for name, drift in item.compensated.items()},
            }
            for item in test.phases
        ],
        'uncertainty': {
            'terms': [
                {
                    'name': term.name,
                    'source': term.source,
                    'standard_um': to_document(
                        {name: 1e6 * size for name, size in term.uncertainty.items()}
                    ),
                }
                for term in test.budget.terms
            ],
            'expanded_um': to_document(
                {name: 1e6 * test.budget.expanded(name) for name in test.probes}
            ),
            'coverage': COVERAGE,
        },
    }


def _figures(drift: Drift) -> dict[str, Any]:
    found = {
        'first_hour': 1e6 * drift.first_hour.value,
        'whole': 1e6 * drift.whole.value,
        'change': 1e6 * drift.change.value,
        'rise_time_s': drift.rise_time.value,
    }
    parts = {
        'first_hour': drift.first_hour,
        'whole': drift.whole,
        'change': drift.change,
        'rise_time_s': drift.rise_time,
    }
    return {
        **to_document(found),
        'why': {name: part.why for name, part in parts.items() if part.why},
    }
