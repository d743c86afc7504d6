# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Packages that not everybody needs: loaded on use, named with their remedy when missing."""

import logging
from importlib import import_module
from typing import Any

_REPORT, _FLEET = ('a report', 'report'), ('a fleet of bags', 'fleet')
_DESIGN, _CAMERA = ('a design', 'designs'), ('a photograph', 'camera')
_NEEDED_BY = {
    'matplotlib': _REPORT,
    'jinja2': _REPORT,
    'rich': _REPORT,
    'pyarrow': _FLEET,
    'distributed': _FLEET,
    'pyembroidery': _DESIGN,
    'svgelements': _DESIGN,
    'ezdxf': _DESIGN,
    'cv2': _CAMERA,
}
"""Use of each package, and the extra that brings it."""
_DEBIAN = {
    'matplotlib': 'python3-matplotlib',
    'jinja2': 'python3-jinja2',
    'rich': 'python3-rich',
}


def require(module: str) -> Any:
    """Import a module of a package that an extra brings.

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
    if package == 'matplotlib':
        # It warns where it has no home folder to keep its list of fonts in, and goes on.
        logging.getLogger(package).setLevel(logging.ERROR)
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition('.')[0] != package:
            raise  # the package is there, something that it needs is not
        who, extra = _NEEDED_BY[package]
        debian = f' (or apt install {_DEBIAN[package]})' if package in _DEBIAN else ''
        raise ModuleNotFoundError(
            f'{who} needs {package}, which is not installed: '
            f"pip install 'fuzzycnc_ros[{extra}]'{debian}",
            name=package,
        ) from error
