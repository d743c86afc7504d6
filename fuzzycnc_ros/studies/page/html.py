# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Pages from the templates of this package: self-contained, with their figures numbered."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.studies.page.requirement import require
from fuzzycnc_ros.studies.page.svg import to_inline_svg


@dataclass(frozen=True, eq=False)
class Figure:
    """A plot, what it shows, and what to look for."""

    title: str
    caption: str
    plot: Any


@dataclass(frozen=True)
class NumberedFigure:
    """A figure as it stands on a page."""

    number: int
    title: str
    caption: str
    svg: str

    @property
    def anchor(self) -> str:
        """Name to link to."""
        return f'figure-{self.number}'


def numbered(sections: Sequence[Sequence[Figure]]) -> list[list[NumberedFigure]]:
    """Return the figures of all sections, numbered through."""
    pages, number = [], 0
    for members in sections:
        figures = []
        for figure in members:
            number += 1
            svg = to_inline_svg(figure.plot, f'f{number}')
            figures.append(NumberedFigure(number, figure.title, figure.caption, svg))
        pages.append(figures)
    return pages


def render_template(name: str, **values: Any) -> str:
    """Fill a template in.

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
    # Control characters, also in figures, would go into the page as they are.
    return visible(environment.get_template(name).render(**values), keep='\n')


def _source(name: str) -> str:
    folder = files('fuzzycnc_ros.studies.page').joinpath('templates')
    return folder.joinpath(name).read_text(encoding='utf-8')
