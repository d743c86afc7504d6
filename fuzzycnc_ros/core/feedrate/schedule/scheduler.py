# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Schedulers of the feed along a path: their common interface, and the two plainest."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from math import inf, isfinite
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.sampled_path import WINDOW_EDGE, SampledPath

# Curvature below which a path counts as straight [1/m]
CURVATURE_FLOOR = 1e-9


@dataclass(frozen=True)
class Reach:
    """Reach of the feed rule: how far along a path the feed depends on the curvature.

    Attributes
    ----------
    points_behind, points_ahead : int
        Points before and after.
    length_behind, length_ahead : float
        And the arc length beyond these [m]; infinite if the whole path matters.
    """

    points_behind: int = 0
    points_ahead: int = 0
    length_behind: float = 0.0
    length_ahead: float = 0.0

    @property
    def bounded(self) -> bool:
        """True if a path can be taken in parts."""
        return isfinite(self.length_behind) and isfinite(self.length_ahead)

    def ready(self, arc_length: Array) -> int:
        """Return for how many of the points that have arrived, (n,) [m], all ahead is here."""
        points, length = self.points_ahead, self.length_ahead * WINDOW_EDGE
        if not length:
            return max(len(arc_length) - points, 0)
        known = int(np.searchsorted(arc_length, arc_length[-1] - length)) - points
        if known <= 0:
            return 0
        # What lies within the length ahead depends on points ahead of it in its turn.
        return int(np.searchsorted(arc_length, arc_length[known - 1] - length))

    def first_needed(self, arc_length: Array, point: int) -> int:
        """Return the first of the points, (n,) [m], that the feed at one, or behind, depends on.

        The last one stays in any case, so that what follows is seen to follow it.
        """
        first = max(min(point, len(arc_length) - 1) - self.points_behind, 0)
        length = self.length_behind * WINDOW_EDGE
        return int(np.searchsorted(arc_length, arc_length[first] - length))


WHOLE_PATH = Reach(length_behind=inf, length_ahead=inf)
"""Reach of schedulers that cannot take a path in parts."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Scheduler(ABC):
    """A rule that gives the feed at each point of a path.

    Parameters
    ----------
    feed_max : float
        Feed on straight stretches [m/s], positive.  No more than the machine reaches: a feed
        clamped afterwards no longer keeps the tolerance.
    feed_min : float
        Feed at reversals and the least one elsewhere [m/s], positive, at most `feed_max`.

    Raises
    ------
    ValueError
        If a parameter is outside its range.
    """

    relative: ClassVar[bool] = False
    """True if the ratio scales the programmed feed; if not, `feed` is a limit by itself."""

    feed_max: float
    feed_min: float = 2e-5

    def __post_init__(self) -> None:
        self._check_positive('feed_max', 'feed_min')
        if self.feed_min > self.feed_max:
            raise ValueError(
                f'{type(self).__name__}: feed_min: expected at most feed_max, {self.feed_max} '
                f'm/s, but found {self.feed_min} m/s'
            )

    def ratio(self, curvature: Array, arc_length: Array) -> Array:
        """Return the feed as part of `feed_max` on an open path.

        Parameters
        ----------
        curvature : ndarray, shape (n,)
            Magnitude of the curvature [1/m], finite, not negative.
        arc_length : ndarray, shape (n,)
            Arc length [m], finite, increasing.

        Returns
        -------
        ndarray, shape (n,)
            Ratios, above 0 and at most 1.

        Raises
        ------
        ValueError
            If an argument is not as said.
        """
        return self.bounded_ratio(SampledPath(arc_length, curvature))

    def feed(self, path: SampledPath | ArrayLike) -> Array:
        """Return the feed.

        Parameters
        ----------
        path : SampledPath or array_like, shape (n, d)
            Path made of n points, or points in the plane or in space [m] of an open path with
            exact coordinates; those on top of each other share their feed.

        Returns
        -------
        ndarray, shape (n,)
            Feeds [m/s] from `feed_min` to `feed_max`; `feed_min` where the path turns back.

        Raises
        ------
        ValueError
            If the points are no path.
        """
        sampled = path if isinstance(path, SampledPath) else SampledPath.from_points(path)
        return sampled.at_points(self.feed_max * self.bounded_ratio(sampled))

    @property
    def reach(self) -> Reach:
        """Reach along the path of the curvature that the feed at a point depends on."""
        return Reach()

    def check_streamable(self) -> None:
        """Refuse a path in parts.

        Raises
        ------
        ValueError
            If the reach is not bounded.
        """
        if not self.reach.bounded:
            raise ValueError(
                f'scheduler: expected one that can take a path in parts, but found {self!r}, '
                'which needs all of it; fix what it takes from the path, such as curvature_max'
            )

    def bounded_ratio(self, path: SampledPath) -> Array:
        """Return the feed as part of `feed_max`.

        Parameters
        ----------
        path : SampledPath
            Path of m distinct points.

        Returns
        -------
        ndarray, shape (m,)
            Ratios, above 0 and at most 1; the least one where the path turns back.
        """
        least = self.feed_min / self.feed_max
        ratio = np.clip(self._ratio(path), least, 1.0)
        # After all smoothing, which would lift it again
        ratio[path.reversal] = least
        return np.asarray(ratio)

    @abstractmethod
    def _ratio(self, path: SampledPath) -> Array:
        """Return ratios that need not be within bounds, at the distinct points."""

    def _check_positive(self, *names: str) -> None:
        """Refuse parameters that are not positive and finite."""
        for name in names:
            value = getattr(self, name)
            if not (isfinite(value) and value > 0.0):
                raise ValueError(
                    f'{type(self).__name__}: {name}: expected a positive number, but found {value}'
                )

    def _check_points(self, *names: str) -> None:
        """Refuse numbers of points below 1."""
        for name in names:
            value = getattr(self, name)
            if isinstance(value, float) or value < 1:
                raise ValueError(
                    f'{type(self).__name__}: {name}: expected a whole number of points, '
                    f'at least 1, but found {value}'
                )

    def _check_choice(self, name: str, choices: tuple[str, ...]) -> None:
        """Refuse a parameter that is none of the choices."""
        value = getattr(self, name)
        if value not in choices:
            raise ValueError(
                f'{type(self).__name__}: {name}: expected one of {", ".join(choices)}, '
                f'but found {value!r}'
            )

    def __repr__(self) -> str:
        """Return the constructor call that makes an equal scheduler, without its defaults."""
        changed = (
            f'{field.name}={getattr(self, field.name)!r}'
            for field in fields(self)
            if getattr(self, field.name) != field.default
        )
        return f'{type(self).__name__}({", ".join(changed)})'


class ConstantFeed(Scheduler):
    """The same feed everywhere but at reversals."""

    relative: ClassVar[bool] = True

    def _ratio(self, path: SampledPath) -> Array:
        return np.ones(len(path.curvature))


@dataclass(frozen=True, kw_only=True, repr=False)
class ConstantNormalAcceleration(Scheduler):
    """The feed that keeps the normal acceleration, v = min(feed_max, sqrt(a / curvature)).

    As the contour error is C curvature v^2, this is also the fastest feed at a tolerance.

    Parameters
    ----------
    normal_acceleration : float
        Acceleration a [m/s^2], positive; the tolerance over the machine constant C.
    """

    normal_acceleration: float

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_positive('normal_acceleration')

    def _ratio(self, path: SampledPath) -> Array:
        return normal_acceleration_feed(path.curvature, self.normal_acceleration) / self.feed_max


def normal_acceleration_feed(curvature: Array, acceleration: float) -> Array:
    """Return the feed whose normal acceleration is given.

    Parameters
    ----------
    curvature : ndarray
        Curvature [1/m]; below 1e-9 1/m it counts as that.
    acceleration : float
        Normal acceleration [m/s^2], positive.

    Returns
    -------
    ndarray
        Feeds [m/s] in the shape of the curvature.
    """
    return np.asarray(np.sqrt(acceleration / np.maximum(curvature, CURVATURE_FLOOR)))
