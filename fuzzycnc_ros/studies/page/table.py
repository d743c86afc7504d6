# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A table once, shown in the terminal, as plain text, as Markdown and in HTML."""

from collections.abc import Callable, Collection, Hashable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import groupby, zip_longest
from textwrap import wrap
from typing import Any, TypeVar

from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.studies.page.drawing import THEME
from fuzzycnc_ros.studies.requirement import require

Key = TypeVar('Key', bound=Hashable)

TEXT_MIN = 20
"""Characters that a cell of text keeps beside each other if it has so many."""

WARNING_MARK = '! '
"""Stands before a number that warns."""


@dataclass(frozen=True)
class Column:
    """Heading of a column, the group it belongs to, and whether it holds numbers."""

    heading: str
    group: str = ''
    numeric: bool = True

    @property
    def full_heading(self) -> str:
        """Group and heading in one line."""
        return f'{self.group} {self.heading}'.strip()


@dataclass(frozen=True)
class Table:
    """Cells as text with headings, an explanation and emphasis.

    Control characters are spelt out everywhere: names may come from anywhere.

    Parameters
    ----------
    title : str
        What the table holds, with the unit of its numbers.
    columns : tuple of Column
        Columns; neighbours of one group share a heading where the output can show that.
    rows : tuple of tuple of str
        Cells.
    strong : frozenset of (int, int)
        Row and column of the cells that stand out, such as the best of a column.
    highlight : frozenset of int
        Rows that stand out, such as the model in use.
    warning : frozenset of (int, int)
        Row and column of the cells that warn; numbers among them are marked in plain text too.
    bars : mapping of (int, int) to (float, str)
        Row and column of the cells that pages show as bars too: share of the longest, and colour.
    strong_means, highlight_means, warning_means, bars_mean : str
        What these marks stand for, as a page says below the table.

    Raises
    ------
    ValueError
        If a row has not one cell per column.

    Examples
    --------
    >>> columns = (Column('Model', numeric=False), Column('max', 'Y'), Column('max', 'Z'))
    >>> print(Table('Residual [um]', columns, (('LagRidge', '2.4', '1.8'),)).to_text())
    Residual [um]
    Model     Y max  Z max
    --------  -----  -----
    LagRidge    2.4    1.8
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    strong: frozenset[tuple[int, int]] = frozenset()
    highlight: frozenset[int] = frozenset()
    warning: frozenset[tuple[int, int]] = frozenset()
    bars: Mapping[tuple[int, int], tuple[float, str]] = field(default_factory=dict)
    strong_means: str = 'best in its column, ties included'
    highlight_means: str = 'in use, or the automatic choice'
    warning_means: str = 'worse than no compensation'
    bars_mean: str = ''

    def __post_init__(self) -> None:
        for number, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                raise ValueError(
                    f'row {number} of table {self.title!r}: expected {len(self.columns)} cells '
                    f'but found {len(row)}'
                )
        shown = tuple(
            replace(column, heading=visible(column.heading), group=visible(column.group))
            for column in self.columns
        )
        object.__setattr__(self, 'title', visible(self.title))
        object.__setattr__(self, 'columns', shown)
        object.__setattr__(self, 'rows', tuple(tuple(map(visible, row)) for row in self.rows))

    def marked(self, row: int, column: int) -> str:
        """Return a cell as it is shown where colours may be absent."""
        text = self.rows[row][column]
        warns = (row, column) in self.warning and self.columns[column].numeric
        return f'{WARNING_MARK}{text}' if warns else text

    def bar_style(self, row: int, column: int) -> str:
        """Return the attribute of a cell of HTML that draws its bar, nothing where it has none."""
        if (row, column) not in self.bars:
            return ''
        share, colour = self.bars[row, column]
        hue = f'var({THEME[colour]})' if colour in THEME else colour
        return f' style="--bar:{100.0 * share:.1f}%;--hue:{hue}"'

    def groups(self) -> list[tuple[str, int]]:
        """Return the groups of columns, each with its number of columns."""
        return [
            (group, len(list(members)))
            for group, members in groupby(self.columns, key=lambda column: column.group)
        ]

    def to_rich(self) -> Any:
        """Return a `rich.table.Table`; needs rich."""
        text = require('rich.text').Text
        table = require('rich.table').Table(
            title=text(self.title, style='bold'),
            title_justify='left',
            box=require('rich.box').SIMPLE_HEAD,
        )
        for column, least in zip(self.columns, self._least_widths(), strict=True):
            table.add_column(
                text(f'{column.group}\n{column.heading}'.strip()),
                justify='right' if column.numeric else 'left',
                vertical='bottom',
                no_wrap=column.numeric,
                overflow='fold',
                min_width=None if column.numeric else least,
            )
        for r, row in enumerate(self.rows):
            cells = [text(self.marked(r, c), style=self._style((r, c))) for c in range(len(row))]
            table.add_row(*cells, style='bold' if r in self.highlight else None)
        return table

    def _style(self, cell: tuple[int, int]) -> str:
        if cell in self.warning:
            return 'bold yellow'
        return 'bold green' if cell in self.strong else ''

    def to_text(self, width: int | None = None) -> str:
        """Return plain text in aligned columns.

        Parameters
        ----------
        width : int, optional
            Characters of a line; cells of text take several lines where they must, numbers never.
        """
        headings = [tuple(column.full_heading for column in self.columns)]
        widths = self._natural_widths(headings)
        lines = []
        if width is not None and sum(widths) + 2 * (len(widths) - 1) > width:
            headings = [tuple(column.heading for column in self.columns)]
            widths = self._narrowed(self._under_groups(self._natural_widths(headings)), width)
            lines += [self._group_line(widths)] if any(c.group for c in self.columns) else []
        rule = tuple('-' * size for size in widths)
        for row in (*headings, rule, *self._cells()):
            cells = [
                [cell] if column.numeric else wrap(cell, max(size, 1)) or ['']
                for cell, size, column in zip(row, widths, self.columns, strict=True)
            ]
            lines += [
                '  '.join(
                    cell.rjust(size) if column.numeric else cell.ljust(size)
                    for cell, size, column in zip(line, widths, self.columns, strict=True)
                ).rstrip()
                for line in zip_longest(*cells, fillvalue='')
            ]
        return '\n'.join([self.title, *lines])

    def least_width(self) -> int:
        """Return how many characters a line of plain text needs, so that no number is cut."""
        return sum(self._least_widths()) + 2 * (len(self.columns) - 1)

    def _cells(self) -> list[tuple[str, ...]]:
        """Return the rows as plain text has them."""
        return [
            tuple(self.marked(r, c) for c in range(len(row))) for r, row in enumerate(self.rows)
        ]

    def _under_groups(self, widths: list[int]) -> list[int]:
        """Return widths with room for the names of the groups above them."""
        found, end = list(widths), 0
        for group, count in self.groups():
            end += count
            found[end - 1] += max(0, len(group) - sum(found[end - count : end]) - 2 * (count - 1))
        return found

    def _group_line(self, widths: list[int]) -> str:
        parts, end = [], 0
        for group, count in self.groups():
            end += count
            parts.append(group.center(sum(widths[end - count : end]) + 2 * (count - 1)))
        return '  '.join(parts).rstrip()

    def _natural_widths(self, headings: list[tuple[str, ...]]) -> list[int]:
        rows = zip(*headings, *self._cells(), strict=True)
        return [max(map(len, column)) for column in rows]

    def _least_widths(self) -> list[int]:
        """Return the least width of each column: numbers whole, of text its longest word."""
        headings = tuple(column.heading for column in self.columns)
        found = []
        for c, natural in enumerate(self._natural_widths([headings])):
            cells = [row[c] for row in (headings, *self._cells())]
            longest = max((len(word) for cell in cells for word in cell.split()), default=0)
            words = natural if self.columns[c].numeric else max(TEXT_MIN, longest)
            found.append(min(natural, words))
        return self._under_groups(found)

    def _narrowed(self, widths: list[int], width: int) -> list[int]:
        """Return widths that fit a line, if the widest columns of text can give enough away."""
        found, least = list(widths), self._least_widths()
        while sum(found) + 2 * (len(found) - 1) > width:
            spare = [size - low for size, low in zip(found, least, strict=True)]
            if not any(spare):
                break
            found[max(range(len(found)), key=lambda c: found[c] if spare[c] else 0)] -= 1
        return found

    def to_markdown(self) -> str:
        """Return a Markdown table with a bold title line."""
        cells = [
            [self._markdown_cell(r, c) for c in range(len(row))] for r, row in enumerate(self.rows)
        ]
        headings = [_escaped(column.full_heading) for column in self.columns]
        rule = ['---:' if column.numeric else ':---' for column in self.columns]
        lines = ['| ' + ' | '.join(row) + ' |' for row in (headings, rule, *cells)]
        return '\n'.join([f'**{_escaped(self.title)}**', '', *lines])

    def _markdown_cell(self, row: int, column: int) -> str:
        text = _escaped(self.marked(row, column))
        return f'**{text}**' if (row, column) in self.strong else text


def case_table(
    title: str,
    cases: Iterable[tuple[Any, ...]],
    figures: Mapping[Column, Callable[..., str]],
    warns: Callable[..., Collection[int]] = lambda *case: (),
    **marks: Any,
) -> Table:
    """Return a table with a row for each case and a column for each of its figures.

    Parameters
    ----------
    title : str
        What the table holds.
    cases : iterable of tuple
        What the cells of a row are taken from; `zip` makes such tuples of single objects.
    figures : mapping of Column to callable
        Column, and its cell for a case.
    warns : callable
        Numbers of the columns whose cells warn for a case.
    **marks
        Further fields of `Table`.

    Examples
    --------
    >>> figures = {Column('Axis', numeric=False): str.upper, Column('Code'): lambda x: str(ord(x))}
    >>> case_table('Axes', zip(['x', 'z']), figures).rows
    (('X', '120'), ('Z', '122'))
    """
    shown = list(cases)
    return Table(
        title,
        tuple(figures),
        tuple(tuple(cell(*case) for cell in figures.values()) for case in shown),
        warning=frozenset((row, at) for row, case in enumerate(shown) for at in warns(*case)),
        **marks,
    )


def tied(texts: Mapping[Key, str], best: Collection[Key]) -> list[Key]:
    """Return the keys whose text is that of one of the best: what looks equal is marked alike.

    Examples
    --------
    >>> tied({'mlp': '2.4', 'arma': '2.4', 'lag_ridge': '2.5'}, ['mlp'])
    ['mlp', 'arma']
    """
    shown = {texts[key] for key in best}
    return [key for key, text in texts.items() if text in shown]


def _escaped(text: str) -> str:
    return text.replace('\\', '\\\\').replace('|', '\\|').replace('\n', ' ')
