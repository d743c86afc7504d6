# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A page of sections, each with its tables, remarks and figures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from fuzzycnc_ros.report.html import Figure, numbered, render_template
from fuzzycnc_ros.report.table import Table


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a page, in the order in which it is read.

    Parameters
    ----------
    heading : str
        Its heading.
    texts : sequence of str
        Paragraphs before the tables.
    tables : sequence of Table
        Tables.
    remarks : sequence of str
        Remarks on the tables, such as what their marks mean.
    figures : sequence of Figure
        Figures.
    """

    heading: str
    texts: Sequence[str] = ()
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
        Provenance, shown as a table.
    """

    title: str
    summary: str
    sections: Sequence[Section]
    facts: Mapping[str, str] = field(default_factory=dict)


def render_page(page: Page) -> str:
    """Render a page as self-contained HTML; the same page gives the same text.

    Raises
    ------
    ModuleNotFoundError
        If matplotlib or jinja2 is not installed; the message says how to install it.
    """
    figures: list[list[Any]] = [*numbered([section.figures for section in page.sections])]
    sections = [
        replace(section, figures=drawn)
        for section, drawn in zip(page.sections, figures, strict=True)
    ]
    return render_template(
        'sections.html',
        title=page.title,
        summary=page.summary,
        sections=sections,
        facts=page.facts,
        notes=(),
    )
