# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A scheduled part program: table, remarks, document, figures and page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.feedrate.gcode.blocks import Note
from fuzzycnc_ros.studies.contour import contouring_page
from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Rule, Series, Shades
from fuzzycnc_ros.studies.page.drawing import AFTER, BEFORE, LIMIT
from fuzzycnc_ros.studies.page.html import Figure, Page, Remark, Section
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.pareto.pareto_page import LABELS, millimetres
from fuzzycnc_ros.studies.programs.program_drive import (
    AFTER_STOP,
    DURATION_MAX,
    EVEN,
    METHODS,
    PROGRAMMED,
    MethodDrive,
)
from fuzzycnc_ros.studies.programs.schedule_trace import PathTrace

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.gcode.blocks import Note
    from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
    from fuzzycnc_ros.core.feedrate.schedule.program_schedule import ProgramTimes
    from fuzzycnc_ros.core.feedrate.schedule.program_settings import ProgramSettings
    from fuzzycnc_ros.studies.programs.program_drive import Drive
    from fuzzycnc_ros.studies.programs.program_judge import ProgramResult
    from fuzzycnc_ros.studies.programs.schedule_trace import PathTrace

MINUTE = 60.0

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ScheduleFigures:
    """Figures of a scheduled part program.

    Parameters
    ----------
    program : str
        Its name.
    method : str
        Name of the method.
    tolerance : float
        Largest contour error wanted [m].
    settings : ProgramSettings
        How it was scheduled.
    times : ProgramTimes
        What it takes.
    notes : sequence of Note
        What was passed through.
    added, changed : int
        Feed words that were added, and that were there and changed.
    driven_before, driven : ProgramResult or None
        The first lines on the simulated controller, as they were and as they are; None where
        they were not driven.
    stretch : str
        Which lines these are.
    corners : sequence of float
        How far corners were rounded off by the program's own words [m].
    """

    program: str
    method: str
    tolerance: float
    settings: ProgramSettings
    times: ProgramTimes
    notes: Sequence[Note]
    added: int
    changed: int
    driven_before: ProgramResult | None = None
    driven: ProgramResult | None = None
    stretch: str = 'the whole program'
    corners: Sequence[float] = ()

    @property
    def corner_text(self) -> str:
        """Corner rounding, and its source."""
        if not self.corners:
            return _corners(self.settings.blend)
        low, high = min(self.corners), max(self.corners)
        text = _corners(high)
        if 0.0 < low < high:
            text = f'rounded by up to {millimetres(low)} to {millimetres(high)} mm'
        return f'{text}, as the program says (G64 P, G61)'

    @property
    def unchanged(self) -> bool:
        """True if the program came out as it went in."""
        return self.added + self.changed == 0

    @property
    def kept(self) -> bool:
        """True if the driven program keeps the tolerance."""
        return self.driven is None or self.driven.error <= self.tolerance

    @property
    def verdict(self) -> str:
        """That the tolerance is not kept, where, and what helps."""
        if self.driven is None or self.kept:
            return ''
        place = 'corners' if self.driven.corner_error >= self.driven.error else 'bends'
        return (
            f'tolerance not kept: {1e3 * self.driven.error:.4f} mm at {place}, line '
            f'{self.driven.line:,}, of {self.stretch} on the simulated controller; feeds '
            'alone are not enough here, see fuzzycnc advise'
        )

    @property
    def fixed(self) -> float:
        """Time that no feed changes: rapids, waits, blocks that keep their feed [s]."""
        return self.times.rapid + self.times.dwell + self.times.kept

    def remarks(self) -> list[str]:
        """Return what a reader of the table has to know, line by line."""
        times, settings = self.times, self.settings
        lines = [
            f'{times.blocks:,} blocks, the feeds of {times.chosen:,} chosen on '
            f'{times.length:,.3f} m; feed words: {self.added:,} added, {self.changed:,} changed',
            f'of both times: rapids {times.rapid:.1f} s, waits {times.dwell:.1f} s, blocks that '
            f'keep their feed {times.kept:.1f} s',
        ]
        if times.curves:
            lines.append(
                f'{times.curves:,} NURBS blocks: each runs with the one feed that its sharpest '
                'bend allows; cut into several blocks it would be faster'
            )
        if times.untimed:
            lines.append(
                f'left out of both times: {times.untimed:,} motions, cycles or calls whose time '
                'the program does not tell; the notes say which'
            )
        if times.stops:
            stopped = settings.blend == 0.0 and not any(self.corners)
            where = 'corners within a run' if stopped else 'what cannot be blended'
            lines.append(
                f'exact stops: {times.stops:,}, at the ends of runs and at {where}; their '
                'error depends on acceleration and rest, not on the feed'
            )
        lines.append(f'limits: {_limits(settings.limits)}')
        blend = max(self.corners, default=settings.blend)
        rounded = f' and what rounding itself leaves, up to {millimetres(blend)} mm'
        lines.append(
            f'bound, without exact stops{rounded if blend else ""}: machine constant times the '
            'largest acceleration across the path that the feed words ask for; driven: on the '
            f'simulated controller with look-ahead, {self.stretch}'
        )
        if self.unchanged:
            lines.append('unchanged: no feed word was added or changed')
        return lines


def _limits(limits: MotionLimits) -> str:
    """Return velocities, accelerations and jerks of the path and the axes."""
    found = []
    for label, row in zip(('path', *'XYZ'), limits.table(3).T, strict=True):
        texts = [speed(row[0])] if isfinite(row[0]) else []
        texts += [
            f'{value:g} {unit}'
            for value, unit in zip(row[1:], ('m/s²', 'm/s³'), strict=True)
            if isfinite(value)
        ]
        found.append(f'{label} {", ".join(texts)}')
    if len({one.split(' ', 1)[1] for one in found[1:]}) == 1:
        found[1:] = ['each axis ' + found[1].split(' ', 1)[1]]
    return '; '.join(found)


def speed(value: float) -> str:
    """Return a feed [m/s] as programs give it."""
    return f'{1e3 * MINUTE * value:,.0f} mm/min'


def schedule_table(figures: ScheduleFigures) -> Table:
    """Return the times with the feeds of the program and with those chosen."""
    times, settings = figures.times, figures.settings
    columns = (
        Column('Feeds', numeric=False),
        Column('time [s]'),
        Column('change'),
        Column('mean feed [mm/min]'),
        Column('bound', 'contour error [mm]'),
        Column('driven', 'contour error [mm]'),
    )
    rows: list[tuple[str, ...]] = []
    now = times.duration, times.error, figures.driven
    before = times.programmed, times.programmed_error, figures.driven_before
    if figures.unchanged:  # a feed that its word rounds is that word's
        now = before
    for name, (duration, error, driven) in (
        ('as programmed', before),
        (LABELS.get(figures.method, figures.method), now),
    ):
        cutting = duration - figures.fixed
        mean = 1e3 * MINUTE * times.length / cutting if cutting > 0.0 else 0.0
        change = duration / times.programmed - 1.0 if times.programmed else 0.0
        rows.append(
            (
                name,
                f'{duration:,.1f}',
                f'{100.0 * change:+.1f} %' if rows else '',
                f'{mean:,.0f}',
                f'{1e3 * error:.4f}',
                '-' if driven is None else f'{1e3 * driven.error:.4f}',
            )
        )
    bound = "the program's feeds"
    if settings.feed is not None:
        bound = speed(settings.feed)
    title = (
        f'{figures.program}: tolerance {millimetres(figures.tolerance)} mm, corners '
        f'{figures.corner_text}, at most {bound}'
    )
    if settings.override != 1.0:
        title += f', override {100.0 * settings.override:g} %'
    if times.untimed:
        title += f'; {times.untimed:,} motions left out of the times'
    warning = frozenset() if figures.kept else frozenset({(1, len(columns) - 1)})
    return Table(
        title, columns, tuple(rows), warning=warning, warning_means='the tolerance is not kept'
    )


def schedule_document(figures: ScheduleFigures) -> dict[str, Any]:
    """Return all figures.

    Returns
    -------
    dict
        `program`, `method`, `settings` (SI; `own_corners` is what G64 P and G61 of the program
        say, where they count), `times` as in `ProgramTimes` (SI), `driven` (SI),
        `driven_stretch`, `tolerance_kept`, `feed_words` and `notes`.
    """
    settings = figures.settings
    return {
        'program': figures.program,
        'method': figures.method,
        'settings': {
            'tolerance': figures.tolerance,
            'blend': settings.blend,
            'own_corners': sorted(figures.corners),
            'feed': settings.feed,
            'override': settings.override,
            'feed_step': settings.feed_step,
            'settle': settings.settle,
            'machine_constant': settings.machine_constant,
            'limits': settings.limits,
        },
        'times': figures.times.document(),
        'driven': {'programmed': figures.driven_before, 'scheduled': figures.driven},
        'driven_stretch': figures.stretch,
        'tolerance_kept': figures.kept,
        'feed_words': {'added': figures.added, 'changed': figures.changed},
        'notes': figures.notes,
    }


def _corners(blend: float) -> str:
    return f'rounded by up to {millimetres(blend)} mm' if blend else 'stopped at'


def methods_table(found: Mapping[str, MethodDrive], method: str, tolerance: float) -> Table:
    """Return time and simulated contour error of every method on a stretch of a program."""
    columns = (
        Column('Method', numeric=False),
        Column('made for the tolerance', numeric=False),
        Column('time [s]'),
        Column('away from stops', 'largest contour error [mm]'),
        Column('anywhere', 'largest contour error [mm]'),
    )
    rows: list[tuple[str, ...]] = []
    highlight: set[int] = set()
    for name in (PROGRAMMED, EVEN, *METHODS):
        if name not in found:
            continue
        one = found[name]
        errors = ('-', '-')
        if one.drive is not None:
            errors = _millimetres(one.drive.error_away), _millimetres(one.drive.error)
        duration = f'{one.duration:,.2f}' if one.drive else f'more than {one.duration:,.0f}'
        label = {
            PROGRAMMED: 'as programmed',
            EVEN: f'one feed for all, {speed(one.feed)}',
        }.get(name) or LABELS[name]
        if name == method:
            highlight.add(len(rows))
        rows.append((label, 'yes' if one.knows_tolerance else 'no', duration, *errors))
    return Table(
        f'Tolerance {1e3 * tolerance:g} mm: the same stretch on the simulated machine',
        columns,
        tuple(rows),
        highlight=frozenset(highlight),
    )


def schedule_page(
    figures: ScheduleFigures,
    trace: PathTrace,
    found: Mapping[str, MethodDrive],
    stretch: str,
    facts: Mapping[str, str],
) -> Page:
    """Return the page of a scheduled program.

    Parameters
    ----------
    figures : ScheduleFigures
        What became of it.
    trace : PathTrace
        Its path by feed.
    found : mapping of str to MethodDrive
        Methods on a stretch of it, driven on the simulated machine.
    stretch : str
        Which stretch that is.
    facts : mapping of str to str
        Provenance.
    """
    name = figures.method
    label = LABELS.get(name, name)
    drawn: list[Figure] = []
    if len(trace.edges[1]):
        drawn.append(
            Figure(
                'The path by feed',
                'The feed that each block asks for; starts, stops and braking come on top. '
                + (
                    f'Thinned out: each edge stands for up to {trace.stride} blocks or pieces of '
                    'arcs.'
                    if trace.stride > 1
                    else 'Rapids and blocks that keep their feed are left out.'
                ),
                path_chart(trace),
            )
        )
    sections = [
        Section(
            'Times within the limits of the machine',
            judged=[] if figures.kept else [Remark(figures.verdict, warning=True)],
            tables=[schedule_table(figures)],
            remarks=[
                *figures.remarks(),
                'The bound is no forecast: bends shorter than the machine reacts, such as rounded '
                'corners, leave less.',
            ],
            figures=drawn,
        ),
        _methods_section(figures, found, stretch, name, label),
    ]
    if figures.notes:
        sections.append(_notes_section(figures.notes))
    return Page(
        title='Feeds that keep a contour tolerance',
        summary=f'{figures.program}, scheduled by {label} for a contour error of no more than '
        f'{1e3 * figures.tolerance:g} mm.',
        sections=sections,
        facts={'Judged': f'{stretch}, on the simulated machine', **facts},
    )


def _methods_section(
    figures: ScheduleFigures,
    found: Mapping[str, MethodDrive],
    stretch: str,
    name: str,
    label: str,
) -> Section:
    """Return the section that compares the methods."""
    plots = []
    chosen, own = found[name].drive, found[PROGRAMMED].drive
    if chosen is not None:
        plots.append(
            Figure(
                'Where the error is',
                f'The path of the tool on {stretch}, scheduled by {label}, coloured by its '
                'contour error: blue within the tolerance, red beyond it.',
                error_chart(chosen, figures.tolerance),
            )
        )
        plots.append(
            Figure(
                'Motion over time',
                f'Along the path, on {stretch}: the reference that the machine is given, within '
                'its limits, and how far the tool is from the path. Without a limit of jerk the '
                'acceleration jumps.',
                motion_chart(chosen, own, (label, 'as programmed'), figures.tolerance),
            )
        )
    return Section(
        'Methods side by side',
        texts=[
            f'On {stretch}, rapids and what keeps its feed left out, each schedule was driven on '
            'the simulated machine. The published fuzzy method, constant feed and chord error '
            'know no tolerance: they are shown at the same upper bound of the feed. One feed for '
            'all is the largest that keeps the tolerance in the sharpest bend.'
        ],
        tables=[methods_table(found, name, figures.tolerance)],
        remarks=[
            f'Away from stops: later than {AFTER_STOP:g} delays of the machine after an exact '
            'stop, where the error depends on acceleration and rest (parameter settle), not on '
            'the feed; - where stops follow each other too closely.',
            f'More than {DURATION_MAX:.0f} s are not driven.',
        ],
        figures=plots,
    )


def _notes_section(notes: Sequence[Note]) -> Section:
    return Section(
        'Passed through untouched',
        texts=['These lines were not changed; their effect on the times:'],
        remarks=[str(note) for note in notes],
    )


def _millimetres(error: float) -> str:
    return f'{1e3 * error:.4f}' if isfinite(error) else '-'


FLAT = 0.02
"""Extent of an axis, as a share of the largest one, below which a path counts as flat."""

SHALLOW = 0.25
"""Share of the other axes below which the height of a view from the side is enlarged."""

FEED_COLOURS = ('#6f5bd0', '#2399b4', '#4fa83d', '#c9a21a')
"""Colours from no feed to the largest one, legible on light and dark pages."""

_AXES = 'XYZ'


def path_chart(trace: PathTrace) -> Chart:
    """Declare a path coloured by feed: in its plane, or from above and below that from the side.

    A part that is shallow beside its length is drawn higher than it is in the view from the
    side, by a factor that stands at the axis.
    """
    ends, feed = trace.edges
    extent = np.ptp(ends.reshape(-1, 3), axis=0)
    flat = extent < FLAT * extent.max()
    views = [(0, 1), (0, 2)]
    if flat.any():
        across, up = (axis for axis in range(3) if axis != np.argmin(extent))
        views = [(across, up)]
    # Edges that do not meet are parted by a gap.
    apart = np.append(True, (ends[1:, 0] != ends[:-1, 1]).any(axis=1))
    rows = np.repeat(np.arange(len(ends)), 1 + 2 * apart)
    place = 1e3 * ends[rows, 1]
    level = 1e3 * MINUTE * feed[rows]
    begins = np.flatnonzero(np.diff(rows, prepend=-1) * apart[rows])
    place[begins], place[begins + 1] = np.nan, 1e3 * ends[apart, 0]
    level[begins + 1] = np.nan
    top = max(1e3 * MINUTE * float(feed.max()), 1e-9)
    shades = Shades(
        Axis('feed', 'mm/min'),
        [(top * number / (len(FEED_COLOURS) - 1), c) for number, c in enumerate(FEED_COLOURS)],
    )

    def panel(across: int, up: int) -> Panel:
        enlarged = 1.0
        if (across, up) == (0, 2) and extent[up] < SHALLOW * extent[across]:
            enlarged = float(f'{SHALLOW * extent[across] / extent[up]:.1g}')
        note = f' (drawn {enlarged:g} times as high)' if enlarged > 1.0 else ''
        return Panel(
            np.empty(0),
            Axis(f'{_AXES[up]}{note}', 'mm'),
            [Series('path', place[:, up], AFTER, 1.3, x=place[:, across], level=level)],
            share=0.45 if (across, up) == (0, 2) and len(views) > 1 else 1.0,
            plane=enlarged,
            shades=shades,
        )

    panels = [panel(*view) for view in views]
    return Chart(Axis(_AXES[views[0][0]], 'mm'), panels, height=5.6)


def error_chart(drive: Drive, tolerance: float) -> Chart:
    """Declare where a tool was in the two axes that it moved most, coloured by contour error."""
    extent = np.nanmax(drive.place, axis=0) - np.nanmin(drive.place, axis=0)
    view = sorted(np.argsort(-extent, kind='stable')[:2])
    names = [_AXES[axis] for axis in view]
    return contouring_page.path_chart(drive.place[:, view], drive.contour_error, names, tolerance)


def motion_chart(
    chosen: Drive, programmed: Drive | None, names: tuple[str, str], tolerance: float
) -> Chart:
    """Declare feed, acceleration, jerk and contour error over time, with those as programmed."""
    drives = [(programmed, BEFORE, names[1])] if programmed is not None else []
    drives.append((chosen, AFTER, names[0]))
    x = chosen.time

    def panel(axis: Axis, values: Callable[[Drive], Floats], **options: Any) -> Panel:
        series = [
            Series(name, values(drive), colour, 1.0, x=None if drive.time is x else drive.time)
            for drive, colour, name in drives
        ]
        return Panel(x, axis, series, **options)

    kept = Rule(1e6 * tolerance, LIMIT, 'tolerance', (6.0, 3.0))
    top = 1.1e6 * max(tolerance, *(float(drive.contour_error.max()) for drive, *_ in drives))
    error = Axis('contour error', 'µm', low=0.0, high=top)
    feed = Axis('feed', 'mm/min', low=0.0)
    return Chart(
        Axis('time', 's'),
        [
            panel(feed, lambda drive: 1e3 * MINUTE * drive.speed, share=1.5),
            panel(error, lambda drive: 1e6 * drive.contour_error, share=1.5, rules=[kept]),
            panel(Axis('acceleration', 'm/s²'), lambda drive: drive.acceleration),
            panel(Axis('jerk', 'm/s³'), lambda drive: drive.jerk),
        ],
        height=1.7,
    )
