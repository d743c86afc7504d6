# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzy scheduler of the feed, as published, and its rules."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.path.windows import window_maximum
from fuzzycnc_ros.core.feedrate.schedule.plain import (
    WHOLE_PATH,
    Reach,
    Scheduler,
)
from fuzzycnc_ros.core.feedrate.schedule.smoothing import erode_average, moving_average, reach
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
        behind, ahead = reach(self.average, self.smoothing == 'causal')
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
