# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A page of sections, each with its tables, remarks and figures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from fuzzycnc_ros.studies.page.html import Figure, numbered, render_template
from fuzzycnc_ros.studies.page.remark import Remark
from fuzzycnc_ros.studies.page.table import Table


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
    return render_template(
        'sections.html',
        title=page.title,
        summary=page.summary,
        sections=with_numbers(page.sections),
        facts=page.facts,
        notes=(),
    )


def with_numbers(sections: Sequence[Section]) -> list[Section]:
    """Return sections with their figures drawn and numbered through."""
    figures: list[list[Any]] = [*numbered([section.figures for section in sections])]
    return [
        replace(section, figures=drawn) for section, drawn in zip(sections, figures, strict=True)
    ]
