# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a thermal test."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Rule, Series, Span
from fuzzycnc_ros.studies.page.drawing import (
    AFTER,
    ANOTHER,
    BEFORE,
    CLUSTER_COLOURS,
    FAINT,
    INK,
    MEASURED,
    MUTED,
    OTHER,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Remark, Section
from fuzzycnc_ros.studies.thermal_test.evaluation import quantities
from fuzzycnc_ros.studies.thermal_test.report import (
    ThermalTest,
    axes_table,
    budget_remarks,
    budget_table,
    facts,
    facts_table,
    how_remark,
    phase_table,
    phases_table,
)
from fuzzycnc_ros.studies.thermal_test.set_up import TILTS

Floats = NDArray[np.float64]

STYLE_OF = 'ISO 230-3 and ISO 10791-10'

NO_CONFORMITY = (
    f'This report is in the style of {STYLE_OF}. It is no statement of conformity with them: '
    'nothing here checks whether instrument, positions, conditions and procedure are those '
    'that the standards ask for.'
)

COLOURS = {
    'environment': ANOTHER,
    'spindle': BEFORE,
    'axis': OTHER,
    'cooling': AFTER,
    'other': FAINT,
}
"""Colour of a phase by its kind."""

NAMED_MAX = 5
"""Most phases whose names fit into a figure; of more, their numbers stand there."""

SENSORS_MAX = 16
"""Most sensors that a legend names."""


def thermal_test_page(test: ThermalTest) -> Page:
    """Return the page of a thermal test."""
    hours = float(test.recording.time[-1]) / 3600.0
    count = len(test.phases)
    along = axes_table(test)
    return Page(
        title=f'Thermal test in the style of {STYLE_OF}',
        summary=f'{count} phase{"s" if count > 1 else ""} in {hours:.1f} h, probes '
        f'{", ".join(test.probes)}. No statement of conformity.',
        sections=[
            Section(
                'Test',
                judged=[Remark(NO_CONFORMITY), Remark(how_remark(test))],
                tables=[facts_table(test)],
            ),
            Section('Phases', tables=[phases_table(test)], figures=[*_figures(test)]),
            *(
                Section(f'Phase {number}: {item.phase.name}', tables=[phase_table(test, number)])
                for number, item in enumerate(test.phases, start=1)
            ),
            *([] if along is None else [Section('Linear axes', tables=[along])]),
            Section('Uncertainty', tables=[budget_table(test)], remarks=budget_remarks(test)),
        ],
        facts={
            fact.name.replace('Date', 'Recorded'): fact.value
            for fact in facts(test)
            if fact.name in ('Date', 'Machine', 'Bag')
        },
        notes=_notes(test),
    )


def _notes(test: ThermalTest) -> list[str]:
    found = [
        'Range: largest less smallest sample, noise included. Change: last less first sample of '
        'the phase. To 90 %: time from the beginning of the phase until a sample first reaches '
        '90 % of the change, between samples by a straight line. Combined: largest distance of '
        'the tool from where it was at the first sample of the phase.',
        'Tilts are rotations about X (A) and Y (B), positive by the right-hand rule, from the '
        'difference of two probes over their distance along Z. 1 µm/m is 1 µrad, or 0.206 arc '
        'seconds.',
        'Too short: the phase does not last so long. Gap: samples are missing for more than 5 % '
        'of the stretch, so that its range is not known. No change: the change is within six '
        'standard deviations of the noise, or within the resolution.',
    ]
    without = [
        f'Tilt {tilt} needs the distance from {axis}1 to {axis}2 along Z: --distance {axis}=100mm.'
        for tilt, (axis, _) in TILTS.items()
        if {f'{axis}1', f'{axis}2'} <= test.probes.keys() and axis not in test.set_up.distance
    ]
    return found + without


def _figures(test: ThermalTest) -> Iterator[Figure]:
    yield Figure(
        'Displacements over time',
        'Shaded are the phases: environment green, spindle orange, axis purple, cooling blue, '
        'other grey.',
        displacement_chart(test),
    )
    if test.recording.temperatures is not None:
        yield Figure(
            'Temperatures over time',
            f'Thick: {test.ambient}, the air.'
            if test.ambient
            else 'No sensor is named as that of the air.',
            temperature_chart(test),
        )
    if test.recording.speed is not None:
        yield Figure(
            'Spindle speed over time',
            'As the machine reported it.',
            speed_chart(test),
        )


def displacement_chart(test: ThermalTest) -> Chart:
    """Declare the displacements of all probes, and the tilts, without and with compensation."""
    recording = test.recording
    x = recording.time / 3600.0
    sides = [('without compensation', recording.bare)]
    if test.compensated:
        sides.append(('with compensation', recording.compensated))
    panels = []
    for name, values in sides:
        courses = quantities(values, test.probes, test.set_up.distance)
        series = [
            Series(probe, 1e6 * courses[probe], colour)
            for probe, colour in zip(test.probes, CLUSTER_COLOURS, strict=False)
        ]
        panels.append(_panel(test, x, Axis('displacement', 'µm'), series, f'Probes {name}'))
    # Offsets shift both probes of an axis alike: tilts are what they are.
    courses = quantities(recording.measured, test.probes, test.set_up.distance)
    tilts = [
        Series(f'tilt {tilt}', 1e6 * courses[tilt], colour)
        for tilt, colour in zip(TILTS, (INK, OTHER), strict=True)
        if tilt in courses
    ]
    if tilts:
        panels.append(_panel(test, x, Axis('tilt', 'µm/m'), tilts, 'Tilts'))
    return Chart(Axis('time', 'h'), panels, height=2.6)


def temperature_chart(test: ThermalTest) -> Chart:
    """Declare the temperatures.

    Raises
    ------
    ValueError
        If the test has none.
    """
    course = test.recording.temperatures
    if course is None:
        raise ValueError(f'{test.recording.name}: expected temperatures but found none')
    many = len(course.names) > SENSORS_MAX
    series = [
        Series(
            name,
            course.values[:, column],
            MEASURED if name == test.ambient else CLUSTER_COLOURS[column % len(CLUSTER_COLOURS)],
            width=2.2 if name == test.ambient else 1.2,
            quiet=many and name != test.ambient,
        )
        for column, name in enumerate(course.names)
    ]
    panel = _panel(test, course.time / 3600.0, Axis('temperature', '°C'), series, '')
    return Chart(Axis('time', 'h'), [panel], height=2.6)


def speed_chart(test: ThermalTest) -> Chart:
    """Declare the spindle speed.

    Raises
    ------
    ValueError
        If it is not known.
    """
    recording = test.recording
    if recording.speed is None:
        raise ValueError(f'{recording.name}: expected a spindle speed but found none')
    rpm = 60.0 * recording.speed / (2.0 * np.pi)
    series = [Series('spindle speed', rpm, MEASURED, kind='steps')]
    top = float(rpm[np.isfinite(rpm)].max(initial=0.0))
    axis = Axis('speed', 'rpm', high=1.25 * top if top else None)  # names of phases stand above
    panel = _panel(test, recording.time / 3600.0, axis, series, '')
    return Chart(Axis('time', 'h'), [panel], height=1.8)


def _panel(
    test: ThermalTest,
    x: Floats,
    axis: Axis,
    series: list[Series],
    title: str,
) -> Panel:
    """Return a panel with the phases behind its series."""
    few = len(test.phases) <= NAMED_MAX
    spans = [
        Span(
            max(item.phase.start, 0.0) / 3600.0,
            item.phase.end / 3600.0,
            COLOURS[item.phase.kind],
            f'{number} {item.phase.name}' if few else str(number),
        )
        for number, item in enumerate(test.phases, start=1)
    ]
    rules = [Rule(0.0, MUTED)] if axis.unit.startswith('µm') else []
    return Panel(x, axis, series, title=title, spans=spans, rules=rules)
