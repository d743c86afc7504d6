# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What every part of `fuzzy_worth.py` returns: ways to do a job, each judged case by case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, isnan, nan
from statistics import median
from typing import Any

from fuzzycnc_ros.studies.page.table import Column, Table

FUZZY, LAW, PLAIN, NOTHING = 'fuzzy', 'plain law', 'baseline', 'nothing'
"""What stands in the place of the rules: they themselves, the law that takes their place with
all else the same, another method, nothing."""

EQUAL = 0.01
"""Figures that differ by no more than this share of themselves count as equal [-]."""


@dataclass(frozen=True)
class Way:
    """One way to do a job.

    Parameters
    ----------
    name : str
        What it is called.
    part : str
        `FUZZY`, `LAW`, `PLAIN` or `NOTHING`.
    figures : mapping of str to sequence of float
        By heading, one figure for each case, the less the better; infinite where it failed, NaN
        where it knows no such figure.
    counted : bool
        Whether the first figure may be held against that of others.
    """

    name: str
    part: str
    figures: Mapping[str, Sequence[float]]
    counted: bool = True


@dataclass(frozen=True)
class Part:
    """One system, or one axis of it, under several ways.

    Parameters
    ----------
    title : str
        What was done, with what is judged.
    cases : tuple of str
        What the figures are of, in their order.
    ways : tuple of Way
        The ways; against the first of the part `LAW` all are counted.
    notes : tuple of str
        What is to be known beside the figures.
    """

    title: str
    cases: tuple[str, ...]
    ways: tuple[Way, ...]
    notes: tuple[str, ...] = ()

    def table(self) -> Table:
        """Return minimum, median and maximum of each figure, and how often the law was beaten."""
        headings = tuple(self.ways[0].figures)
        columns = (
            Column('way', numeric=False),
            Column('rules', numeric=False),
            *map(Column, headings),
            Column('against the law'),
        )
        rows = tuple(
            (
                way.name,
                way.part,
                *(_spread(way.figures[heading]) for heading in headings),
                self._count(way),
            )
            for way in self.ways
        )
        return Table(f'{self.title} ({len(self.cases)} cases)', columns, rows)

    def document(self) -> dict[str, Any]:
        """Return all figures of all cases; failures and figures that there are not are null."""
        return {
            'title': self.title,
            'cases': list(self.cases),
            'notes': list(self.notes),
            'ways': [
                {
                    'name': way.name,
                    'rules': way.part,
                    'figures': {
                        heading: [value if isfinite(value) else None for value in values]
                        for heading, values in way.figures.items()
                    },
                }
                for way in self.ways
            ],
        }

    def _count(self, way: Way) -> str:
        """Return in how many cases the first figure is less, equal and more than the law's."""
        law = next(one for one in self.ways if one.part == LAW)
        if way is law or not way.counted:
            return '-'
        heading = next(iter(way.figures))
        better = equal = worse = 0
        for value, plain in zip(way.figures[heading], law.figures[heading], strict=True):
            if value == plain or abs(value - plain) <= EQUAL * plain < inf:
                equal += 1
            elif value < plain:
                better += 1
            else:
                worse += 1
        return f'{better} / {equal} / {worse}'


def _spread(values: Sequence[float]) -> str:
    """Return minimum, median and maximum; nothing where none is known."""
    known = [value for value in values if not isnan(value)]
    if not known:
        return ''
    return ' / '.join(map(_text, (min(known), median(known), max(known))))


def _text(value: float) -> str:
    """Return a figure in three digits."""
    if value == inf:
        return 'never'
    return f'{value:.3g}' if abs(value) < 1e3 else f'{value:,.0f}'


UNKNOWN = nan
"""Figure that a way does not know."""
