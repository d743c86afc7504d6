# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Libraries that are loaded on use, so that nodes start without them."""

from functools import cache
from importlib import import_module
from typing import Any

from fuzzycnc_ros.bags.errors import MissingLibraryError

_DISTRIBUTION = {'yaml': 'PyYAML', 'lz4': 'lz4', 'zstandard': 'zstandard'}


@cache
def load(module: str) -> Any:
    """Import a module of an optional library.

    Parameters
    ----------
    module : str
        Dotted module name, for example `mcap.writer`.

    Raises
    ------
    MissingLibraryError
        If the library is not installed; the message names the remedy.
    """
    try:
        return import_module(module)
    except ImportError as error:
        root = module.split('.')[0]
        raise MissingLibraryError(
            f'expected the Python library {_DISTRIBUTION.get(root, root)} but it is not installed '
            f"({error}); install it with: pip install 'fuzzycnc_ros[bags]'"
        ) from error
