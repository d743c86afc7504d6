# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feeds with and without rules: time at equal largest contour error on the simulated machine.

Every way has one knob.  It is turned until the machine leaves the same largest error, so that the
times may be compared; those that know a tolerance are also driven at the tolerance as asked for.
What chose the settings of `log_fuzzy` were random curves: none of these paths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, sqrt
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from fuzzy_worth_rows import FUZZY, LAW, NOTHING, PLAIN, UNKNOWN, Part, Way

from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.motion.program_request import program_settings
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.blocks import Program
from fuzzycnc_ros.core.feedrate.gcode.reader import ProgramReader
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.trajectory import limit_motion
from fuzzycnc_ros.core.feedrate.path.curves import butterfly
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.schedule.program_schedule import (
    ScheduledPath,
    schedule_program,
)
from fuzzycnc_ros.core.feedrate.schedule.program_settings import ProgramSettings
from fuzzycnc_ros.core.feedrate.schedule.scheduler import (
    ConstantFeed,
    ConstantNormalAcceleration,
    Scheduler,
)
from fuzzycnc_ros.core.feedrate.schedule.tolerance_feed import ToleranceFeed
from fuzzycnc_ros.core.fuzzy.mamdani import Mamdani, tabulated
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.papers.feedrate import (
    CURVATURE_SETS,
    RATIO_SETS,
    VARIATION_SETS,
    FuzzyScheduler,
)
from fuzzycnc_ros.simulation.motion.contouring import simulate_contouring
from fuzzycnc_ros.studies.pareto.pareto_path import CURVES, POINTS, curve_path
from fuzzycnc_ros.studies.pareto.refinement import (
    UnreachableToleranceError,
    knob_at_error,
)
from fuzzycnc_ros.studies.programs.program_drive import drive_paths

TIME, KEPT = 'time at equal error, over the law', 'error over tolerance, as asked'
"""Headings of the figures [-]."""

CONFIG = FeedrateSchedulerConfig(blend=1e-5)
"""Machine constant, limits, corners of programs rounded by up to 10 um."""

CURVE_ERRORS, PROGRAM_ERRORS = (5e-5, 1e-4), (2e-5, 5e-5)
"""Largest contour errors at which ways are compared on curves and on programs [m]."""

PROGRAMS = (
    'ccby-5axis/Bottle_opener_Flaschenoeffner.txt',
    'ccby-5axis/Coordinate_system_representation_Achskreuz.mpf',
    'ccby-5axis/Keychain_Schluesselanhaenger.mpf',
    'ugs/Gates_combined_R12.nc',
    'ugs/arc_rword_test.gcode',
)
"""Part programs in the folder `gcode` that leave more than these at their own feeds."""

STRETCH = 4.0
"""Motion at the program's feeds from its beginning that is driven [s]."""

SCALE_MIN = 0.02
"""Least share of the programmed feeds that is tried [-]."""

TOLERANCES = (1e-7, 1e-2)
"""Tolerances between which is searched [m]."""

GAP_MIN = 0.3
"""Least distance of the sets of the rules' input [decades]."""

PRECISION, ROUGH = 1e-2, 3e-2
"""By how much of themselves a tolerance, and a share of the feeds, may be off [-]: times go as the
root of the one, and are far apart by the other."""


@dataclass(frozen=True, kw_only=True, repr=False)
class RuledFeed(ToleranceFeed):
    """`ToleranceFeed` with the rules that its law comes from: guard and approach are the same.

    The sets of the input lie evenly over the decades of contour error; each lowers the logarithm
    of the feed by half of their distance.

    Parameters
    ----------
    centroid : bool
        Whether centroids are taken, as Mamdani does, instead of the mean of the rules' levels
        weighted by their memberships.
    """

    centroid: bool = False

    def _ratio(self, path: SampledPath) -> Array:
        # What the law answers before the slope says what the rules are told.
        excess = -2.0 * np.log10(ToleranceFeed._ratio(replace(self, approach_slope=0.0), path))
        sets = range(len(CURVATURE_SETS))
        gap = max(GAP_MIN, 1.02 * float(excess.max()) / sets[-1])  # the last one does not saturate
        levels = len(RATIO_SETS) - 1
        system = Mamdani(
            tuple(float(i) for i in sets),
            tuple(0.5 * i for i in range(len(VARIATION_SETS))),
            tuple(0.5 * (i - levels) for i in range(levels + 1)),
            tuple((levels - i,) * len(VARIATION_SETS) for i in sets),
        )
        if self.centroid:
            decades = gap * tabulated(system)(excess / gap, np.zeros(len(excess)))
        else:
            level = [system.output[row[0]] for row in system.rules]
            decades = gap * np.interp(excess / gap, system.first, level)
        return self._gentle(path, 10.0**decades)


@dataclass(frozen=True)
class Seen:
    """Largest contour error [m] and time [s]."""

    error: float
    duration: float


@dataclass(frozen=True)
class Method:
    """A way to choose feeds.

    Parameters
    ----------
    name, part : str
        As of `Way`.
    scheduler : callable
        Makes the scheduler of a tolerance [m].
    knob : str
        `tolerance`; `scale`, a share of the programmed feeds; `acceleration`, the limit of path
        and axes that leaves a tolerance, at the programmed feeds.
    """

    name: str
    part: str
    scheduler: Callable[[float], Scheduler]
    knob: str = 'tolerance'


def _of_tolerance(kind: type[ToleranceFeed], tolerance: float, **options: bool) -> ToleranceFeed:
    return kind(
        feed_max=CONFIG.feed_max,
        tolerance=tolerance,
        machine_constant=CONFIG.machine_constant,
        **options,  # type: ignore[arg-type]
    )


def _law_alone(tolerance: float) -> Scheduler:
    return ConstantNormalAcceleration(
        feed_max=CONFIG.feed_max, normal_acceleration=tolerance / CONFIG.machine_constant
    )


METHODS = (
    Method(
        'published rules (Mamdani)', FUZZY, lambda _: FuzzyScheduler(feed_max=CONFIG.feed_max),
        'scale',
    ),
    Method('rules of log_fuzzy, weighted mean', FUZZY, partial(_of_tolerance, RuledFeed)),
    Method(
        'rules of log_fuzzy, centroids', FUZZY,
        partial(_of_tolerance, RuledFeed, centroid=True),
    ),
    Method('sqrt(eps / m C kappa), guard and approach: the default', LAW,
           partial(_of_tolerance, ToleranceFeed)),
    Method('sqrt(eps / C kappa) alone', PLAIN, _law_alone),
    Method(
        'constant share of the programmed feed', PLAIN,
        lambda _: ConstantFeed(feed_max=CONFIG.feed_max), 'scale',
    ),
    Method(
        'lowered acceleration, eps / C', PLAIN,
        lambda _: ConstantFeed(feed_max=CONFIG.feed_max), 'acceleration',
    ),
)  # fmt: skip


class Curve:
    """A curve of the literature at the feed of the default configuration.

    Parameters
    ----------
    name : str
        Of `CURVES`.
    """

    def __init__(self, name: str) -> None:
        self.name, self._path = name, curve_path(name)
        make, scale = CURVES[name]
        curve, at = make(scale), np.linspace(0.0, 1.0, POINTS)
        first, second = curve.derivative(at), curve.derivative(at, 2)
        square = (first**2).sum(axis=1, keepdims=True)
        bend = (second - first * (first * second).sum(axis=1, keepdims=True) / square) / square
        self._geometry = PathGeometry.from_samples(
            curve.point(at), first, bend, self._path.arc_length
        )

    def drive(self, method: Method, setting: float) -> Seen:
        """Drive it at a setting of the method's knob."""
        path = self._path
        if method.knob == 'scale':
            feed = setting * method.scheduler(0.0).feed(path.sampled)
        elif method.knob == 'tolerance':
            feed = method.scheduler(setting).feed(path.sampled)
        else:
            most = setting / CONFIG.machine_constant
            limits = MotionLimits(
                path_velocity=CONFIG.feed_max, path_acceleration=most, acceleration=(most, most)
            )
            feed = limit_motion(self._geometry, CONFIG.feed_max, limits).speed_at(path.arc_length)
        run = simulate_contouring(path.contour, path.arc_length, feed)
        return Seen(run.error_max, run.duration)


class ProgramStretch:
    """The beginning of a part program, at its own feeds at most.

    Parameters
    ----------
    path : Path
        The program.
    seconds : float
        How much of it [s].
    """

    def __init__(self, path: Path, seconds: float) -> None:
        self.name = path.stem
        reader, blocks, time = ProgramReader('mm'), [], 0.0
        with open(path, encoding='utf-8', errors='surrogateescape', newline='') as file:
            for block in reader.blocks(file):
                blocks.append(block)
                segment = block.segment
                if segment is not None and segment.schedulable:
                    time += segment.length / segment.feed
                if time > seconds:
                    break
        self._program = Program(tuple(blocks), reader.notes)
        self._settings, self._machine = program_settings(CONFIG), ContouringConfig()
        self._whole: dict[str, tuple[ScheduledPath, ...]] = {}

    def drive(self, method: Method, setting: float) -> Seen:
        """Drive it at a setting of the method's knob."""
        if method.knob == 'tolerance':
            settings = replace(self._settings, scheduler=method.scheduler(setting))
            return self._driven(schedule_program(self._program, settings).paths, settings)
        settings = replace(self._settings, scheduler=method.scheduler(0.0))
        if method.name not in self._whole:
            self._whole[method.name] = schedule_program(self._program, settings).paths
        whole = self._whole[method.name]
        if method.knob == 'scale':
            return self._driven([replace(one, feed=setting * one.feed) for one in whole], settings)
        most, limits = setting / CONFIG.machine_constant, settings.limits
        lowered = replace(
            limits,
            path_acceleration=min(limits.path_acceleration, most),
            acceleration=tuple(min(one, most) for one in limits.acceleration or ()),
        )
        return self._driven(whole, replace(settings, limits=lowered))

    def _driven(self, paths: Sequence[ScheduledPath], settings: ProgramSettings) -> Seen:
        found = drive_paths(paths, settings, self._machine)
        return Seen(found.error, found.duration)


def at_error(place: Curve | ProgramStretch, method: Method, error: float) -> Seen | None:
    """Turn a method's knob until the largest contour error is this one.

    Parameters
    ----------
    place : Curve or ProgramStretch
        What is driven.
    method : Method
        The way.
    error : float
        Error [m], less than the programmed feeds leave.

    Returns
    -------
    Seen or None
        None if the way does not get there; less error where all that it allows leaves less.
    """

    def drive(setting: float) -> SimpleNamespace:
        seen = place.drive(method, setting)
        return SimpleNamespace(error=np.array([seen.error]), duration=seen.duration)

    low, high, guess, precision = *TOLERANCES, error, PRECISION
    if method.knob == 'scale':
        most = place.drive(method, 1.0)
        if most.error <= error:
            return most
        low, high, precision = SCALE_MIN, 1.0, ROUGH
        guess = max(sqrt(error / most.error), SCALE_MIN)
    try:
        run = knob_at_error(drive, error, guess, precision=precision, low=low, high=high).run
    except UnreachableToleranceError:
        return None
    return Seen(float(run.error[0]), run.duration)


def worth_of_rules(
    places: Sequence[Curve | ProgramStretch],
    errors: Sequence[float],
    title: str,
) -> Part:
    """Compare all ways on paths.

    Parameters
    ----------
    places : sequence of Curve or ProgramStretch
        Paths.
    errors : sequence of float
        Largest contour errors to compare at [m].
    title : str
        What the paths are.
    """
    cases, nothing, found = [], [], {method.name: [] for method in METHODS}
    asked: dict[str, list[float]] = {method.name: [] for method in METHODS}
    still = next(method for method in METHODS if method.knob == 'scale' and method.part == PLAIN)
    for place in places:
        start = place.drive(still, 1.0)
        for error in errors:
            cases.append(f'{place.name}, {1e6 * error:.0f} um')
            times = {m.name: at_error(place, m, error) for m in METHODS}
            law = times[next(m.name for m in METHODS if m.part == LAW)]
            unit = law.duration if law else inf
            for method in METHODS:
                seen = times[method.name]
                found[method.name].append(seen.duration / unit if seen else inf)
                kept = UNKNOWN
                if method.knob != 'scale':
                    kept = place.drive(method, error).error / error
                asked[method.name].append(kept)
            nothing.append((start.duration / unit, start.error / error))
    ways = [
        Way(m.name, m.part, {TIME: tuple(found[m.name]), KEPT: tuple(asked[m.name])})
        for m in METHODS
    ]
    time, left = zip(*nothing, strict=True)
    figures = {TIME: time, KEPT: left}
    ways.append(Way('programmed feeds', NOTHING, figures, counted=False))
    return Part(title, tuple(cases), tuple(ways))


def identity() -> float:
    """Return by how much of itself `RuledFeed` differs from v = sqrt(eps / (m C kappa)) at most.

    With guard and approach off, on the butterfly at 50 um.
    """
    path = SampledPath.from_points(butterfly(0.875).point(np.linspace(0.0, 1.0, POINTS)))
    bare = RuledFeed(
        feed_max=CONFIG.feed_max,
        tolerance=CURVE_ERRORS[0],
        machine_constant=CONFIG.machine_constant,
        guard_length=0.0,
        guard_step=0.0,
        approach_time=0.0,
        approach_slope=0.0,
    )
    law = ConstantNormalAcceleration(
        feed_max=bare.feed_max,
        normal_acceleration=bare.tolerance / (bare.margin * bare.machine_constant),
    )
    return float(np.abs(bare.feed(path) / law.feed(path) - 1.0).max())


def curves(quick: bool) -> Part:
    """Compare all ways on the curves of the literature."""
    found = worth_of_rules(
        [Curve(name) for name in (['infinity'] if quick else CURVES)],
        CURVE_ERRORS[-1:] if quick else CURVE_ERRORS,
        f'Feedrate: curves at {6e4 * CONFIG.feed_max:,.0f} mm/min',
    )
    note = (
        'rules with guard and approach off differ from sqrt(eps / m C kappa) by at most '
        f'{identity():.0e} of itself'
    )
    return replace(found, notes=(note,))


def programs(folder: Path, quick: bool) -> Part:
    """Compare all ways on the beginnings of part programs in a folder, at their own feeds.

    Raises
    ------
    FileNotFoundError
        If a program is not there.
    """
    stretch = 0.2 * STRETCH if quick else STRETCH
    names = PROGRAMS[2:3] if quick else PROGRAMS
    return worth_of_rules(
        [ProgramStretch(folder / name, stretch) for name in names],
        PROGRAM_ERRORS[-1:] if quick else PROGRAM_ERRORS,
        'Feedrate: part programs at their own feeds',
    )
