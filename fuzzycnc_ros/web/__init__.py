# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Web interface: the live page with its server, and uPlot's plots (vendor/uplot, MIT)."""

from importlib.resources import files


def vendored(name: str) -> str:
    """Return a vendored text file.

    Parameters
    ----------
    name : str
        Its path below `vendor`, such as `uplot/uPlot.min.css`.

    Raises
    ------
    FileNotFoundError
        If there is none of that name.
    """
    return files('fuzzycnc_ros.web').joinpath('vendor', name).read_text(encoding='utf-8')
