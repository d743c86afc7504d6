# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A page as PDF on A4, drawn by matplotlib: text that can be searched, curves as vectors."""

import warnings
from collections.abc import Iterator
from io import BytesIO
from math import ceil
from textwrap import wrap
from typing import Any

import numpy as np

from fuzzycnc_ros import __version__
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.studies.page.chart import Chart, Panel, kept_rows
from fuzzycnc_ros.studies.page.drawing import INK, MUTED, plot_style
from fuzzycnc_ros.studies.page.html import HEADER, Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Table
from fuzzycnc_ros.studies.requirement import require

WIDTH, HEIGHT = 8.27, 11.69
"""Size of a sheet [in]: A4, upright."""

LEFT, TOP, BOTTOM = 0.75, 0.7, 0.8
"""Margins [in]; the right one is the left one."""

INNER = WIDTH - 2.0 * LEFT

BODY, SMALL, CELL, HEADING, TITLE = 9.0, 7.5, 6.8, 12.0, 17.0
"""Sizes of type [pt]; that of cells is smaller in tables that are wide."""

LEADING = 1.32
"""Distance of lines in sizes of type."""

CHARACTER, MEAN_CHARACTER, BOLD_CHARACTER = 0.602, 0.57, 0.66
"""Width of a character in sizes of type: each one in tables, means of a line elsewhere."""

KEPT = 2.2
"""Room that a heading asks for, so that something follows it on its sheet [in]."""

PANEL_SHARE = 0.75
"""Height of a panel beside that on a page, which is wider [-]."""

ROWS, KEYS = 1000, 6
"""Rows of a series, as no printer shows more extremes, and keys in a row of a legend."""


def render_pdf(page: Page) -> bytes:
    """Return a page as a PDF; the same page gives the same bytes.

    Parameters
    ----------
    page : Page
        Sections whose figures show curves over x.

    Raises
    ------
    ModuleNotFoundError
        If matplotlib is not installed; the message says how to install it.
    """
    pages = require('matplotlib.backends.backend_pdf').PdfPages
    stream = BytesIO()
    with require('matplotlib').rc_context({'pdf.fonttype': 42}), plot_style():
        found = sheets(page)
        metadata = {'Title': visible(page.title), 'Creator': 'fuzzycnc', 'CreationDate': None}
        with pages(stream, metadata=metadata) as file, warnings.catch_warnings():
            warnings.filterwarnings('ignore', 'Glyph .* missing from font')
            for sheet in found:
                file.savefig(sheet)
    return stream.getvalue()


def sheets(page: Page) -> list[Any]:
    """Return the sheets of a page as matplotlib figures, to be drawn within `plot_style`."""
    writer = _Writer(page.title)
    writer.paragraph(page.title, TITLE, weight='bold')
    writer.paragraph(page.summary, BODY + 1.0, color=MUTED)
    facts = [f'{name}: {page.facts[name]}' for name in HEADER if name in page.facts]
    writer.paragraph('; '.join([*facts, f'fuzzycnc: {__version__}']), BODY, color=MUTED)
    numbers = iter(range(1, 1 + sum(len(section.figures) for section in page.sections)))
    for section in page.sections:
        _section(writer, section, numbers)
    if page.notes:
        _section(writer, Section('Notes', texts=page.notes), numbers)
    return writer.finished()


def _section(writer: '_Writer', section: Section, numbers: Iterator[int]) -> None:
    writer.need(KEPT)
    writer.y += 0.16
    writer.paragraph(section.heading, HEADING, weight='bold')
    for text in section.texts:
        writer.paragraph(text, BODY)
    for remark in section.judged:
        writer.paragraph(remark.text, BODY, weight='bold' if remark.warning else 'normal')
    for table in section.tables:
        writer.table(table)
    for text in section.remarks:
        writer.paragraph(f'- {text}', SMALL, color=MUTED)
    for figure in section.figures:
        _draw_figure(writer, figure, next(numbers))


class _Writer:
    """Fills sheets from top to bottom.

    Parameters
    ----------
    title : str
        Text at the foot of each sheet.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self.sheets: list[Any] = []
        self.y = HEIGHT

    def need(self, height: float) -> bool:
        """Begin a sheet if this one has not so much room [in]; return whether it did."""
        if self.sheets and HEIGHT - BOTTOM - self.y >= height:
            return False
        self.sheets.append(require('matplotlib.figure').Figure(figsize=(WIDTH, HEIGHT)))
        self.y = TOP
        return True

    def paragraph(self, text: str, size: float, **style: Any) -> None:
        """Write a paragraph."""
        wide = BOLD_CHARACTER if style.get('weight') == 'bold' else MEAN_CHARACTER
        for line in wrap(visible(text), int(INNER * 72.0 / (size * wide))):
            self.line(line, size, **style)
        self.y += 0.4 * LEADING * size / 72.0

    def table(self, table: Table) -> None:
        """Write a table, on one sheet if it fits on one, else with its head on each."""
        title, *lines = table.to_text(int(INNER * 72.0 / (CELL * CHARACTER))).split('\n')
        size = min(CELL, INNER * 72.0 / (CHARACTER * max(map(len, lines))))
        height = LEADING * size / 72.0
        rule = next(n for n, line in enumerate(lines) if line and not line.strip('- '))
        head, rows = lines[: rule + 1], lines[rule + 1 :]
        whole = len(lines) * height
        self.need(whole if whole < HEIGHT - TOP - BOTTOM else (len(head) + 2) * height)
        for number, line in enumerate([*head, *rows]):
            if self.need(height):
                for again in head:
                    self.line(again, size, family='DejaVu Sans Mono', weight='bold')
            weight = 'bold' if number <= rule else 'normal'
            self.line(line, size, family='DejaVu Sans Mono', weight=weight)
        self.y += 0.05
        means = f' Last row: {table.highlight_means}.' if table.highlight else ''
        self.paragraph(f'{title}.{means}', SMALL, color=MUTED)

    def line(self, text: str, size: float, **style: Any) -> None:
        """Write a line."""
        self.need(LEADING * size / 72.0)
        place = LEFT / WIDTH, 1.0 - (self.y + size / 72.0) / HEIGHT
        self.sheets[-1].text(*place, text, size=size, **{'color': INK, **style})
        self.y += LEADING * size / 72.0

    def finished(self) -> list[Any]:
        """Return all sheets, with their feet."""
        for number, sheet in enumerate(self.sheets, start=1):
            style = {'y': 0.5 / HEIGHT, 'size': SMALL, 'color': MUTED}
            sheet.text(LEFT / WIDTH, s=visible(self._title), **style)
            count = f'{number} of {len(self.sheets)}'
            sheet.text(1.0 - LEFT / WIDTH, s=count, ha='right', **style)
        return self.sheets


def _draw_figure(writer: _Writer, figure: Figure, number: int) -> None:
    """Draw a chart with its caption, on one sheet."""
    chart: Chart = figure.plot
    names = {series.name for panel in chart.panels for series in panel.series if not series.quiet}
    key, count = 0.2 * ceil(len(names) / KEYS), len(chart.panels)
    each = min(PANEL_SHARE * chart.height, (HEIGHT - TOP - BOTTOM - 1.5) / count)
    height = key + count * each
    writer.need(height + 0.7)
    sheet, top = writer.sheets[-1], writer.y
    handles: dict[str, Any] = {}
    for place, panel in enumerate(chart.panels):
        floor = top + key + (place + 1) * each - 0.42
        box = LEFT + 0.62, HEIGHT - floor, WIDTH - 2.0 * LEFT - 0.67, each - 0.66
        axes = sheet.add_axes((box[0] / WIDTH, box[1] / HEIGHT, box[2] / WIDTH, box[3] / HEIGHT))
        handles |= _draw_panel(axes, panel)
        axes.set_xlabel(chart.x_axis.label)
    sheet.legend(
        list(handles.values()),
        list(handles),
        loc='upper left',
        bbox_to_anchor=(LEFT / WIDTH, 1.0 - top / HEIGHT),
        ncol=KEYS,
        fontsize=SMALL,
        borderaxespad=0.0,
        handlelength=1.6,
    )
    writer.y += height
    caption = f'Figure {number}. {figure.title}. {figure.caption}'
    writer.paragraph(caption, SMALL, color=MUTED)


def _draw_panel(axes: Any, panel: Panel) -> dict[str, Any]:
    """Draw curves over x with what stands behind them; return what a legend names."""
    axes.set_title(visible(panel.title))
    axes.set_ylabel(panel.y_axis.label)
    axes.set_xlim(panel.x[0], panel.x[-1])
    for span in panel.spans:
        axes.axvspan(span.low, span.high, color=span.colour, alpha=0.14, linewidth=0.0, zorder=0)
        axes.annotate(
            visible(span.name),
            (span.low, 0.99),
            xycoords=('data', 'axes fraction'),
            xytext=(2.0, -2.0),
            textcoords='offset points',
            va='top',
            fontsize=7.0,
            color=MUTED,
            clip_on=True,
        )
    for rule in panel.rules:
        axes.axhline(rule.at, color=rule.colour, linewidth=0.9, zorder=1)
    handles = {}
    for series in panel.series:
        rows = kept_rows(series.y[:, np.newaxis], ROWS)
        (line,) = axes.plot(
            panel.x[rows],
            series.y[rows],
            color=series.colour,
            alpha=0.35 if series.quiet else None,
            linewidth=0.7 if series.quiet else series.width,
            drawstyle='steps-post' if series.kind == 'steps' else 'default',
        )
        if not series.quiet:
            handles[visible(series.name)] = line
    axes.set_ylim(panel.y_axis.low, panel.y_axis.high)
    return handles
