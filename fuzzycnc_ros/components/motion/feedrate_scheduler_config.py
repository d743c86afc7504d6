# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of `feedrate_scheduler`, and the scheduler and the limits that they mean."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf
from types import MappingProxyType
from typing import Any

from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.schedule.scheduler import (
    ConstantFeed,
    ConstantNormalAcceleration,
    Scheduler,
)
from fuzzycnc_ros.core.feedrate.schedule.tolerance_feed import ToleranceFeed
from fuzzycnc_ros.papers.feedrate import (
    RATIO_SETS,
    ChordErrorFeed,
    FuzzyScheduler,
    JerkLimitedFeed,
    LookAheadFeed,
)
from fuzzycnc_ros.runtime.records import nanoseconds

AXES = ('X', 'Y', 'Z')
"""Axes of a tool path; limits of the axes are given in this order."""


@dataclass(frozen=True, kw_only=True)
class FeedrateSchedulerConfig(Config):
    """Parameters of `feedrate_scheduler`."""

    GONE = MappingProxyType(
        {
            'log_fuzzy_guard_time': 0.1,
            'log_fuzzy_guard_step': 0.5,
            'log_fuzzy_approach_time': 0.0,
            'log_fuzzy_approach_slope': 0.0,
            'log_fuzzy_braking': 0,
            'log_fuzzy_braking_points': 4,
        }
    )

    autostart: bool = param(
        False, '-', 'Configure and activate at start; otherwise a lifecycle manager does'
    )
    method: str = param(
        'log_fuzzy',
        '-',
        'Rule that chooses the feed; log_fuzzy and tolerance are one: the root of tolerance over '
        'margin, machine constant and curvature; look_ahead and jerk_limited need the whole path '
        'and serve programs only',
        choices=(
            'log_fuzzy',
            'tolerance',
            'fuzzy',
            'constant',
            'normal_acceleration',
            'chord_error',
            'look_ahead',
            'jerk_limited',
        ),
        live=True,
    )
    tolerance: float = param(
        1e-5,
        'm',
        'Largest contour error wanted; log_fuzzy, normal_acceleration, look_ahead and '
        'jerk_limited heed it',
        low=1e-8,
        high=1e-2,
        live=True,
    )
    feed_override: float = param(
        1.0,
        '-',
        'Factor of the feed; 0 holds on the path, above 1 the tolerance still counts',
        low=0.0,
        high=2.0,
        live=True,
    )
    feed_max: float = param(
        0.2,
        'm/s',
        'Feed on straight stretches where the path asks for no less',
        low=1e-6,
        high=10.0,
    )
    feed_min: float = param(
        2e-5, 'm/s', 'Feed where the path turns back, and the least elsewhere', low=1e-9, high=1.0
    )
    machine_constant: float = param(
        2.1517e-4,
        's^2',
        'Contour error over normal acceleration, as a circle on the machine shows it',
        low=1e-9,
        high=1.0,
    )
    curvature_max: float = param(
        5e4,
        '1/m',
        'Curvature that the guard of log_fuzzy reckons with at most; 0 takes the largest of the '
        'path, for programs only',
        low=0.0,
        high=1e9,
    )
    blend: float = param(
        0.0,
        'm',
        'Largest distance of the path from a corner that it rounds; 0 stops at every corner',
        low=0.0,
        high=1e-2,
    )
    path_velocity: float = param(
        0.25, 'm/s', 'Limit of the speed along the path', low=1e-6, high=100.0, live=True
    )
    path_acceleration: float = param(
        1.5, 'm/s^2', 'Limit of its change along the path', low=1e-6, high=1e4, live=True
    )
    path_jerk: float = param(
        0.0, 'm/s^3', 'Limit of the jerk along the path; 0 is none', low=0.0, high=1e7, live=True
    )
    axis_velocity: tuple[float, ...] = param(
        (0.25, 0.25, 0.25), 'm/s', 'Limits of X, Y and Z', low=1e-6, high=100.0, live=True
    )
    axis_acceleration: tuple[float, ...] = param(
        (4.0, 4.0, 4.0), 'm/s^2', 'Limits of X, Y and Z', low=1e-6, high=1e4, live=True
    )
    axis_jerk: tuple[float, ...] = param(
        (0.0, 0.0, 0.0),
        'm/s^3',
        'Limits of X, Y and Z; 0 is none',
        low=0.0,
        high=1e7,
        live=True,
    )
    jerk_window: float = param(
        0.0,
        's',
        'Time over which acceleration is averaged where jerk is limited; 0 chooses it',
        low=0.0,
        high=1.0,
    )
    settle: float = param(
        0.1,
        's',
        'Rest at exact stops, for the axes to arrive: four time constants of their position loop',
        low=0.0,
        high=10.0,
    )
    period: float = param(
        1e-3, 's', 'Time between two samples of the trajectory', low=1e-4, high=0.1
    )
    chunk: float = param(
        0.25, 's', 'Motion that each part of the trajectory commits to', low=1e-3, high=10.0
    )
    lead: float = param(0.25, 's', 'How long before its start a part is sent', low=1e-3, high=10.0)
    log_fuzzy_margin: float = param(
        1.05, '-', 'Method log_fuzzy designs for the tolerance over this', low=1.0, high=10.0
    )
    log_fuzzy_guard_length: float = param(
        60e-6,
        'm',
        'Method log_fuzzy takes the largest curvature up to this far on both sides; 0 is none',
        low=0.0,
        high=0.1,
    )
    fuzzy_vvlf: str = param(
        'MF',
        '-',
        'Set that the published rules 25 and 26 mean by VVLF, which is none',
        choices=RATIO_SETS,
    )
    fuzzy_curvature_centres: tuple[float, ...] = param(
        (0.0, 600.0, 1200.0, 1800.0, 2400.0, 3000.0),
        '1/m',
        'Published method: centres of the six sets of the curvature, rising',
        low=0.0,
        high=1e9,
    )
    fuzzy_variation_centres: tuple[float, ...] = param(
        (0.0, 0.25, 0.5, 0.75, 1.0),
        '-',
        'Published method: centres of the five sets of the curvature ahead, rising',
        low=0.0,
        high=1.0,
    )
    fuzzy_ratio_centres: tuple[float, ...] = param(
        (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0),
        '-',
        'Published method: centres of the seven sets of the ratio, rising',
        low=1e-6,
        high=1.0,
    )
    fuzzy_curvature_cap: float = param(
        3000.0, '1/m', 'Published method: curvature ahead that counts as 1', low=1e-6, high=1e9
    )
    fuzzy_normalisation: str = param(
        'fixed',
        '-',
        'Published method: curvature ahead over the cap, or over its range on the path, for '
        'programs only',
        choices=('fixed', 'path'),
    )
    fuzzy_window: int = param(
        30, '-', 'Published method: points of the window ahead', low=1, high=100_000
    )
    fuzzy_window_length: float = param(
        0.0, 'm', 'Length of the window ahead instead; 0 counts points', low=0.0, high=1.0
    )
    fuzzy_window_both: bool = param(
        False, '-', 'Published method: whether the window reaches back as far as ahead'
    )
    fuzzy_average: int = param(
        5, '-', 'Published method: points of the moving average', low=1, high=100_000
    )
    fuzzy_smoothing: str = param(
        'average',
        '-',
        'Published method: centred average, causal one, or running minimum and then average',
        choices=('average', 'causal', 'erode'),
    )
    chord_error: float = param(
        1e-6,
        'm',
        'Largest chord error of one period, for chord_error, look_ahead and jerk_limited',
        low=1e-10,
        high=1e-2,
    )
    jerk_limited_erosion: int = param(
        41, '-', 'Points of the running minima of jerk_limited', low=1, high=100_000
    )
    jerk_limited_average: int = param(
        13, '-', 'Points of each average of jerk_limited', low=1, high=100_000
    )

    def __post_init__(self) -> None:
        """Check every field, and that they fit each other.

        Raises
        ------
        ValueError
            If they do not; the message names the parameter.
        """
        super().__post_init__()
        if self.method == 'tolerance':  # another name of the same, unknown to what follows
            object.__setattr__(self, 'method', 'log_fuzzy')
        for name in ('axis_velocity', 'axis_acceleration', 'axis_jerk'):
            found = len(getattr(self, name))
            if found != len(AXES):
                raise ValueError(
                    f'{name}: expected one limit each for {", ".join(AXES)} but found {found}'
                )
        if nanoseconds(self.chunk) % nanoseconds(self.period):
            raise ValueError(
                f'chunk = {self.chunk} s must be a whole number of periods of {self.period} s'
            )
        make_scheduler(self)  # refuses what makes no sense for the method


def make_scheduler(config: FeedrateSchedulerConfig) -> Scheduler:
    """Return the scheduler that a configuration asks for.

    Each of its fields is the parameter of the same name, or of that name behind the method's.

    Raises
    ------
    ValueError
        If its parameters do not fit each other.
    """
    kind, prefix = _SCHEDULERS[config.method], f'{config.method}_'
    allowed = config.tolerance / config.machine_constant  # across the path [m/s^2]
    known: dict[str, Any] = {item.name: getattr(config, item.name) for item in fields(config)}
    known |= {name.removeprefix(prefix): known[name] for name in known if name.startswith(prefix)}
    known |= {
        'normal_acceleration': allowed,
        'acceleration': 2.0 * allowed,  # half of it goes across the path
        'jerk': config.path_jerk,
    }
    given = {item.name: known[item.name] for item in fields(kind) if item.name in known}
    absent = {name: None for name in _NONE_FOR_ZERO if name in given and not given[name]}
    return kind(**given | absent)


def make_limits(config: FeedrateSchedulerConfig) -> MotionLimits:
    """Return the limits of the motion, those of the axes in the order X, Y, Z."""
    return MotionLimits(
        path_velocity=config.path_velocity,
        path_acceleration=config.path_acceleration,
        path_jerk=config.path_jerk or inf,
        velocity=config.axis_velocity,
        acceleration=config.axis_acceleration,
        jerk=tuple(limit or inf for limit in config.axis_jerk) if any(config.axis_jerk) else None,
    )


def heeds_tolerance(config: FeedrateSchedulerConfig) -> bool:
    """Return True if the method takes a contour tolerance."""
    return config.method not in ('fuzzy', 'constant', 'chord_error')


_SCHEDULERS: Mapping[str, type[Scheduler]] = MappingProxyType(
    {
        'log_fuzzy': ToleranceFeed,
        'fuzzy': FuzzyScheduler,
        'constant': ConstantFeed,
        'normal_acceleration': ConstantNormalAcceleration,
        'chord_error': ChordErrorFeed,
        'look_ahead': LookAheadFeed,
        'jerk_limited': JerkLimitedFeed,
    }
)

_NONE_FOR_ZERO = ('curvature_max', 'window_length', 'jerk')
"""Fields for which the parameter 0 means that there is no such value."""
