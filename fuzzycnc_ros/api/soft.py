# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Soft material: learn how a sheet gives way, and compensate a pattern before it is sewn.

Examples
--------
>>> from fuzzycnc_ros import soft
>>> from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
>>> model = soft.train(*foam_samples(0), method='ridge')
>>> line = soft.Primitive((0.02, 0.06), (0.12, 0.06), depth=0.006, step=0.003)
>>> found = soft.compensate([line], model, soft.SheetMaterial(0.02))
>>> found.commanded.shape
(34, 2)
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import check_matrix
from fuzzycnc_ros.core.deformation.compensation import (
    LEARNING_GAIN,
    CompensationConfig,
    OffsetPath,
)
from fuzzycnc_ros.core.deformation.model import DeformationModel
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.offset_file import StitchOffsets
from fuzzycnc_ros.core.deformation.soft_model import (
    SoftModel,
    compensated,
    read_soft_model,
    write_soft_model,
)
from fuzzycnc_ros.core.deformation.stitch_path import Primitive, SheetMaterial, StitchPath
from fuzzycnc_ros.core.encodings import decoded
from fuzzycnc_ros.files.atomic import write_text
from fuzzycnc_ros.studies.soft.foam_learning import learn_track
from fuzzycnc_ros.studies.soft.foam_records import array_samples, recorded_run
from fuzzycnc_ros.studies.soft.foam_training import AUTO, train_model

__all__ = [
    'CompensationConfig',
    'DeformationModel',
    'Primitive',
    'SheetMaterial',
    'StitchOffsets',
    'StitchPath',
    'TSFuzzyNetwork',
    'compensate',
    'learn',
    'read_model',
    'save_model',
    'train',
]

EXTENT_MAX = 20.0
"""Extent of a pattern that is likely [m]."""


def train(
    x: ArrayLike,
    s: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    method: str = AUTO,
    **options: Any,
) -> DeformationModel:
    """Train a model of feed compensation on samples of stitched lines and arcs.

    Like `fuzzycnc soft train`: no correction, ridge regression, a Gaussian process and the T-S
    fuzzy neural network compete on samples that are held out; samples that contradict the others
    are left out.  What is doubtful is a warning.

    Parameters
    ----------
    x : array_like, shape (n, 5)
        Process values: direction [deg], feed depth [mm], type (1 arc, 2 line), stitch step [mm],
        thickness [mm].
    s : array_like, shape (n, 2)
        Compensations along X and Y [mm per 50 mm of feed].
    groups : array_like, shape (n,), optional
        Sheet of each sample: those of one sheet are held out together.
    method : str
        `auto`, or one of `none`, `ridge`, `gaussian_process` and `network`.
    **options
        Parameters of `TSFuzzyNetwork`, such as `random_state`.

    Raises
    ------
    ValueError
        If there are too few samples, a value is not finite, or lengths are not in millimetres.
    """
    samples = array_samples(x, s, groups)
    found = train_model(samples, options, method)
    doubts = [line.removeprefix('note: ') for line in (*samples.lines, *found.notes)]
    for text in doubts:
        warnings.warn(text, stacklevel=2)
    return found.model


def learn(
    commanded: ArrayLike,
    stitched: ArrayLike,
    material: SheetMaterial,
    offset: ArrayLike | None = None,
    *,
    path_id: str = 'track',
    gain: float = LEARNING_GAIN,
) -> StitchOffsets:
    """Learn the offsets of one track from recorded runs of it, like `fuzzycnc soft learn`.

    Parameters
    ----------
    commanded : array_like, shape (n + 1, 2)
        Commanded points, offsets included [m].
    stitched : array_like, shape (n + 1, 2) or (runs, n + 1, 2)
        Where the stitches of one run or of several lie [m].
    material : SheetMaterial
        The sheet.
    offset : array_like, shape (n + 1, 2), optional
        Offsets that the runs had [m]; none without it.
    path_id : str
        Name of the track, as in its pattern.
    gain : float
        Share of the deviation to be taken away [-].

    Returns
    -------
    StitchOffsets
        Offsets of the next run; those of the recorded ones where no deformation is beyond chance,
        which a warning says.

    Raises
    ------
    ValueError
        If the points are not finite, not parallel, or do not lie as stitches do.

    Examples
    --------
    >>> import numpy as np
    >>> from fuzzycnc_ros import soft
    >>> from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
    >>> points = np.column_stack([np.arange(0.02, 0.1, 0.003), np.full(27, 0.05)])
    >>> stitched = FoamSheet(0.015).stitch(points, 0.006)
    >>> offsets = soft.learn(points, stitched, soft.SheetMaterial(0.015), gain=1.0)
    >>> bool(np.abs(points + offsets.offset - stitched).max() > 1e-3)
    True
    """
    points = check_matrix(commanded, 'commanded')
    runs = np.asarray(stitched, float)
    runs = runs[np.newaxis] if runs.ndim == 2 else runs
    before = np.zeros_like(points) if offset is None else check_matrix(offset, 'offset')
    for name, shape in (('stitched', runs.shape[1:]), ('offset', before.shape)):
        if shape != points.shape or points.shape[1] != 2:
            raise ValueError(
                f'{name}: expected points parallel to commanded, shape (n + 1, 2), but found '
                f'{shape} beside {points.shape}'
            )
    if not np.isfinite(runs).all():
        raise ValueError('stitched: expected finite points [m] but found some that are not')
    recorded = [
        recorded_run(
            points, run, before, path_id=path_id, material=material, source=f'run {number}',
            places=[f'point {place}' for place in range(len(points))],
        )
        for number, run in enumerate(runs)
    ]  # fmt: skip
    found = learn_track(recorded, None, gain)
    for text in found.doubts():
        warnings.warn(text, stacklevel=2)
    return found.offsets


def read_model(path: str | os.PathLike[str]) -> SoftModel:
    """Return what a file of `save_model`, `fuzzycnc soft train` or `soft learn` holds.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no text, or holds no usable model and no offsets.
    """
    return read_soft_model(decoded(Path(path).read_bytes()))


def save_model(model: SoftModel, path: str | os.PathLike[str]) -> None:
    """Write a model or learnt offsets as a file, for `soft compensate` and the node.

    Raises
    ------
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from fuzzycnc_ros import soft
    >>> from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
    >>> model = soft.train(*foam_samples(0), method='ridge')
    >>> with TemporaryDirectory() as folder:
    ...     soft.save_model(model, Path(folder) / 'foam.json')
    ...     again = soft.read_model(Path(folder) / 'foam.json')
    >>> type(again).__name__
    'DeformationModel'
    """
    write_text(Path(path), write_soft_model(model))


def compensate(
    pattern: StitchPath | Iterable[Primitive],
    model: SoftModel,
    material: SheetMaterial,
    config: CompensationConfig | None = None,
) -> OffsetPath:
    """Shift a pattern so that the relaxed sheet shows the nominal one.

    Parameters
    ----------
    pattern : StitchPath or iterable of Primitive
        Nominal stitches, or the lines and arcs that they are on.
    model : DeformationModel or StitchOffsets
        Steps outside the domain of a model are given no compensation, and flagged.  Learnt
        offsets are for the points that they were learnt on.
    material : SheetMaterial
        The sheet.
    config : CompensationConfig, optional
        Limits of the offsets.

    Returns
    -------
    OffsetPath
        Commanded points [m], offsets [m], flags and support.

    Warns
    -----
    UserWarning
        If no step is inside the domain of the model, or points look like millimetres.

    Raises
    ------
    ValueError
        If a nominal point lies off the sheet, the foot would go through it, or offsets are of
        other points.

    Examples
    --------
    >>> import numpy as np
    >>> from fuzzycnc_ros import soft
    >>> from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
    >>> model = soft.train(*foam_samples(0), method='ridge')
    >>> line = soft.Primitive((0.02, 0.06), (0.12, 0.06), depth=0.006, step=0.003)
    >>> found = soft.compensate([line], model, soft.SheetMaterial(0.02))
    >>> bool(np.abs(found.commanded - found.nominal).max() > 1e-4)
    True
    """
    path = pattern if isinstance(pattern, StitchPath) else StitchPath.of_primitives(pattern)
    if (extent := float(np.ptp(path.points, axis=0).max())) > EXTENT_MAX:
        warnings.warn(
            f'pattern: expected metres, at most {EXTENT_MAX:g} m, but found {extent:g} m; divide '
            'by 1000 if it is in millimetres',
            stacklevel=2,
        )
    found = compensated(path, material, model, config)
    if found.refused.all():
        warnings.warn(
            f'pattern, material: expected steps like those that the model knows but none of '
            f'{len(found.flag)} is: there is no compensation; depth, step and thickness '
            f'({material.thickness:g} m) are in metres',
            stacklevel=2,
        )
    return found
