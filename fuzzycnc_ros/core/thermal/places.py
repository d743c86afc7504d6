# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Error along an axis: names of what is measured at several places of it."""

from collections.abc import Sequence

from fuzzycnc_ros.core.arrays import Array


def place_channels(axis: Sequence[str], position: Array) -> tuple[str, ...]:
    """Return the channels of measurements at positions of axes.

    Parameters
    ----------
    axis : sequence of str, length n
        Axis of each measurement.
    position : ndarray, shape (n,)
        Where it is measured [m], NaN where that does not matter.

    Returns
    -------
    tuple of str, length n
        The axis alone where it is measured once.

    Examples
    --------
    >>> place_channels(['Y', 'Y', 'Z'], [-0.4, 0.0, 0.0])
    ('Y@-400mm', 'Y@0mm', 'Z')
    """
    names = list(axis)
    return tuple(
        name if names.count(name) == 1 else f'{name}@{1e3 * place:.6g}mm'
        for name, place in zip(names, position, strict=True)
    )
