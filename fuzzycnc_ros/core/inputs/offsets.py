# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Offsets as those who send them and those who take them speak of them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

AXES = ('X', 'Y', 'Z', 'A', 'B', 'C', 'U', 'V', 'W')
"""Axis names of ISO 841."""

NEGLIGIBLE = 1e-8
"""Offset in a read-back that is what a controller rounds [m]."""

EPOCH_STEP = 1000
"""Largest step of the epoch for a new owner: an honest one takes the next, and
one that was restarted meanwhile a few more.  What is beyond would lock all others out."""


def describe(
    axes: Sequence[str], values: NDArray[np.float64], chosen: NDArray[np.bool_] | None = None
) -> str:
    """Return offsets [m] as text in micrometres, those that are chosen or not zero."""
    picked = np.abs(values) > 0.0 if chosen is None else np.asarray(chosen, bool)
    return ', '.join(
        f'{axis} {1e6 * value:.2f} um'
        for axis, value, take in zip(axes, values, picked, strict=True)
        if take
    )
