# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Packages that only reports need: loaded on use, named with their remedy when missing."""

from importlib import import_module
from typing import Any

_DEBIAN = {
    'matplotlib': 'python3-matplotlib',
    'jinja2': 'python3-jinja2',
    'rich': 'python3-rich',
}


def require(module: str) -> Any:
    """Import a module of matplotlib, jinja2 or rich.

    Parameters
    ----------
    module : str
        Dotted name of the module, such as `matplotlib.figure`.

    Raises
    ------
    ModuleNotFoundError
        If the package is not installed; the message says how to install it.
    """
    package = module.partition('.')[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition('.')[0] != package:
            raise  # the package is there, something that it needs is not
        raise ModuleNotFoundError(
            f'a report needs {package}, which is not installed: '
            f"pip install 'fuzzycnc_ros[report]' (or apt install {_DEBIAN[package]})",
            name=package,
        ) from error
