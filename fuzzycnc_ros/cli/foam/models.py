# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Model files of feed compensation, as the commands read them."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fuzzycnc_ros.core.deformation.model import DeformationModel


def read_model_file(path: Path) -> 'DeformationModel':
    """Return the model of a file.

    Raises
    ------
    ValueError
        If there is none, or it is no model.
    """
    from fuzzycnc_ros.core.deformation.model import read_model

    if not path.is_file():
        raise ValueError(f'{path}: expected a model file but found none')
    try:
        return read_model(path.read_text(encoding='utf-8'))
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error
