# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Soft material: learn how a sheet gives way, and compensate a pattern before it is sewn.

Examples
--------
>>> from fuzzycnc_ros import soft
>>> from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
>>> model = soft.train(*foam_samples(0), random_state=0)
>>> line = soft.Primitive((0.02, 0.06), (0.12, 0.06), depth=0.006, step=0.003)
>>> found = soft.compensate([line], model, soft.SheetMaterial(0.02))
>>> found.commanded.shape
(34, 2)
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from fuzzycnc_ros.core.deformation import model as models
from fuzzycnc_ros.core.deformation.compensation import (
    CompensatedPath,
    CompensationConfig,
    compensate_path,
)
from fuzzycnc_ros.core.deformation.model import DeformationModel
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.stitch_path import Primitive, SheetMaterial, StitchPath

__all__ = [
    'CompensationConfig',
    'DeformationModel',
    'Primitive',
    'SheetMaterial',
    'StitchPath',
    'TSFuzzyNetwork',
    'compensate',
    'read_model',
    'train',
]


def train(x: ArrayLike, s: ArrayLike, **options: Any) -> DeformationModel:
    """Train the T-S fuzzy neural network on samples of stitched lines and arcs.

    Parameters
    ----------
    x : array_like, shape (n, 5)
        Process values: direction [deg], feed depth [mm], type (1 arc, 2 line), stitch step [mm],
        thickness [mm].
    s : array_like, shape (n, 2)
        Compensations along X and Y [mm per 50 mm of feed].
    **options
        Parameters of `TSFuzzyNetwork`, such as `random_state`.

    Raises
    ------
    ValueError
        If there are too few samples, or a value is not finite.
    """
    return TSFuzzyNetwork(**options).fit(x, s).model_


def read_model(path: str | os.PathLike[str]) -> DeformationModel:
    """Return the model of a file that `fuzzycnc foam train` wrote.

    Raises
    ------
    OSError
        If the file cannot be read.
    ModelFileError
        If it is no usable model.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from fuzzycnc_ros import soft
    >>> from fuzzycnc_ros.core.deformation.model import write_model
    >>> from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
    >>> model = soft.train(*foam_samples(0), random_state=0)
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / 'foam.json'
    ...     _ = path.write_text(write_model(model))
    ...     again = soft.read_model(path)
    >>> type(again).__name__
    'DeformationModel'
    """
    return models.read_model(Path(path).read_text(encoding='utf-8'))


def compensate(
    pattern: StitchPath | Iterable[Primitive],
    model: DeformationModel,
    material: SheetMaterial,
    config: CompensationConfig | None = None,
) -> CompensatedPath:
    """Shift a pattern so that the relaxed sheet shows the nominal one.

    Parameters
    ----------
    pattern : StitchPath or iterable of Primitive
        Nominal stitches, or the lines and arcs that they are on.
    model : DeformationModel
        Steps outside its domain are given no compensation, and flagged.
    material : SheetMaterial
        The sheet.
    config : CompensationConfig, optional
        Limits of the offsets.

    Returns
    -------
    CompensatedPath
        Commanded points [m], offsets [m], flags and support.

    Raises
    ------
    ValueError
        If a nominal point lies off the sheet, or the foot would go through it.

    Examples
    --------
    >>> import numpy as np
    >>> from fuzzycnc_ros import soft
    >>> from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
    >>> model = soft.train(*foam_samples(0), random_state=0)
    >>> line = soft.Primitive((0.02, 0.06), (0.12, 0.06), depth=0.006, step=0.003)
    >>> found = soft.compensate([line], model, soft.SheetMaterial(0.02))
    >>> bool(np.abs(found.commanded - found.nominal).max() > 1e-4)
    True
    """
    path = pattern if isinstance(pattern, StitchPath) else StitchPath.of_primitives(pattern)
    return compensate_path(
        path, material, model.predict, config=config, gate=model, support=model.support
    )
