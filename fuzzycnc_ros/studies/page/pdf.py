# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A page as PDF on A4, drawn by matplotlib: text that can be searched, figures as vectors."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from itertools import groupby
from math import ceil
from typing import Any

from fuzzycnc_ros import __version__
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.studies.page.chart import Chart
from fuzzycnc_ros.studies.page.drawing import AFTER, GRID, INK, MUTED, plot_style
from fuzzycnc_ros.studies.page.html import HEADER, Figure, Page, Section
from fuzzycnc_ros.studies.page.paper import draw_panel
from fuzzycnc_ros.studies.page.table import Table
from fuzzycnc_ros.studies.requirement import require

WIDTH, HEIGHT = 8.27, 11.69
"""Size of a sheet [in]: A4, upright."""

LEFT, TOP, BOTTOM = 0.75, 0.7, 0.8
"""Margins [in]; the right one is the left one."""

INNER = WIDTH - 2.0 * LEFT

BODY, SMALL, HEADING, TITLE = 9.0, 7.5, 12.0, 17.0
"""Sizes of type [pt]."""

LEADING = 1.32
"""Distance of lines in sizes of type."""

KEPT = 2.2
"""Room that a heading asks for, so that something follows it on its sheet [in]."""

CELL, ABOVE_ROW, BELOW_ROW = 0.045, 0.025, 0.035
"""Room beside a cell of a table, above and below a row [in]."""

CELL_SIZES = (7.5, 7.0, 6.5, 6.0, 5.5)
"""Sizes of type in tables [pt]: the first in which all words fit."""

AXES_LEFT, AXES_BELOW, AXES_ABOVE = 0.62, 0.42, 0.24
"""Room for the labels of a panel and for its title [in]."""

LEGEND_LINE, LEGEND_KEY = 0.2, 0.55
"""Height of a line of a legend, and width of a key with its gaps [in]."""

PANEL_SHARE = 0.75
"""Height of a panel beside that on a page, which is wider [-]."""

TINT, WARNED, WARNING_INK = '#eaf2fb', '#fdf3dc', '#8a5a00'
"""Colours behind what stands out and what warns, as a printed page has them."""

POINT = 1.0 / 72.0
"""A point [in]."""


def render_pdf(page: Page) -> bytes:
    """Return a page as a PDF; the same page gives the same bytes.

    Parameters
    ----------
    page : Page
        Sections whose figures are charts.

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
    if page.summary:
        writer.paragraph(page.summary, BODY + 1.0, colour=MUTED)
    facts = [f'{name}: {page.facts[name]}' for name in HEADER if name in page.facts]
    writer.paragraph('    '.join([*facts, f'fuzzycnc: {__version__}']), BODY, colour=MUTED)
    numbers = iter(range(1, 1 + sum(len(section.figures) for section in page.sections)))
    for section in page.sections:
        _section(writer, section, numbers)
    if page.notes:
        writer.heading('Notes')
        for note in page.notes:
            writer.paragraph(note, BODY)
    return writer.finished()


def _section(writer: '_Writer', section: Section, numbers: Iterator[int]) -> None:
    writer.heading(section.heading)
    for text in section.texts:
        writer.paragraph(text, BODY)
    for remark in section.judged:
        writer.paragraph(remark.text, BODY, weight='bold' if remark.warning else 'normal')
    for table in section.tables:
        _Sheet(writer, table).draw()
        writer.paragraph(_caption(table), SMALL, colour=MUTED)
    for text in section.remarks:
        writer.paragraph(f'– {text}', SMALL, colour=MUTED)  # noqa: RUF001 - a dash before an item
    for figure in section.figures:
        _draw_figure(writer, figure, next(numbers))


def _caption(table: Table) -> str:
    """Return the title of a table and what its marks mean."""
    parts = [f'{table.title}.']
    if table.highlight:
        parts.append(f'Shaded: {table.highlight_means}.')
    if table.strong:
        parts.append(f'Bold: {table.strong_means}.')
    if table.warning:
        parts.append(f'Yellow: {table.warning_means}.')
    return ' '.join(parts)


class _Writer:
    """Fills sheets from top to bottom.

    Parameters
    ----------
    title : str
        What stands at the foot of each sheet.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._sheets: list[Any] = []
        self.y = HEIGHT

    @property
    def sheet(self) -> Any:
        """The sheet that is being filled."""
        return self._sheets[-1]

    @property
    def left(self) -> float:
        """Room that is left on it [in]."""
        return HEIGHT - BOTTOM - self.y

    def need(self, height: float) -> bool:
        """Begin a sheet if this one has not so much room [in]; return whether it did."""
        if self._sheets and self.left >= height:
            return False
        figure = require('matplotlib.figure').Figure(figsize=(WIDTH, HEIGHT))
        self._sheets.append(figure)
        self.y = TOP
        return True

    def heading(self, text: str) -> None:
        """Write a heading, where something can follow it."""
        self.need(KEPT)
        self.y += 0.16
        self.paragraph(text, HEADING, weight='bold')

    def paragraph(
        self, text: str, size: float, *, colour: str = INK, weight: str = 'normal'
    ) -> None:
        """Write a paragraph."""
        height = LEADING * size * POINT
        for line in wrapped(visible(text), INNER, size, weight):
            self.need(height)
            self.put(line, LEFT, self.y, size, colour=colour, weight=weight)
            self.y += height
        self.y += 0.4 * height

    def put(self, text: str, x: float, y: float, size: float, **style: Any) -> None:
        """Write a line whose top is at y [in]."""
        colour = style.pop('colour', INK)
        self.sheet.text(
            x / WIDTH, 1.0 - (y + size * POINT) / HEIGHT, text, size=size, color=colour, **style
        )

    def line(self, x: float, to: float, y: float, colour: str, width: float) -> None:
        """Draw a level line [in]."""
        lines = require('matplotlib.lines')
        level = 1.0 - y / HEIGHT
        self.sheet.add_artist(
            lines.Line2D([x / WIDTH, to / WIDTH], [level, level], color=colour, linewidth=width)
        )

    def shade(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        """Colour a rectangle, whose top is at y [in]."""
        patches = require('matplotlib.patches')
        self.sheet.add_artist(
            patches.Rectangle(
                (x / WIDTH, 1.0 - (y + height) / HEIGHT),
                width / WIDTH,
                height / HEIGHT,
                facecolor=colour,
                edgecolor='none',
                transform=self.sheet.transFigure,
                zorder=0,
            )
        )

    def finished(self) -> list[Any]:
        """Return all sheets, with their feet."""
        texts = require('matplotlib.text')
        count = len(self._sheets)
        for number, sheet in enumerate(self._sheets, start=1):
            foot = (HEIGHT - 0.5) / HEIGHT
            style = {'size': SMALL, 'color': MUTED}
            sheet.text(LEFT / WIDTH, 1.0 - foot, self._title, **style)
            sheet.text(1.0 - LEFT / WIDTH, 1.0 - foot, f'{number} of {count}', ha='right', **style)
            for item in sheet.findobj(texts.Text):
                item.set_text(visible(item.get_text(), keep='\n'))
        return self._sheets


@dataclass
class _Sheet:
    """A table that is drawn row by row, with its head on every sheet of paper.

    Parameters
    ----------
    writer : _Writer
        Where.
    table : Table
        What.
    """

    writer: _Writer
    table: Table

    def __post_init__(self) -> None:
        headings = [column.heading for column in self.table.columns]
        cells = [
            [self.table.marked(r, c) for c in range(len(headings))]
            for r in range(len(self.table.rows))
        ]
        for size in CELL_SIZES:
            least = _column_widths([headings, *cells], size, words=True)
            if sum(least) <= INNER:
                break
        self._size = size
        self._height = LEADING * size * POINT
        self._widths = _shared_out(least, _column_widths([headings, *cells], size, words=False))
        self._lefts = [LEFT + sum(self._widths[:c]) for c in range(len(self._widths))]
        self._headings = self._in_lines(headings, 'bold')
        self._rows = [self._in_lines(row, 'normal') for row in cells]

    def draw(self) -> None:
        """Draw it."""
        self._head()
        for number, row in enumerate(self._rows):
            height = self._row_height(row)
            if self.writer.need(height):
                self._head()
            if number in self.table.highlight:
                self.writer.shade(LEFT, self.writer.y, sum(self._widths), height, TINT)
            self._row(row, number)
            self.writer.y += height
            self.writer.line(LEFT, LEFT + sum(self._widths), self.writer.y, GRID, 0.6)
        self.writer.y += 0.05

    def _in_lines(self, cells: Sequence[str], weight: str) -> list[list[str]]:
        return [
            wrapped(cell, width - 2.0 * CELL, self._size, weight)
            for cell, width in zip(cells, self._widths, strict=True)
        ]

    def _row_height(self, row: list[list[str]]) -> float:
        return self._height * max(map(len, row)) + ABOVE_ROW + BELOW_ROW

    def _head(self) -> None:
        """Draw the headings, with two rows below them on the same sheet."""
        groups = self._groups()
        above = max((len(lines) for lines, *_ in groups), default=0) * self._height
        height = above + self._row_height(self._headings)
        following = sum(map(self._row_height, self._rows[:2]))
        self.writer.need(height + following)
        for lines, left, right in groups:
            for number, line in enumerate(lines):
                y = self.writer.y + number * self._height
                self.writer.put(
                    line, 0.5 * (left + right), y, self._size, weight='bold', ha='center'
                )
            end = self.writer.y + above + 0.02
            self.writer.line(left + CELL, right - CELL, end, GRID, 0.8)
        self.writer.y += above
        self._row(self._headings, None)
        self.writer.y += height - above
        self.writer.line(LEFT, LEFT + sum(self._widths), self.writer.y, MUTED, 0.9)

    def _groups(self) -> list[tuple[list[str], float, float]]:
        """Return the lines, and the ends [in], of the headings of groups."""
        found = []
        columns = list(zip(self.table.columns, self._lefts, self._widths, strict=True))
        for name, members in groupby(columns, key=lambda item: item[0].group):
            inside = list(members)
            left, right = inside[0][1], inside[-1][1] + inside[-1][2]
            if name:
                found.append((wrapped(name, right - left - CELL, self._size, 'bold'), left, right))
        return found

    def _row(self, row: list[list[str]], number: int | None) -> None:
        """Draw cells; those of the head have no number, and stand at its foot."""
        most = max(map(len, row))
        for c, (lines, column) in enumerate(zip(row, self.table.columns, strict=True)):
            left, width = self._lefts[c], self._widths[c]
            weight, colour = 'normal', INK
            if number is None:
                weight, colour = 'bold', MUTED
            elif (number, c) in self.table.strong:
                weight, colour = 'bold', AFTER
            elif (number, c) in self.table.warning:
                colour = WARNING_INK
                self.writer.shade(left, self.writer.y, width, self._row_height(row), WARNED)
            elif number in self.table.highlight:
                weight = 'bold' if c == 0 else 'normal'
            first = most - len(lines) if number is None else 0
            for place, line in enumerate(lines, start=first):
                y = self.writer.y + ABOVE_ROW + place * self._height
                if column.numeric:
                    x, ha = left + width - CELL, 'right'
                else:
                    x, ha = left + CELL, 'left'
                self.writer.put(line, x, y, self._size, colour=colour, weight=weight, ha=ha)


def _column_widths(rows: Sequence[Sequence[str]], size: float, *, words: bool) -> list[float]:
    """Return the widths of columns [in] in which each cell, or each word, stands in a line."""
    found = []
    for column in zip(*rows, strict=True):
        parts = [part for cell in column for part in (cell.split() if words else [cell])]
        # Headings and what stands out are bold.
        found.append(max((width_of(part, size, 'bold') for part in parts), default=0.0))
    return [width + 2.0 * CELL for width in found]


def _shared_out(least: list[float], natural: list[float]) -> list[float]:
    """Return the widths of columns that fill a sheet, between the least and the natural ones."""
    wanted = [size - low for size, low in zip(natural, least, strict=True)]
    spare = INNER - sum(least)
    if sum(wanted) <= spare:
        each = (spare - sum(wanted)) / len(least)
        return [size + each for size in natural]
    share = max(spare, 0.0) / sum(wanted)
    return [low + share * more for low, more in zip(least, wanted, strict=True)]


@lru_cache(maxsize=20_000)
def width_of(text: str, size: float, weight: str) -> float:
    """Return the width of a line of text [in]."""
    properties = require('matplotlib.font_manager').FontProperties(
        family='DejaVu Sans', size=size, weight=weight
    )
    measured = require('matplotlib.textpath').text_to_path.get_text_width_height_descent(
        text, properties, False
    )
    return float(measured[0]) * POINT


def wrapped(text: str, width: float, size: float, weight: str) -> list[str]:
    """Return a text in lines of some width [in]; words that are longer are cut."""
    lines = ['']
    for word in text.split(' '):
        joined = f'{lines[-1]} {word}' if lines[-1] else word
        if width_of(joined, size, weight) <= width:
            lines[-1] = joined
            continue
        if lines[-1]:
            lines.append('')
        for character in word:
            if lines[-1] and width_of(lines[-1] + character, size, weight) > width:
                lines.append('')
            lines[-1] += character
    return lines


def _draw_figure(writer: _Writer, figure: Figure, number: int) -> None:
    """Draw a chart with its caption, on one sheet.

    Raises
    ------
    ValueError
        If it is no chart.
    """
    chart = figure.plot
    if not isinstance(chart, Chart):
        raise ValueError(f'figure {figure.title!r}: expected a chart but found a picture')
    rows = ceil(len(chart.panels) / chart.columns)
    each = PANEL_SHARE * chart.height
    room = HEIGHT - TOP - BOTTOM - 1.2
    each = min(each, room / rows)
    writer.need(rows * each + 1.0)
    legend_at = writer.y
    names = list(dict.fromkeys(s.name for p in chart.panels for s in p.series if not s.quiet))
    columns = max(
        1, int(INNER / (0.55 + max((width_of(n, SMALL, 'normal') for n in names), default=0.0)))
    )
    writer.y += LEGEND_LINE * ceil(len(names) / columns) + 0.05
    handles: dict[str, Any] = {}
    for place, panel in enumerate(chart.panels):
        row, column = divmod(place, chart.columns)
        width = INNER / chart.columns
        top = writer.y + row * each + AXES_ABOVE
        height = each - AXES_ABOVE - AXES_BELOW
        axes = writer.sheet.add_axes(
            (
                (LEFT + column * width + AXES_LEFT) / WIDTH,
                1.0 - (top + height) / HEIGHT,
                (width - AXES_LEFT - 0.05) / WIDTH,
                height / HEIGHT,
            )
        )
        for name, handle in draw_panel(axes, panel, chart.x_axis).items():
            handles.setdefault(name, handle)
        if row == rows - 1 or not chart.linked:
            axes.set_xlabel(chart.x_axis.label)
    writer.sheet.legend(
        list(handles.values()),
        list(handles),
        loc='upper left',
        bbox_to_anchor=(LEFT / WIDTH, 1.0 - legend_at / HEIGHT),
        ncol=columns,
        fontsize=SMALL,
        borderaxespad=0.0,
        handlelength=1.6,
        columnspacing=1.2,
    )
    writer.y += rows * each + 0.08
    writer.paragraph(f'Figure {number}. {figure.title}. {figure.caption}', SMALL, colour=MUTED)
