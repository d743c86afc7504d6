# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Figures as SVG text that can stand in an HTML page and follows its light or dark theme."""

import re
import warnings
from io import StringIO
from typing import Any

from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.studies.page.drawing import ACCENT, FAINT, GRID, INK, MUTED, plot_style
from fuzzycnc_ros.studies.page.requirement import require

_THEME = {
    INK: '--ink',
    MUTED: '--muted',
    FAINT: '--faint',
    GRID: '--grid',
    ACCENT: '--accent',
}
_DECIMALS = re.compile(r'(\d\.\d\d)\d+')
_IDENTITY = re.compile(r'(\bid="|url\(#|xlink:href="#)')
_SIZE = re.compile(r' width="[^"]*" height="[^"]*"| height="[^"]*" width="[^"]*"')


def to_inline_svg(figure: Any, name: str) -> str:
    """Return a figure as an SVG element for an HTML page.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure of this package's plots.
    name : str
        Name that is unique on the page; prefixes every id, since matplotlib gives the same
        ids to every figure.

    Returns
    -------
    str
        SVG element without size, so that the page sets its width; neutral colours and the
        accent are the page's CSS variables, numbers have two decimals.
    """
    stream = StringIO()
    for item in figure.findobj(require('matplotlib.text').Text):
        shown = visible(item.get_text(), keep='\n')
        if shown != item.get_text():
            item.set_text(shown)
    with plot_style(), warnings.catch_warnings():
        # The page's fonts show the text; matplotlib only measures it by its own.
        warnings.filterwarnings('ignore', 'Glyph .* missing from font')
        figure.savefig(stream, format='svg', metadata={'Date': None, 'Creator': None})
    text = stream.getvalue()
    svg = text[text.index('<svg') :]
    head, body = svg.split('>', 1)
    svg = _SIZE.sub('', head) + '>' + re.sub(r'<metadata>.*?</metadata>', '', body, flags=re.S)
    for colour, variable in _THEME.items():
        svg = svg.replace(colour, f'var({variable})')
    return _IDENTITY.sub(rf'\g<1>{name}-', _DECIMALS.sub(r'\1', svg)).strip()
