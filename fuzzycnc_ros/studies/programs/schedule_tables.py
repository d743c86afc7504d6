# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A scheduled part program: table, remarks, document."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.pareto.pareto_page import LABELS, millimetres

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.gcode.blocks import Note
    from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
    from fuzzycnc_ros.core.feedrate.schedule.program_schedule import ProgramSettings, ProgramTimes
    from fuzzycnc_ros.studies.programs.program_judge import Judged

MINUTE = 60.0


@dataclass(frozen=True, eq=False)
class ScheduleFigures:
    """What became of a part program.

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
    driven_before, driven : Judged or None
        The first lines on the simulated controller, as they were and as they are; None where
        they were not driven.
    stretch : str
        Which lines these are.
    """

    program: str
    method: str
    tolerance: float
    settings: ProgramSettings
    times: ProgramTimes
    notes: Sequence[Note]
    added: int
    changed: int
    driven_before: Judged | None = None
    driven: Judged | None = None
    stretch: str = 'the whole program'

    @property
    def unchanged(self) -> bool:
        """Whether the program came out as it went in."""
        return self.added + self.changed == 0

    @property
    def kept(self) -> bool:
        """Whether what was driven keeps the tolerance."""
        return self.driven is None or self.driven.error <= self.tolerance

    @property
    def verdict(self) -> str:
        """That the tolerance is not kept, where, and what helps."""
        if self.driven is None or self.kept:
            return ''
        place = 'corners' if self.driven.corner_error >= self.driven.error else 'bends'
        return (
            f'tolerance not kept: {1e3 * self.driven.error:.4f} mm at {place}, line '
            f'{self.driven.line:,}, of {self.stretch} on the simulated controller; feeds alone do '
            'not do it here, see fuzzycnc advise'
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
                f'left out of both: {times.untimed:,} motions whose time the program does not tell'
            )
        if times.stops:
            where = 'corners within a run' if settings.blend == 0.0 else 'what cannot be blended'
            lines.append(
                f'exact stops: {times.stops:,}, at the ends of runs and at {where}; what they '
                'leave as error depends on acceleration and rest, not on the feed'
            )
        lines.append(f'limits: {_limits(settings.limits)}')
        lines.append(
            'bound: machine constant times the largest acceleration across the path that the feed '
            'words ask for; driven: on the simulated controller with look-ahead, '
            f'{self.stretch}'
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
        f'{_corners(settings.blend)}, at most {bound}'
    )
    if settings.override != 1.0:
        title += f', override {100.0 * settings.override:g} %'
    warning = frozenset() if figures.kept else frozenset({(1, len(columns) - 1)})
    return Table(title, columns, tuple(rows), warning=warning)


def schedule_document(figures: ScheduleFigures) -> dict[str, Any]:
    """Return all figures.

    Returns
    -------
    dict
        `program`, `method`, `settings` (SI), `times` as in `ProgramTimes` (SI), `driven` (SI),
        `driven_stretch`, `tolerance_kept`, `feed_words` and `notes`.
    """
    settings = figures.settings
    return {
        'program': figures.program,
        'method': figures.method,
        'settings': {
            'tolerance': figures.tolerance,
            'blend': settings.blend,
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
