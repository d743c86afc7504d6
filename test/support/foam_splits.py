# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What is held out of measured seams, for tests and benchmarks of what is learnt from them."""

import numpy as np
from numpy.typing import NDArray


def grouped_split(
    groups: NDArray[np.int64], held_out: int, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return the mask of about `held_out` rows in whole groups, drawn at random."""
    names, group = np.unique(groups, return_inverse=True)
    size = np.bincount(group.ravel())
    order = rng.permutation(len(names))
    taken = order[np.cumsum(size[order]) <= held_out]
    return np.asarray(np.isin(group.ravel(), taken))
