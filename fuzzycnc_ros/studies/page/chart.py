# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A figure declared once: its data with names, units and colours by meaning.

Pages draw a `Chart` by uPlot (`charts.js` beside the templates), which also gives its CSV file.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import floor, isfinite, log10
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.studies.page.drawing import THEME

Floats = NDArray[np.float64]

ROWS_MAX, NUMBERS_MAX, ROWS_MIN = 1500, 20_000, 400
"""Rows of a panel that a page holds at most, and fewer where it has many series; of more, the
extremes of stretches are kept."""

DOTS_MAX = 140
"""Dots of a series that are drawn at a time; the rest shows when a reader zooms in."""

_DIGITS = 4
"""Digits that the range of a series is told apart in, about."""


@dataclass(frozen=True)
class Axis:
    """Quantity and range of an axis.

    Parameters
    ----------
    name, unit : str
        What it shows, and its unit; empty if it has none.
    scale : {'linear', 'log', 'symlog'}
        Its scale.
    linear_to : float
        Size up to which a 'symlog' scale is linear.
    low, high : float, optional
        Ends that hold whatever the data are; what lies beyond leaves the picture.
    ticks : tuple of float
        Where it is marked; where it reads best if empty.
    """

    name: str
    unit: str = ''
    scale: Literal['linear', 'log', 'symlog'] = 'linear'
    linear_to: float = 1.0
    low: float | None = None
    high: float | None = None
    ticks: tuple[float, ...] = ()

    @property
    def label(self) -> str:
        """Name and unit in one line."""
        return f'{self.name} [{self.unit}]' if self.unit else self.name


@dataclass(frozen=True, eq=False)
class Series:
    """Values over the x axis of a panel.

    Parameters
    ----------
    name : str
        What they are.
    y : array_like, shape (n,)
        Values in the unit of the panel's y axis; NaN leaves a gap.
    colour : str
        One of the colours by meaning of `fuzzycnc_ros.studies.page.drawing`, or any.
    width : float
        Width of the line [pt].
    dashes : tuple of float
        Lengths of strokes and gaps [pt]; a whole line if empty.
    kind : {'line', 'steps', 'dots', 'both', 'flag'}
        A line, one that holds each value until the next, dots, dots on a line, or a bar at the
        bottom where the value is not 0.
    x : array_like, shape (n,), optional
        Its own x, not falling; those of the panel if absent.
    quiet : bool
        Whether it is one of many in the background: drawn thin and left out of the legend.
    text : sequence of str, length n
        What stands beside each dot.
    level : array_like, shape (n,), optional
        Values that colour a path by the shades of its panel, each the piece that ends there.
    """

    name: str
    y: Floats
    colour: str
    width: float = 1.4
    dashes: tuple[float, ...] = ()
    kind: Literal['line', 'steps', 'dots', 'both', 'flag'] = 'line'
    x: Floats | None = None
    quiet: bool = False
    text: Sequence[str] = ()
    level: Floats | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, 'y', _finite(self.y))
        if self.x is not None:
            object.__setattr__(self, 'x', np.asarray(self.x, dtype=np.float64))
        if self.level is not None:
            object.__setattr__(self, 'level', _finite(self.level))
        if self.kind == 'line' and _alone(self.y):
            object.__setattr__(self, 'kind', 'dots')


@dataclass(frozen=True, eq=False)
class Band:
    """An area between two courses over the x of a panel, in the unit of its y axis."""

    name: str
    low: Floats
    high: Floats
    colour: str

    def __post_init__(self) -> None:
        object.__setattr__(self, 'low', _finite(self.low))
        object.__setattr__(self, 'high', _finite(self.high))


@dataclass(frozen=True)
class Rule:
    """A straight line across a panel, such as a limit; its name stands beside it, if it has one.

    Parameters
    ----------
    at : float
        Where it crosses the y axis, or the x axis if `upright`.
    colour : str
        Its colour.
    name : str
        What it stands for.
    dashes : tuple of float
        Lengths of strokes and gaps [pt]; a whole line if empty.
    upright : bool
        Whether it is a value of x.
    """

    at: float
    colour: str
    name: str = ''
    dashes: tuple[float, ...] = ()
    upright: bool = False


@dataclass(frozen=True)
class Span:
    """A stretch of the x axis that is shaded behind all else, such as a phase.

    Parameters
    ----------
    low, high : float
        Its ends.
    colour : str
        Its colour.
    name : str
        What it is; stands in it, at the top.
    """

    low: float
    high: float
    colour: str
    name: str = ''


@dataclass(frozen=True)
class Shades:
    """Colours of the levels of a path.

    Parameters
    ----------
    axis : Axis
        Name and unit of the levels.
    stops : sequence of (float, str)
        Levels, not falling, and their colours; between them colours are mixed.
    mark : (float, str), optional
        A level that is marked, such as a tolerance, and its name.
    """

    axis: Axis
    stops: Sequence[tuple[float, str]]
    mark: tuple[float, str] | None = None


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes.

    Parameters
    ----------
    x : array_like, shape (n,)
        Values of the x axis, not falling.
    y_axis : Axis
        What its y axis shows.
    series : sequence of Series
        What is drawn, from the back to the front.
    title : str
        What stands above it.
    bands : sequence of Band
        Areas behind the series.
    rules : sequence of Rule
        Straight lines.
    spans : sequence of Span
        Stretches of x that are shaded.
    share : float
        Its height, where panels of a column differ.
    plane : float
        Scale of y over that of x where the panel shows places in a plane, and each series has an
        x of its own in any order; 0 where x and y have scales of their own.
    shades : Shades, optional
        Colours of paths in a plane that have levels.
    true_scale : bool
        Whether a plane, in mm, is shown and printed in its own size.
    """

    x: Floats
    y_axis: Axis
    series: Sequence[Series]
    title: str = ''
    bands: Sequence[Band] = ()
    rules: Sequence[Rule] = ()
    spans: Sequence[Span] = ()
    share: float = 1.0
    plane: float = 0.0
    shades: Shades | None = None
    true_scale: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, 'x', np.asarray(self.x, dtype=np.float64))
        for item in self.series:
            x = self.x if item.x is None else item.x
            if len(x) != len(item.y):
                raise ValueError(
                    f'series {item.name!r} of panel {self.title!r}: expected {len(x)} values, as '
                    f'many as there are of x, but found {len(item.y)}'
                )

    def thinned(self, most: int) -> 'Panel':
        """Return the panel with no more than about `most` of its rows.

        Of every stretch the rows stay in which a series is least or largest, and those at gaps.
        So they do of each series with an x of its own.
        """
        columns = [item.y for item in self.series if item.x is None]
        columns += [side for band in self.bands for side in (band.low, band.high)]
        keep = np.arange(len(self.x))
        if columns:
            keep = kept_rows(np.column_stack(columns), most)
        return replace(
            self,
            x=self.x[keep],
            series=[
                replace(item, y=item.y[keep]) if item.x is None else _thinned(item, most)
                for item in self.series
            ],
            bands=[replace(band, low=band.low[keep], high=band.high[keep]) for band in self.bands],
        )


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels over one kind of x axis.

    Parameters
    ----------
    x_axis : Axis
        What their x axes show.
    panels : sequence of Panel
        The panels, row by row.
    columns : int
        How many stand in a row.
    height : float
        Height of a panel [in].
    """

    x_axis: Axis
    panels: Sequence[Panel]
    columns: int = 1
    height: float = 3.0

    def __post_init__(self) -> None:
        object.__setattr__(self, 'panels', tuple(self.panels))

    @property
    def linked(self) -> bool:
        """True if all panels show the same stretch of x, so that zooming into one zooms all."""
        ends = {(float(p.x[0]), float(p.x[-1])) if len(p.x) else None for p in self.panels}
        return len(self.panels) > 1 and len(ends) == 1 and not any(p.plane for p in self.panels)

    def document(self) -> dict[str, Any]:
        """Return all that a browser needs to draw it, as JSON has it."""
        return {
            'x': _axis_document(self.x_axis),
            'columns': self.columns,
            'height': self.height,
            'linked': self.linked,
            'panels': [
                _plane_document(panel, self.x_axis)
                if panel.plane
                else _panel_document(panel, self.x_axis)
                for panel in self.panels
            ],
        }


def kept_rows(values: ArrayLike, most: int) -> NDArray[np.intp]:
    """Return the rows of a table that show its course, no more than about `most`.

    The rows are cut into stretches, as many as the number allows.  Of each the rows stay in which
    a column is least or largest; of a gap its first row.

    Parameters
    ----------
    values : array_like, shape (n, k)
        Columns; NaN where one has a gap.
    most : int
        How many rows may stay.

    Returns
    -------
    ndarray of int
        Rows, increasing; the first and the last are among them.

    Examples
    --------
    >>> import numpy as np
    >>> wave = np.sin(np.linspace(0.0, 9.0, 1000))[:, np.newaxis]
    >>> rows = kept_rows(wave, 50)
    >>> len(rows) <= 50, bool(wave[rows].max() == wave.max())
    (True, True)
    """
    table = np.asarray(values, dtype=np.float64)
    count = len(table)
    if count <= most:
        return np.arange(count)
    missing = np.isnan(table)
    begins = np.flatnonzero((missing[1:] & ~missing[:-1]).any(axis=1)) + 1
    gaps = begins if len(begins) <= most // 4 else begins[:0]
    room = max(most - len(gaps), 4)
    stretches = room
    while True:
        rows = _extremes(table, missing, stretches)
        if len(rows) <= room or stretches <= 1:
            return np.union1d(rows, gaps)
        stretches = max(1, min(stretches - 1, int(0.9 * stretches * room / len(rows))))


def _thinned(item: Series, most: int) -> Series:
    """Return a series with an x of its own with no more than about `most` of its rows."""
    if item.x is None or item.text:
        return item
    keep = kept_rows(item.y[:, np.newaxis], most)
    return replace(item, x=item.x[keep], y=item.y[keep])


def _extremes(table: Floats, missing: NDArray[np.bool_], stretches: int) -> NDArray[np.intp]:
    """Return the first and last row, and those of the extremes of each stretch."""
    count = len(table)
    length = -(-count // stretches)
    short = -(-count // length) * length - count
    first = np.arange(0, count, length)[:, np.newaxis]
    found = [np.array([0, count - 1])]
    for sign in (1.0, -1.0):
        filled = np.where(missing, np.inf, sign * table)
        filled = np.pad(filled, ((0, short), (0, 0)), constant_values=np.inf)
        least = filled.reshape(-1, length, table.shape[1]).argmin(axis=1) + first
        found.append(np.minimum(least, count - 1).ravel())
    return np.unique(np.concatenate(found))


def _finite(values: ArrayLike) -> Floats:
    """Return values with gaps where they are no numbers."""
    array = np.asarray(values, dtype=np.float64)
    return np.where(np.isfinite(array), array, np.nan)


def _alone(values: Floats) -> bool:
    """Return whether most values have gaps on both sides, so that no line joins them."""
    known = np.isfinite(values)
    if known.all() or not known.any():
        return False
    beside = np.concatenate([[False], known, [False]])
    return bool((known & ~beside[:-2] & ~beside[2:]).sum() > 0.5 * known.sum())


def _plane_document(panel: Panel, x_axis: Axis) -> dict[str, Any]:
    series = [
        {
            'name': item.name,
            'colour': shown_colour(item.colour),
            'width': item.width,
            'kind': item.kind,
            'x': _encoded(_finite(item.x if item.x is not None else panel.x), x_axis),
            'y': _encoded(item.y, panel.y_axis),
            'level': None if item.level is None else _encoded(item.level, Axis('')),
        }
        for item in panel.series
    ]
    document = {
        'title': panel.title,
        'share': panel.share,
        'plane': panel.plane,
        'true_scale': panel.true_scale,
        'y': _axis_document(panel.y_axis),
        'series': series,
    }
    if panel.shades is not None:
        document['shades'] = {
            'axis': _axis_document(panel.shades.axis),
            'stops': [[level, shown_colour(colour)] for level, colour in panel.shades.stops],
            'mark': panel.shades.mark,
        }
    return document


def _panel_document(panel: Panel, x_axis: Axis) -> dict[str, Any]:
    total = _rows(panel)
    most = NUMBERS_MAX // max(1, len(panel.series))
    panel = panel.thinned(max(ROWS_MIN, min(ROWS_MAX, most)))
    kept = _rows(panel)
    # Each x of its own gets rows of its own: what is equal in one series may differ in another.
    own = [item.x for item in panel.series if item.x is not None]
    x = np.concatenate([panel.x, *own])
    order = np.argsort(x, kind='stable')
    begin = len(panel.x)
    series = []
    for item in panel.series:
        first = 0
        if item.x is not None:
            first, begin = begin, begin + len(item.x)
        series.append(
            {
                'name': item.name,
                'colour': shown_colour(item.colour),
                'width': item.width,
                'dashes': list(item.dashes),
                'kind': item.kind,
                'quiet': item.quiet,
                'joined': bool(own),
                'y': _encoded(_placed(item.y, first, order), panel.y_axis),
                'text': _placed_text(item.text, first, order) if item.text else [],
            }
        )
    document: dict[str, Any] = {
        'title': panel.title,
        'share': panel.share,
        'y': _axis_document(panel.y_axis),
        'x': _encoded(x[order], x_axis, np.diff(x[order])),
        'series': series,
        'bands': [
            {
                'name': band.name,
                'colour': shown_colour(band.colour),
                'low': _encoded(_placed(band.low, 0, order), panel.y_axis),
                'high': _encoded(_placed(band.high, 0, order), panel.y_axis),
            }
            for band in panel.bands
        ],
        'rules': [
            {
                'at': rule.at,
                'colour': shown_colour(rule.colour),
                'name': rule.name,
                'dashes': list(rule.dashes),
                'upright': rule.upright,
            }
            for rule in panel.rules
        ],
        'spans': [
            {
                'low': span.low,
                'high': span.high,
                'colour': shown_colour(span.colour),
                'name': span.name,
            }
            for span in panel.spans
        ],
    }
    if kept < total:
        document['kept'] = [kept, total]
    return document


def _rows(panel: Panel) -> int:
    return max(len(panel.x), *(0 if item.x is None else len(item.x) for item in panel.series), 0)


def shown_colour(colour: str) -> str:
    """Return the style sheet's variable of a colour that has one, else the colour."""
    return THEME.get(colour, colour)


def _placed(values: Floats, first: int, order: NDArray[np.intp]) -> Floats:
    """Return the values of rows from `first` on where the rows stand by x."""
    rows = np.full(len(order), np.nan)
    rows[first : first + len(values)] = values
    return rows[order]


def _placed_text(texts: Sequence[str], first: int, order: NDArray[np.intp]) -> list[str]:
    rows = [''] * len(order)
    rows[first : first + len(texts)] = texts
    return [rows[index] for index in order]


def _axis_document(axis: Axis) -> dict[str, Any]:
    return {
        'name': axis.name,
        'unit': axis.unit,
        'label': axis.label,
        'scale': axis.scale,
        'linear_to': axis.linear_to,
        'low': axis.low,
        'high': axis.high,
        'ticks': list(axis.ticks),
    }


def _encoded(values: Floats, axis: Axis, steps: Floats | None = None) -> dict[str, Any]:
    """Return values as whole multiples of a decimal place, each less the one before it.

    Most take two or three characters then.  None stands for a gap.
    """
    decimals = _decimals(values, axis, steps)
    whole = np.round(values * 10.0**decimals)
    known = np.isfinite(whole)
    parts = np.diff(whole[known], prepend=0.0)
    if known.all():
        return {'decimals': decimals, 'steps': [int(part) for part in parts]}
    remaining = iter(parts)
    return {
        'decimals': decimals,
        'steps': [int(next(remaining)) if there else None for there in known],
    }


def _decimals(values: Floats, axis: Axis, steps: Floats | None) -> int:
    """Return the decimal place that tells values, or what they step by, well apart."""
    known = np.abs(values[np.isfinite(values)])
    if not known.size:
        return 0
    if steps is not None:
        apart = np.abs(steps[steps != 0.0])
        finest = 1e-2 * float(apart.min()) if apart.size else float(known.max())
    elif axis.scale == 'log':
        finest = 10.0**-_DIGITS * float(known[known > 0.0].min(initial=np.inf))
    elif axis.scale == 'symlog':
        finest = 1e-2 * axis.linear_to
    else:
        spread = float(np.ptp(values[np.isfinite(values)]))
        finest = 10.0**-_DIGITS * (spread or float(known.max()))
    # No more digits than the numbers themselves have.
    finest = max(finest, 1e-12 * float(known.max()))
    return -floor(log10(finest)) if isfinite(finest) and finest > 0.0 else 0
