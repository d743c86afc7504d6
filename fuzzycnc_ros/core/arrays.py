# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Types of arrays and seeds."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Array of doubles."""

Seed = int | np.random.Generator | None
"""What seeds an estimator; None draws fresh entropy, and no global state is ever touched."""
