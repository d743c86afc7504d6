# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files that compensate soft material, read in one place: models, and offsets of one track."""

from __future__ import annotations

import numpy as np

from fuzzycnc_ros.core.deformation.compensation import (
    CompensationConfig,
    OffsetPath,
    StepFlag,
    compensate_path,
    limit_offsets,
)
from fuzzycnc_ros.core.deformation.model import DeformationModel, model_of, write_model
from fuzzycnc_ros.core.deformation.offset_file import (
    OFFSETS_SIZE_MAX,
    StitchOffsets,
    offsets_of,
    write_offsets,
)
from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial, StitchPath
from fuzzycnc_ros.core.document import parse_document

SoftModel = DeformationModel | StitchOffsets
"""Compensator of a path: a model, or the learnt offsets of one track."""

SOFT_FILE_MAX = OFFSETS_SIZE_MAX
"""Largest document that is read [characters]."""


def read_soft_model(text: str) -> SoftModel:
    """Return the model or the offsets of a document.

    Raises
    ------
    ModelFileError
        If it is neither.
    """
    root = parse_document(text, 'model file', SOFT_FILE_MAX)
    if isinstance(root.value, dict) and 'format' in root.value:
        return offsets_of(root)
    return model_of(text, root)


def write_soft_model(model: SoftModel) -> str:
    """Return a model or offsets as a document; equal ones give equal text."""
    return write_offsets(model) if isinstance(model, StitchOffsets) else write_model(model)


def compensated(
    path: StitchPath,
    material: SheetMaterial,
    model: SoftModel,
    config: CompensationConfig | None = None,
) -> OffsetPath:
    """Return a path with the offsets of a model, or with learnt ones within their limits.

    Parameters
    ----------
    path : StitchPath
        Nominal stitches.
    material : SheetMaterial
        The sheet.
    model : SoftModel
        Learnt offsets must be of these points.
    config : CompensationConfig, optional
        Limits of the offsets.

    Raises
    ------
    ValueError
        If a nominal point lies off the sheet, the foot would go through it, or offsets are of
        other points or another thickness.
    """
    if isinstance(model, DeformationModel):
        return compensate_path(
            path, material, model.predict, config=config, gate=model, support=model.support
        )
    material.check(path)
    reason = model.other_sheet(material.thickness)
    if reason:
        raise ValueError(
            f'thickness: expected the sheet that the offsets were learnt on but found {reason}; '
            'learn the track on this sheet, or train a model'
        )
    reason = model.other_points(path.points)
    if reason:
        raise ValueError(
            f'points: expected those that the offsets were learnt at but found {reason}'
        )
    config = CompensationConfig() if config is None else config
    plain = OffsetPath.unchanged(path.points)
    offset, flag = limit_offsets(
        path.points,
        model.offset,
        offset_max=config.offset_max,
        progress_min=config.progress_min,
        size=material.size,
    )
    flag = flag | np.where(path.lengths > 0.0, 0, StepFlag.ZERO_LENGTH)
    return OffsetPath(path.points, offset, plain.compensation, plain.support, flag)
