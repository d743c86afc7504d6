# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Inference of Takagi-Sugeno rules with Gaussian sets, method sheet 001 eqs. (1)-(6)."""

import numpy as np

from fuzzycnc_ros.core.arrays import Array


def log_firing(inputs: Array, center: Array, inverse_width: Array) -> Array:
    """Return the logarithm of the firing strengths, the product of eqs. (1)-(3).

    Parameters
    ----------
    inputs : ndarray, shape (..., p)
        Inputs; leading axes broadcast with those of the rules.
    center : ndarray, shape (..., r, p)
        Centres of the Gaussian sets, in the units of the inputs.
    inverse_width : ndarray, shape (..., r, p)
        Reciprocal of their standard deviations, positive.

    Returns
    -------
    ndarray, shape (..., r)
        Logarithms, 0 or less.
    """
    apart = (inputs[..., np.newaxis, :] - center) * inverse_width
    # On arrays this small a product and a sum are faster than einsum.
    return np.asarray(-0.5 * (apart * apart).sum(axis=-1))


def normalised_firing(logarithm: Array, axis: int = -1) -> Array:
    """Return the firing strengths of eq. (4), which sum to 1 over the rules along `axis`.

    The strongest rule is taken out before the exponential: far from all sets every strength
    underflows, and 0/0 would follow.
    """
    strength = np.exp(logarithm - logarithm.max(axis=axis, keepdims=True))
    return np.asarray(strength / strength.sum(axis=axis, keepdims=True))
