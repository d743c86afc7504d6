# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The fuzzy scheduler of the feed as published [lin2021], and those that it is compared with.

The comparators are rebuilt after what [lin2021] says of them; the parameters that their own
papers used are not known.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.ndimage import minimum_filter1d

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.limits import reachable_speed
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.path.windows import window_maximum
from fuzzycnc_ros.core.feedrate.schedule.scheduler import (
    CURVATURE_FLOOR,
    WHOLE_PATH,
    Reach,
    Scheduler,
    normal_acceleration_feed,
)
from fuzzycnc_ros.core.fuzzy.mamdani import Mamdani, check_centres, tabulated

RATIO_SETS = ('VLF', 'LF', 'MF', 'HF', 'VHF', 'VVHF', 'TF')
"""Names of the output's sets, from the lowest feed to the full one."""

CURVATURE_SETS = ('ZO', 'VS', 'S', 'M', 'B', 'VB')
"""Names of the curvature's sets."""

VARIATION_SETS = ('ZO', 'L', 'M', 'H', 'VH')
"""Names of the sets of the curvature ahead."""

# Rows by curvature, columns by the curvature ahead.  VVLF is no set of the output.
_RULES = (
    ('TF', 'TF', 'VVHF', 'VVHF', 'VVLF'),
    ('VVHF', 'VVHF', 'VHF', 'VHF', 'VVLF'),
    ('VHF', 'HF', 'HF', 'HF', 'MF'),
    ('HF', 'HF', 'MF', 'MF', 'MF'),
    ('MF', 'LF', 'LF', 'VLF', 'VLF'),
    ('VLF', 'VLF', 'VLF', 'VLF', 'VLF'),
)


def published_feed_rules(vvlf: str = 'MF') -> tuple[tuple[str, ...], ...]:
    """Return the 30 rules of [lin2021], R1 to R30, by name.

    Parameters
    ----------
    vvlf : str
        Set of `RATIO_SETS` in place of the name VVLF in rules 25 and 26, which is none.

    Returns
    -------
    tuple of tuple of str
        Six rows by curvature, five columns by the curvature ahead.

    Raises
    ------
    ValueError
        If `vvlf` is no set of the output.
    """
    if vvlf not in RATIO_SETS:
        raise ValueError(f'vvlf: expected one of {", ".join(RATIO_SETS)}, but found {vvlf!r}')
    return tuple(tuple(vvlf if name == 'VVLF' else name for name in row) for row in _RULES)


@dataclass(frozen=True, kw_only=True, repr=False)
class FuzzyScheduler(Scheduler):
    """Fuzzy feed from the curvature here and the largest ahead, as published.

    The published text leaves gaps; docs/explanation/methods/feedrate.md says how the defaults
    fill them.

    Parameters
    ----------
    vvlf : str
        Set of the output that the name VVLF stands for in rules 25 and 26.
    curvature_centres : tuple of float
        Centres of the six sets of the curvature [1/m].
    variation_centres : tuple of float
        Centres of the five sets of the normalised curvature ahead, from 0 to 1.
    ratio_centres : tuple of float
        Centres of the seven sets of the ratio, above 0, the last 1.
    curvature_cap : float
        Curvature ahead that counts as 1 and above which it does not rise [1/m], positive.
    normalisation : str
        `fixed`: the curvature ahead runs from 0 to `curvature_cap`; `path`: from the least to
        the largest of the path, which magnifies noise and cannot be streamed.
    window : int
        Points of the window ahead, the point itself included, at least 1.
    window_length : float or None
        Arc length of the window ahead instead [m], positive.
    window_both : bool
        Whether the window reaches back as far as ahead.
    average : int
        Points of the moving average, at least 1.
    smoothing : str
        `average`: centred; `causal`: over the points up to each; `erode`: running minimum and
        then average, which never raises the feed.
    exact : bool
        Whether to infer each point instead of looking it up in a table.

    Notes
    -----
    `average` 15 with `vvlf` VLF is the reading that comes nearest to the published times; a long
    average carries speed into corners, so that the default is 5.

    Examples
    --------
    >>> scheduler = FuzzyScheduler(feed_max=0.005, average=1)
    >>> scheduler.ratio(np.array([0.0, 0.0, 3000.0]), np.array([0.0, 0.5, 1.0])).tolist()
    [0.4, 0.4, 0.1]
    """

    relative: ClassVar[bool] = True

    vvlf: str = 'MF'
    curvature_centres: tuple[float, ...] = (0.0, 600.0, 1200.0, 1800.0, 2400.0, 3000.0)
    variation_centres: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0)
    ratio_centres: tuple[float, ...] = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)
    curvature_cap: float = 3000.0
    normalisation: str = 'fixed'
    window: int = 30
    window_length: float | None = None
    window_both: bool = False
    average: int = 5
    smoothing: str = 'average'
    exact: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        published_feed_rules(self.vvlf)
        for name, sets in (
            ('curvature_centres', CURVATURE_SETS),
            ('variation_centres', VARIATION_SETS),
            ('ratio_centres', RATIO_SETS),
        ):
            centres = getattr(self, name)
            check_centres(f'FuzzyScheduler: {name}', centres)
            if len(centres) != len(sets):
                raise ValueError(
                    f'FuzzyScheduler: {name}: expected one centre for each of '
                    f'{", ".join(sets)}, but found {len(centres)}'
                )
        if self.ratio_centres[0] <= 0.0 or self.ratio_centres[-1] > 1.0:
            raise ValueError(
                'FuzzyScheduler: ratio_centres: expected ratios above 0 and at most 1, '
                f'but found {self.ratio_centres}'
            )
        self._check_choice('normalisation', ('fixed', 'path'))
        self._check_choice('smoothing', ('average', 'causal', 'erode'))
        self._check_positive('curvature_cap')
        if self.window_length is not None:
            self._check_positive('window_length')
        self._check_points('window', 'average')

    @property
    def system(self) -> Mamdani:
        """Rules from curvature [1/m] and normalised curvature ahead to the ratio."""
        rules = published_feed_rules(self.vvlf)
        return Mamdani(
            self.curvature_centres,
            self.variation_centres,
            self.ratio_centres,
            tuple(tuple(map(RATIO_SETS.index, row)) for row in rules),
        )

    @property
    def reach(self) -> Reach:
        """The window and the average; the whole path if it is normalised by its own range."""
        if self.normalisation == 'path':
            return WHOLE_PATH
        behind, ahead = averaged_points(self.average, self.smoothing == 'causal')
        if self.smoothing == 'erode':
            behind = ahead = self.average - 1
        if self.window_length is None:
            window = self.window - 1
            return Reach(behind + (window if self.window_both else 0), ahead + window)
        back = self.window_length if self.window_both else 0.0
        return Reach(behind, ahead, back, self.window_length)

    def variation(self, path: SampledPath) -> Array:
        """Return the normalised curvature ahead, the second input of the rules.

        Parameters
        ----------
        path : SampledPath
            Path of n points.

        Returns
        -------
        ndarray, shape (n,)
            Numbers from 0 to 1.
        """
        ahead = self._ahead(path)
        np.minimum(ahead, self.curvature_cap, out=ahead)
        if self.normalisation == 'fixed':
            return np.asarray(ahead / self.curvature_cap)
        low, high = ahead.min(), ahead.max()
        # A path of one curvature has no variation.
        return np.asarray((ahead - low) / (high - low)) if high > low else np.zeros(len(ahead))

    def _ahead(self, path: SampledPath) -> Array:
        """Return the largest curvature within the window [1/m]."""
        if self.window_length is None:
            ahead = self.window - 1
            behind = ahead if self.window_both else 0
            return window_maximum(path.curvature, ahead, behind, closed=path.closed)
        back = self.window_length if self.window_both else 0.0
        return path.largest_within(self.window_length, back)

    def _ratio(self, path: SampledPath) -> Array:
        infer = self.system if self.exact else tabulated(self.system)
        ratio = infer(path.curvature, self.variation(path))
        if self.smoothing == 'erode':
            return erode_average(ratio, self.average, closed=path.closed)
        return moving_average(
            ratio, self.average, causal=self.smoothing == 'causal', closed=path.closed
        )


@dataclass(frozen=True, kw_only=True, repr=False)
class ChordErrorFeed(Scheduler):
    """The feed that keeps the chord error of the interpolator, after Yeh and Hsu.

    Parameters
    ----------
    chord_error : float
        Largest distance between a step's chord and its arc [m], positive.
    period : float
        Time of one interpolation step [s], positive.
    """

    chord_error: float = 1e-6
    period: float = 1e-3

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_positive('chord_error', 'period')

    def _ratio(self, path: SampledPath) -> Array:
        return chord_error_feed(path.curvature, self.chord_error, self.period) / self.feed_max


@dataclass(frozen=True, kw_only=True, repr=False)
class LookAheadFeed(ChordErrorFeed):
    """Chord error, normal acceleration and path acceleration with look-ahead, after Luan.

    Parameters
    ----------
    normal_acceleration : float
        Largest acceleration across the path [m/s^2], positive.
    path_acceleration : float
        Largest acceleration along the path [m/s^2], positive.
    """

    normal_acceleration: float = 1.0
    path_acceleration: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_positive('normal_acceleration', 'path_acceleration')

    @property
    def reach(self) -> Reach:
        """The acceleration along the path links all of it."""
        return WHOLE_PATH

    def _ratio(self, path: SampledPath) -> Array:
        feed = np.minimum(
            chord_error_feed(path.curvature, self.chord_error, self.period),
            normal_acceleration_feed(path.curvature, self.normal_acceleration),
        )
        np.minimum(feed, self.feed_max, out=feed)
        return limit_acceleration(feed, path.arc_length, self.path_acceleration) / self.feed_max


@dataclass(frozen=True, kw_only=True, repr=False)
class JerkLimitedFeed(ChordErrorFeed):
    """Chord error, acceleration and jerk with smooth transitions, in the manner of Giannelli.

    Parameters
    ----------
    acceleration : float
        Largest acceleration A [m/s^2], positive; half of it each along and across the path.
    jerk : float or None
        Largest jerk J [m/s^3], positive; None for the number of 20 A.
    erosion : int
        Points of the running minima, at least 1.
    average : int
        Points of each of the three averages, at least 1.
    """

    acceleration: float = 1.0
    jerk: float | None = None
    erosion: int = 41
    average: int = 13

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_positive('acceleration')
        if self.jerk is not None:
            self._check_positive('jerk')
        self._check_points('erosion', 'average')

    @property
    def reach(self) -> Reach:
        """The acceleration along the path links all of it."""
        return WHOLE_PATH

    def _ratio(self, path: SampledPath) -> Array:
        jerk = 20.0 * self.acceleration if self.jerk is None else self.jerk
        change = np.zeros(len(path.curvature))
        if len(change) > 1:
            change = np.abs(np.gradient(path.curvature, path.arc_length))
        bend = np.maximum(path.curvature**2 + change, CURVATURE_FLOOR**2)
        feed = np.minimum(
            chord_error_feed(path.curvature, self.chord_error, self.period),
            normal_acceleration_feed(path.curvature, 0.5 * self.acceleration),
        )
        feed = np.minimum(np.minimum(feed, portable.cube_root(jerk / 3.0 / bend)), self.feed_max)
        feed = erode(feed, self.erosion, closed=path.closed)
        feed = limit_acceleration(feed, path.arc_length, 0.5 * self.acceleration)
        feed = erode(feed, self.erosion, closed=path.closed)
        for _ in range(3):
            feed = moving_average(feed, self.average, closed=path.closed)
        return feed / self.feed_max


def chord_error_feed(curvature: Array, chord_error: float, period: float) -> Array:
    """Return the feed whose steps leave a chord error, 2/T sqrt(R^2 - (R - d)^2), after Yeh-Hsu.

    Parameters
    ----------
    curvature : ndarray
        Curvature 1/R [1/m]; below 1e-9 1/m it counts as that.
    chord_error : float
        Chord error d [m], positive; above R it counts as R, the most a step can leave.
    period : float
        Time T of a step [s], positive.

    Returns
    -------
    ndarray
        Feeds [m/s] in the shape of the curvature.
    """
    radius = 1.0 / np.maximum(curvature, CURVATURE_FLOOR)
    sagitta = np.minimum(chord_error, radius)
    # R^2 - (R - d)^2 without its cancellation
    return np.asarray(2.0 / period * np.sqrt(sagitta * (2.0 * radius - sagitta)))


def averaged_points(length: int, causal: bool = False) -> tuple[int, int]:
    """Return how many points before and after its own an average of `length` points takes."""
    before = length - 1 if causal else length // 2
    return before, length - 1 - before


def moving_average(
    values: Array, length: int, *, causal: bool = False, closed: bool = False
) -> Array:
    """Return the moving average; at the ends of the mean of the points present.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Values at the points of a path.
    length : int
        Points averaged, at least 1; 1 leaves the values as they are.
    causal : bool
        Whether to average over the points up to each one instead of about it.
    closed : bool
        Whether the path closes, so that the average runs across its start.

    Returns
    -------
    ndarray, shape (n,)
        Averages, in the unit of the values.

    Examples
    --------
    >>> moving_average(np.array([0.0, 0.0, 3.0, 0.0]), 3).tolist()
    [0.0, 1.0, 1.0, 1.5]
    """
    _check_length(length)
    before, after = averaged_points(length, causal)
    kernel = np.ones(length)
    if closed:
        around = np.take(values, np.arange(-before, len(values) + after), mode='wrap')
        return np.asarray(
            portable.convolve(around, kernel)[len(kernel) - 1 : len(around)] / length
        )
    total = portable.convolve(values, kernel)[after : after + len(values)]
    place = np.arange(len(values))
    present = np.minimum(place, before) + np.minimum(place[::-1], after) + 1
    return np.asarray(total / present)


def erode(values: Array, length: int, *, closed: bool = False) -> Array:
    """Return the smallest value among `length` points about each.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Values at the points of a path.
    length : int
        Points of the window, at least 1.
    closed : bool
        Whether the path closes.

    Returns
    -------
    ndarray, shape (n,)
        Minima, in the unit of the values.
    """
    _check_length(length)
    if closed:
        return np.asarray(minimum_filter1d(values, length, mode='wrap', origin=_origin(length)))
    return np.asarray(
        minimum_filter1d(values, length, mode='constant', cval=np.inf, origin=_origin(length))
    )


def erode_average(values: Array, length: int, *, closed: bool = False) -> Array:
    """Return the moving average of the eroded values, which nowhere exceeds the values.

    Each average takes only minima over windows that hold the point itself.  Parameters and
    returns are those of `moving_average`.

    Examples
    --------
    >>> erode_average(np.array([3.0, 3.0, 3.0, 0.0]), 3).tolist()
    [3.0, 2.0, 1.0, 0.0]
    """
    return moving_average(erode(values, length, closed=closed), length, closed=closed)


def limit_acceleration(speed: Array, arc_length: Array, acceleration: float) -> Array:
    """Return the largest speeds that change by no more than a path acceleration, ends free.

    Parameters
    ----------
    speed : ndarray, shape (n,)
        Speeds wanted [m/s], not exceeded anywhere.
    arc_length : ndarray, shape (n,)
        Arc length of the points [m], not decreasing.
    acceleration : float
        Largest magnitude of the acceleration along the path [m/s^2], positive.

    Returns
    -------
    ndarray, shape (n,)
        Speeds [m/s].
    """
    return reachable_speed(
        arc_length, speed, acceleration, start=float(speed[0]), end=float(speed[-1])
    )


def _origin(length: int) -> int:
    """Return the shift that mirrors the window of an even length against that of the average."""
    return 0 if length % 2 else -1


def _check_length(length: int) -> None:
    """Refuse an average over no points."""
    if length < 1:
        raise ValueError(
            f'length: expected at least 1 point, which leaves the values as they are, '
            f'but found {length}'
        )
