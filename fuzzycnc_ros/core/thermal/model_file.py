# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal models as files."""

import os
from pathlib import Path

from fuzzycnc_ros.core.thermal.document import ModelFileError
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.model_document import SIZE_MAX


def load_model(source: str | os.PathLike[str]) -> ThermalModel:
    """Return the model of a file, or of a text that `ThermalModel.to_json` returned.

    Parameters
    ----------
    source : str or path
        Path of a model file; a text that begins with a brace is taken for the document itself.

    Raises
    ------
    ModelFileError
        If the file cannot be read or is no usable model.

    Notes
    -----
    This is the one place where the core reads a file: a model is what users load by path.
    """
    if isinstance(source, str) and source.lstrip().startswith('{'):
        return ThermalModel.from_json(source)
    path = Path(source)
    try:
        with path.open(encoding='utf-8') as file:
            text = file.read(SIZE_MAX + 1)
    except (OSError, ValueError) as error:
        raise ModelFileError(f'{path}: expected a readable model file, but: {error}') from error
    try:
        return ThermalModel.from_json(text)
    except ModelFileError as error:
        raise ModelFileError(f'{path}: {error}') from error
