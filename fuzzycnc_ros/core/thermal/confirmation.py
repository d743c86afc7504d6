# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sequential probability ratio test of whether probes see an offset as it is.

A probe whose sign, unit or axis is wrong from the first one on fits any model.  What it shows of
an offset does not: it is off by |1 - k| offsets where every probe is k times the truth.

References
----------
[wald1945]
"""

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array

CONFIRMED, CONTRADICTED = 1.0, -3.0
"""Evidence from which on the probes of a channel are right, or wrong [-]."""

STEP_MAX = 2.0
"""Most evidence of one probe [-]: there may be a chip under it."""

EVIDENCE_KEPT = 3.0
"""Most evidence [-]: three probes that contradict it outweigh all that spoke for it before."""


def judged(evidence: float, missed: float, deviation: float, offset: float) -> float:
    """Return the evidence for right probes after one under an offset.

    It is the logarithm of the likelihood of what the probe misses the prediction by, over that
    of a probe which misses by the size of the offset.  That probes are wrong stays; that they are
    right is tried on.

    Parameters
    ----------
    evidence : float
        Evidence before [-]; 0 at first.
    missed : float
        Probed error of the bare machine minus the predicted one [m].
    deviation : float
        Standard deviation of that difference for a right probe [m].
    offset : float
        Offset in force [m].

    Examples
    --------
    >>> round(judged(0.0, 0.5e-6, 1e-6, 6e-6), 2), judged(-2.0, 12e-6, 1e-6, 6e-6)
    (1.68, -4.0)
    """
    if evidence <= CONTRADICTED:
        return evidence
    right = deviation * deviation
    wrong = right + offset * offset
    ratio = 0.5 * (
        float(portable.log(wrong / right)) - missed * missed * (1.0 / right - 1.0 / wrong)
    )
    return min(evidence + float(np.clip(ratio, -STEP_MAX, STEP_MAX)), EVIDENCE_KEPT)


def is_right(evidence: Array) -> NDArray[np.bool_]:
    """Return the channels (c,) whose probes are right."""
    return np.asarray(evidence >= CONFIRMED)


def is_wrong(evidence: Array) -> NDArray[np.bool_]:
    """Return the channels (c,) whose probes are wrong."""
    return np.asarray(evidence <= CONTRADICTED)
