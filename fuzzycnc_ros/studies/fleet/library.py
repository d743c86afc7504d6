# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Libraries that only a fleet needs: loaded on use, named with their remedy when missing."""

from importlib import import_module
from typing import Any


def fleet_library(module: str) -> Any:
    """Import a module of pyarrow or Dask.

    Parameters
    ----------
    module : str
        Dotted name of the module, such as `pyarrow.parquet`.

    Raises
    ------
    ModuleNotFoundError
        If the library is not installed; the message says how to install it.
    """
    package = module.partition('.')[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition('.')[0] != package:
            raise  # the library is there, something that it needs is not
        raise ModuleNotFoundError(
            f'a fleet of bags needs {package}, which is not installed: '
            "pip install 'fuzzycnc_ros[fleet]'",
            name=package,
        ) from error
