# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Remedies for a part program: table, lines, document and page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Rule, Series
from fuzzycnc_ros.studies.page.document import shown_as
from fuzzycnc_ros.studies.page.drawing import AFTER, LIMIT
from fuzzycnc_ros.studies.page.html import Figure, Page, Remark, Section
from fuzzycnc_ros.studies.page.table import Column, Table

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.programs.program_judge import ProgramResult

MICRO, MILLI = 1e6, 1e3


@dataclass(frozen=True)
class AdviceRow:
    """A remedy.

    Parameters
    ----------
    name : str
        What it is.
    acceleration : tuple of float
        Of X, Y and Z [m/s^2].
    mode : str
        Path mode in words of a program.
    simulated : ProgramResult
        On the simulated controller.
    measured : ProgramResult or None
        On LinuxCNC, where it ran.
    """

    name: str
    acceleration: tuple[float, float, float]
    mode: str
    simulated: ProgramResult
    measured: ProgramResult | None = field(default=None, metadata=shown_as('linuxcnc'))

    @property
    def judged(self) -> ProgramResult:
        """Decisive result: LinuxCNC where it ran, else the simulated controller."""
        return self.measured or self.simulated


@dataclass(frozen=True)
class AdviceFigures:
    """Remedies for a program.

    Parameters
    ----------
    program : str
        Its name.
    tolerance, aim : float
        Largest contour error wanted, and that on the simulated controller, so that LinuxCNC
        keeps the tolerance [m].
    rows : sequence of AdviceRow
        The first one is the program as it is.
    best : int
        Index of the one that is recommended.
    """

    program: str
    tolerance: float
    aim: float
    rows: Sequence[AdviceRow]
    best: int

    @property
    def kept(self) -> bool:
        """True if the recommended one keeps the tolerance."""
        return self.keeps(self.rows[self.best])

    def keeps(self, row: AdviceRow) -> bool:
        """Return True if a remedy keeps the tolerance on LinuxCNC, else the simulated aim."""
        return row.judged.error <= (self.tolerance if row.measured else self.aim)

    @property
    def remark(self) -> str:
        """Aim, and the reason for it."""
        more = 100.0 * (self.tolerance / self.aim - 1.0)
        return (
            f'simulated errors are kept below {MICRO * self.aim:.4g} µm, since LinuxCNC left up '
            f'to {more:.0f} % more on programs of this kind'
        )

    @property
    def verdict(self) -> Remark:
        """Recommendation, or that nothing keeps the tolerance."""
        best, first = self.rows[self.best], self.rows[0]
        error, time = MICRO * best.judged.error, best.judged.duration
        where = 'on LinuxCNC' if best.measured else 'on the simulated controller'
        if not self.kept and error <= MICRO * self.tolerance:
            return Remark(
                f'no remedy tried is sure to keep {MICRO * self.tolerance:g} µm: '
                f'{self.remark}; the least error {where} leaves {best.name}: {error:.1f} µm in '
                f'{time:.2f} s; --linuxcnc runs it',
                warning=True,
            )
        if not self.kept:
            return Remark(
                f'no remedy tried keeps {MICRO * self.tolerance:g} µm; the least error '
                f'{where} leaves {best.name}: {error:.1f} µm in {time:.2f} s',
                warning=True,
            )
        if self.best == 0:
            return Remark(f'leave it as it is: {error:.1f} µm {where} in {time:.2f} s')
        return Remark(
            f'recommended: {best.name}: {error:.1f} µm {where} in {time:.2f} s, as it is '
            f'{MICRO * first.judged.error:.1f} µm in {first.judged.duration:.2f} s'
        )


def advice_table(figures: AdviceFigures) -> Table:
    """Return time and errors of every remedy."""
    columns = [
        Column('No.'),
        Column('Remedy', numeric=False),
        Column('acceleration [mm/s²]'),
        Column('path mode', numeric=False),
    ]
    measured = any(row.measured for row in figures.rows)
    names = ['simulated', 'LinuxCNC'] if measured else ['simulated']
    for name in names:
        columns += [
            Column('time [s]', name),
            Column('largest [µm]', name),
            Column('rms [µm]', name),
        ]
    columns += [Column('at corners [µm]', 'largest'), Column('elsewhere [µm]', 'largest')]
    rows: list[tuple[str, ...]] = []
    warning = set()
    for index, row in enumerate(figures.rows):
        cells = [str(index + 1), row.name, _rise(row.acceleration), row.mode]
        for one in (row.simulated, row.measured)[: len(names)]:
            most = figures.aim if one is row.simulated else figures.tolerance
            if one is not None and one.error > most:
                warning.add((index, len(cells) + 1))
            cells += _triple(one)
        cells += [_micro(row.judged.corner_error), _micro(row.judged.smooth_error)]
        rows.append(tuple(cells))
    title = f'{figures.program}: contour error of {MICRO * figures.tolerance:g} µm at most'
    return Table(
        title, tuple(columns), tuple(rows), highlight=frozenset({figures.best}),
        warning=frozenset(warning), highlight_means='recommended',
        warning_means='not sure to keep the tolerance',
    )  # fmt: skip


def _rise(acceleration: tuple[float, float, float]) -> str:
    return '/'.join(dict.fromkeys(f'{MILLI * value:.0f}' for value in acceleration))


def _triple(one: ProgramResult | None) -> list[str]:
    if one is None:
        return ['-', '-', '-']
    return [f'{one.duration:.2f}', _micro(one.error), _micro(one.rms)]


def _micro(error: float) -> str:
    return f'{MICRO * error:.1f}' if isfinite(error) else '-'


def settings_lines(figures: AdviceFigures) -> list[str]:
    """Return the lines of LinuxCNC's INI file that the recommended remedy asks for."""
    best, first = figures.rows[figures.best], figures.rows[0]
    if best.acceleration == first.acceleration:
        return []
    lines = []
    for number, (axis, value) in enumerate(zip('XYZ', best.acceleration, strict=True)):
        for section in (f'[AXIS_{axis}]', f'[JOINT_{number}]'):
            lines.append(f'{section} MAX_ACCELERATION = {MILLI * value:.0f}')
    return lines


def advice_document(figures: AdviceFigures) -> dict[str, Any]:
    """Return all figures (SI)."""
    return {
        'program': figures.program,
        'tolerance': figures.tolerance,
        'aim': figures.aim,
        'kept': figures.kept,
        'best': figures.best,
        'ini': settings_lines(figures),
        'remedies': figures.rows,
    }


def advice_page(figures: AdviceFigures, facts: Mapping[str, str], notes: Sequence[str]) -> Page:
    """Return the page of a program's remedies.

    Parameters
    ----------
    figures : AdviceFigures
        What was found.
    facts : mapping of str to str
        Provenance.
    notes : sequence of str
        What a reader has to know besides.
    """
    lines = settings_lines(figures)
    remarks = [
        'Largest: distance of the axes from the programmed path while cutting. At corners: up to '
        'four delays of the machine after a turn of 20 degrees or more.',
        f'{figures.remark[:1].upper()}{figures.remark[1:]}.',
        *notes,
    ]
    if lines:
        remarks.insert(0, 'INI file of LinuxCNC: ' + '; '.join(lines))
    return Page(
        title='What to set for a contour tolerance',
        summary=figures.verdict.text[:1].upper() + figures.verdict.text[1:] + '.',
        sections=[
            Section(
                'Remedies side by side',
                judged=[figures.verdict],
                tables=[advice_table(figures)],
                remarks=remarks,
                figures=[
                    Figure(
                        'Time against largest contour error',
                        'Each remedy by its number in the table; the dashed line is the '
                        'tolerance.',
                        _chart(figures),
                    )
                ],
            )
        ],
        facts={
            'Machine': 'LinuxCNC, and a simulated controller'
            if any(row.measured for row in figures.rows)
            else 'a simulated controller',
            'Judged': 'while cutting',
            **facts,
        },
    )


def _chart(figures: AdviceFigures) -> Chart:
    """Declare time against largest contour error, remedies by their numbers."""
    order = sorted(range(len(figures.rows)), key=lambda row: figures.rows[row].judged.error)
    judged = [figures.rows[row].judged for row in order]
    error = np.array([MICRO * one.error for one in judged])
    time = np.array([one.duration for one in judged])
    kept = np.array([figures.keeps(figures.rows[row]) for row in order])
    text = [f'{row + 1}, recommended' if row == figures.best else str(row + 1) for row in order]
    series = [
        Series(
            'not sure to keep the tolerance',
            np.where(kept, np.nan, time),
            LIMIT,
            kind='dots',
            text=text,
        ),
        Series('keeps the tolerance', np.where(kept, time, np.nan), AFTER, kind='dots', text=text),
    ]
    name = f'tolerance {MICRO * figures.tolerance:g} µm'
    rule = Rule(MICRO * figures.tolerance, LIMIT, name, (6.0, 3.0), upright=True)
    panel = Panel(error, Axis('time', 's'), series, rules=[rule])
    return Chart(Axis('largest contour error', 'µm', 'log'), [panel], height=3.6)
