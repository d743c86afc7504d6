# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The reference of the EMPS recording, led back to its start from rest."""

import numpy as np


def from_rest(reference):
    """Return a reference with the samples ahead of it, in which it sped up from rest.

    The recording begins amid the first ramp of velocity.  No controller that starts there at rest
    can be judged: the axis is already 0.1 mm behind.
    """
    steps = np.diff(reference[:3])
    change = steps[1] - steps[0]
    ahead = [reference[0]]
    step = steps[0]
    while (step := step - change) > 0.0:
        ahead.append(ahead[-1] - step)
    return np.concatenate([ahead[:0:-1], reference])
