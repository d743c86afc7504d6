# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a recording shows of patterns: offsets of their stitches, and where the tool went."""

import numpy as np

from campaign.evidence import Evidence, Window
from campaign.measured import Measured, largest
from campaign.path_verdict import measure_path
from campaign.scenario import Scenario
from fuzzycnc_ros.components.soft.deformation_compensator import (
    DeformationCompensatorConfig,
)
from fuzzycnc_ros.core.deformation.compensation import StepFlag
from fuzzycnc_ros.runtime.records import CompensatedPath

LIMITS = DeformationCompensatorConfig()
BLEND = 10e-6
"""How far the tool may pass by a stitch [m]; at 0 it would stop at each."""
REFUSED = int(StepFlag.OUTSIDE_DOMAIN | StepFlag.RIGHT_TURN)
ROUNDING = 1e-12
"""What may be lost in sums of offsets [m]."""


def measure_pattern(scenario: Scenario, window: Window, evidence: Evidence) -> Measured | None:
    """Judge how patterns were compensated and followed; None if too little was recorded.

    Worst offset and step are those of the stitches here.  The axes are judged as on any path.
    """
    found = measure_path(scenario, window, evidence, blend=BLEND)
    if found is None:
        return None
    paths = [item.record for item in window.of(evidence.sent('compensated_path'))]
    for path in paths:
        found.why += _wrong(path)
    offsets = [path.offset.reshape(-1, 2) for path in paths]
    found.worst_offset_um = largest(np.hypot(*offset.T) for offset in offsets)
    found.worst_step_um = largest(np.hypot(*np.diff(offset, axis=0).T) for offset in offsets)
    return found


def _wrong(path: CompensatedPath) -> list[str]:
    """Say what is wrong with the offsets of a pattern."""
    wrong = []
    offset = path.offset.reshape(-1, 2)
    if not np.isfinite(offset).all():
        wrong.append(f'{path.path_id}: an offset is not finite')
    elif np.hypot(*offset.T).max(initial=0.0) > LIMITS.offset_max + ROUNDING:
        wrong.append(f'{path.path_id}: an offset exceeds its largest length')
    refused = path.flag & REFUSED != 0
    if path.compensation.reshape(-1, 2)[refused].any():
        wrong.append(f'{path.path_id}: a step that was refused is compensated')
    return wrong
