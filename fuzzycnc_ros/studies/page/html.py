# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Pages of sections with tables, remarks and figures, as self-contained HTML.

The page's own script draws the figures; they follow the light or dark theme and are zoomed into.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from itertools import count
from typing import Any, NamedTuple

from fuzzycnc_ros import __version__
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.studies.page.chart import Chart
from fuzzycnc_ros.studies.page.drawing import PALETTE
from fuzzycnc_ros.studies.page.table import Table
from fuzzycnc_ros.studies.requirement import require
from fuzzycnc_ros.web import vendored

HEADER = ('Recorded', 'Machine', 'Axis', 'Bag', 'Program', 'Judged')
"""Facts that stand at the top of a page, in this order."""

_SCRIPTS = ('gestures.js', 'charts.js')
"""Scripts for gestures and for drawing figures."""


class Remark(NamedTuple):
    """A sentence, and whether it warns."""

    text: str
    warning: bool = False


@dataclass(frozen=True, eq=False)
class Figure:
    """A plot, what it shows, and what to look for."""

    title: str
    caption: str
    plot: Chart


@dataclass(frozen=True)
class _NumberedFigure:
    """A figure as it stands on a page."""

    number: int
    title: str
    caption: str
    data: str

    @property
    def anchor(self) -> str:
        """Name to link to."""
        return f'figure-{self.number}'


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a page, in the order in which it is read.

    Parameters
    ----------
    heading : str
        Its heading.
    texts : sequence of str
        Paragraphs before the tables.
    judged : sequence of Remark
        What was judged and what of it calls for attention, shown behind the paragraphs.
    tables : sequence of Table
        Tables.
    remarks : sequence of str
        Remarks on the tables, such as what their marks mean.
    figures : sequence of Figure
        Figures.
    """

    heading: str
    texts: Sequence[str] = ()
    judged: Sequence[Remark] = ()
    tables: Sequence[Table] = ()
    remarks: Sequence[str] = ()
    figures: Sequence[Figure] = ()


@dataclass(frozen=True, eq=False)
class Page:
    """Everything on a page.

    Parameters
    ----------
    title : str
        Headline.
    summary : str
        One or two sentences under it.
    sections : sequence of Section
        Its parts.
    facts : mapping of str to str
        Provenance, shown as a table; those of `HEADER` stand at the top of the page instead.
    notes : sequence of str
        What is to be known of the whole page.
    template : str
        Template of its body, if it has more than its sections.
    values : mapping of str to object
        What that shows besides.
    """

    title: str
    summary: str
    sections: Sequence[Section]
    facts: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    template: str = 'sections.html'
    values: Mapping[str, Any] = field(default_factory=dict)


def render_page(page: Page) -> str:
    """Render a page as self-contained HTML; the same page gives the same text.

    Raises
    ------
    ModuleNotFoundError
        If jinja2 is not installed; the message says how to install it.
    """
    jinja2 = require('jinja2')
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=jinja2.FunctionLoader(_source),
    )
    sections = _with_numbers(page.sections)
    header = {name: page.facts[name] for name in HEADER if name in page.facts}
    figures = [figure for section in sections for figure in section.figures]
    text = environment.get_template(page.template).render(
        title=page.title,
        name=re.sub(r'[^a-z0-9]+', '-', page.title.lower()).strip('-'),
        palette=PALETTE,
        style=vendored('uplot/uPlot.min.css') if figures else '',
        scripts=[vendored('uplot/uPlot.iife.min.js'), *map(_source, _SCRIPTS)] if figures else [],
        header={**header, 'fuzzycnc': __version__},
        summary=page.summary,
        sections=sections,
        figures=figures,
        facts={name: fact for name, fact in page.facts.items() if name not in header},
        notes=page.notes,
        **page.values,
    )
    # Control characters, also in figures, would go into the page as they are.
    return visible(text, keep='\n')


def _source(name: str) -> str:
    folder = files('fuzzycnc_ros.studies.page').joinpath('templates')
    return folder.joinpath(name).read_text(encoding='utf-8')


def _with_numbers(sections: Sequence[Section]) -> list[Section]:
    """Return sections with their figures numbered through."""
    numbered, numbers = [], count(1)
    for section in sections:
        figures: list[Any] = [
            _NumberedFigure(
                next(numbers), figure.title, figure.caption, _script_text(figure.plot.document())
            )
            for figure in section.figures
        ]
        numbered.append(replace(section, figures=figures))
    return numbered


def _script_text(document: Any) -> str:
    """Return a document as JSON that may stand in a script element."""
    text = json.dumps(document, ensure_ascii=False, separators=(',', ':'), allow_nan=False)
    return text.replace('<', '\\u003c')
