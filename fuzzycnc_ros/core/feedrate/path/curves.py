# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The curves of the interpolator literature [lin2021].

Their tables are in millimetres; the curves are in metres like everything else.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve

_MILLIMETRE = 1e-3

_SEVEN_POINT_KNOTS = (0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1)

# fmt: off
_INFINITY_POINTS = (
    (0, 0), (-48, -90), (-68, 127.5), (0, 0), (68, -127.5), (48, 90), (0, 0),
)

_TRIDENT_POINTS = (
    (20, 0), (40, 40), (24, 16), (20, 40), (16, 16), (0, 40), (20, 0),
)

_BUTTERFLY_POINTS = (
    (54.493, 52.139), (55.507, 52.139), (56.082, 49.615), (56.780, 44.971), (69.575, 51.358),
    (77.786, 58.573), (90.526, 67.081), (105.973, 63.801), (100.400, 47.326), (94.567, 39.913),
    (92.369, 30.485), (83.440, 33.757), (91.892, 28.509), (89.444, 20.393), (83.218, 15.446),
    (87.621, 4.830), (80.945, 9.267), (79.834, 14.535), (76.074, 8.522), (70.183, 12.550),
    (64.171, 16.865), (59.993, 22.122), (55.680, 36.359), (56.925, 24.995), (59.765, 19.828),
    (54.493, 14.940), (49.220, 19.828), (52.060, 24.994), (53.305, 36.359), (48.992, 22.122),
    (44.814, 16.865), (38.802, 12.551), (32.911, 8.521), (29.152, 14.535), (28.040, 9.267),
    (21.364, 4.830), (25.768, 15.447), (19.539, 20.391), (17.097, 28.512), (25.537, 33.750),
    (16.602, 30.496), (14.199, 39.803), (8.668, 47.408), (3.000, 63.794), (18.465, 67.084),
    (31.197, 58.572), (39.411, 51.358), (52.204, 44.971), (52.904, 49.614), (53.478, 52.139),
    (54.492, 52.139),
)

_BUTTERFLY_WEIGHTS = {
    3: 1.2, 47: 1.2, 11: 2.0, 39: 2.0, 14: 5.0, 36: 5.0, 15: 3.0, 35: 3.0, 17: 1.1, 33: 1.1,
}  # by point; 1 else

_BUTTERFLY_KNOTS = (
    0, 0, 0, 0, 0.0083, 0.015, 0.0361, 0.0855, 0.1293, 0.1509, 0.1931, 0.2273, 0.2435, 0.2561,
    0.2692, 0.2889, 0.317, 0.3316, 0.3482, 0.3553, 0.3649, 0.3837, 0.4005, 0.4269, 0.451, 0.466,
    0.4891, 0.5, 0.5109, 0.534, 0.5489, 0.5731, 0.5994, 0.6163, 0.6351, 0.6447, 0.6518, 0.6683,
    0.683, 0.7111, 0.7307, 0.7439, 0.7565, 0.7729, 0.8069, 0.8491, 0.8707, 0.9145, 0.9639, 0.985,
    0.9917, 1, 1, 1, 1,
)
# fmt: on


def infinity(scale: float = 1.0) -> NurbsCurve:
    """Return the figure of eight, 475.16 mm long at scale 1.

    Parameters
    ----------
    scale : float
        Factor of its size, positive; 0.65 is that of the figures on the page about feeds.

    Returns
    -------
    NurbsCurve
        Cubic of 7 points with equal weights; it crosses itself where it begins and ends.

    Raises
    ------
    ValueError
        If `scale` is not positive.
    """
    return _scaled(_INFINITY_POINTS, np.full(7, 0.6), _SEVEN_POINT_KNOTS, scale)


def trident(scale: float = 1.0) -> NurbsCurve:
    """Return the trident, 97.99 mm long at scale 1.

    Parameters
    ----------
    scale : float
        Factor of its size, positive; 2.3 is that of the figures on the page about feeds.

    Returns
    -------
    NurbsCurve
        Cubic of 7 points with equal weights.

    Raises
    ------
    ValueError
        If `scale` is not positive.
    """
    return _scaled(_TRIDENT_POINTS, np.full(7, 2.0), _SEVEN_POINT_KNOTS, scale)


def butterfly(scale: float = 1.0) -> NurbsCurve:
    """Return the butterfly of 51 points, 382.86 mm long at scale 1.

    The table is symmetric to 0.25 mm only, and its ends are 0.001 mm apart.

    Parameters
    ----------
    scale : float
        Factor of its size, positive; 0.875 is that of the figures on the page about feeds.

    Returns
    -------
    NurbsCurve
        Cubic with weights from 1 to 5.

    Raises
    ------
    ValueError
        If `scale` is not positive.

    Examples
    --------
    >>> round(1e3 * butterfly().length, 3)
    382.86
    """
    weight = np.ones(len(_BUTTERFLY_POINTS))
    weight[list(_BUTTERFLY_WEIGHTS)] = list(_BUTTERFLY_WEIGHTS.values())
    return _scaled(_BUTTERFLY_POINTS, weight, _BUTTERFLY_KNOTS, scale)


CURVES: Mapping[str, Callable[[float], NurbsCurve]] = MappingProxyType(
    {'infinity': infinity, 'trident': trident, 'butterfly': butterfly}
)
"""The curves by name."""

SHEET_SCALES: Mapping[str, float] = MappingProxyType(
    {'infinity': 0.65, 'trident': 2.3, 'butterfly': 0.875}
)
"""Factors of size of the figures on the page about feeds."""


def _scaled(
    points: tuple[tuple[float, float], ...],
    weight: np.ndarray,
    knot: tuple[float, ...],
    scale: float,
) -> NurbsCurve:
    if not scale > 0.0:
        raise ValueError(f'expected a positive scale but found {scale!r}')
    return NurbsCurve(_MILLIMETRE * scale * np.array(points), weight, knot)
