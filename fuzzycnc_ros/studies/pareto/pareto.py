# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Time against contour error of every scheduling method, on the simulated machine.

Each method is turned by its own knob, as a user would: the tolerance where it knows one, its
chord error, or the feed.  docs/explanation/methods/feedrate.md has the tables.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import exp, log, log10, sqrt
from types import MappingProxyType

import numpy as np

from fuzzycnc_ros.components.motion.feedrate_scheduler_config import (
    FeedrateSchedulerConfig,
    make_scheduler,
)
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.motion.contouring import ContouringRun, simulate_contouring
from fuzzycnc_ros.studies.page.document import shown_as
from fuzzycnc_ros.studies.pareto.pareto_path import ParetoPath
from fuzzycnc_ros.studies.pareto.refinement import (
    UnreachableToleranceError,
    knob_at_error,
    refine,
)

KNOBS: Mapping[str, str] = MappingProxyType(
    {
        'constant': 'feed_max',
        'fuzzy': 'feed_max',
        'log_fuzzy': 'tolerance',
        'normal_acceleration': 'tolerance',
        'chord_error': 'chord_error',
        'look_ahead': 'tolerance',
        'jerk_limited': 'tolerance',
        'refined': 'tolerance',
    }
)
"""Methods, and the parameter of `feedrate_scheduler` that each is turned by."""

REFINED = 'refined'
"""Rounds of refinement against the measured error, from `log_fuzzy` on: the practical bound."""

ERRORS = (1e-5, 5e-5, 1e-4)
"""Contour errors at which the methods are compared [m]."""

DURATION_MAX = 600.0
"""Time above which a schedule does not count [s]."""

_SEARCHED = 2.5
"""Schedules so many times as long are still driven: the search halves a feed at most."""

SWEPT = 12
"""Errors of a curve, from half of the least to twice the largest that is compared."""

Progress = Callable[[str, int, int], None]
"""Told what is going on, steps done and in all."""


@dataclass(frozen=True)
class ParetoPoint:
    """A schedule: its largest contour error [m] and its time [s]."""

    error: float = field(metadata=shown_as('error_mm', 1e3))
    duration: float = field(metadata=shown_as('time_s'))


@dataclass(frozen=True)
class MethodCurve:
    """Trade-off curve of a method.

    Attributes
    ----------
    points : tuple of ParetoPoint
        Schedules, by increasing error.
    at_error : mapping of float to float or None
        Time at each compared error [s]; None where it cannot be reached.
    reasons : mapping of float to str
        Why it cannot.
    """

    points: tuple[ParetoPoint, ...]
    at_error: Mapping[float, float | None]
    reasons: Mapping[float, str]


@dataclass(frozen=True)
class Pareto:
    """Time against contour error of all methods on a path.

    Attributes
    ----------
    path : str
        Which path.
    errors : tuple of float
        Errors at which the methods are compared [m].
    methods : mapping of str to MethodCurve
        Curves by method.
    limits : ParetoPoint
        Full feed everywhere: what the machine's acceleration along the path alone allows.
    """

    path: str
    errors: tuple[float, ...]
    methods: Mapping[str, MethodCurve]
    limits: ParetoPoint


class _TooSlowError(ValueError):
    """A schedule takes longer than anyone would wait for."""


def pareto_of(
    path: ParetoPath,
    config: FeedrateSchedulerConfig | None = None,
    machine: ContouringConfig | None = None,
    *,
    errors: Sequence[float] = ERRORS,
    methods: Sequence[str] = tuple(KNOBS),
    progress: Progress = lambda text, done, total: None,
) -> Pareto:
    """Measure time against contour error.

    Parameters
    ----------
    path : ParetoPath
        The path.
    config : FeedrateSchedulerConfig, optional
        Parameters of the methods, but for the one that each is turned by.
    machine : ContouringConfig, optional
        The simulated machine.
    errors : sequence of float
        Largest contour errors at which the methods are compared [m], positive.
    methods : sequence of str
        Some of `KNOBS`.
    progress : callable
        Told after each schedule that is looked for.

    Returns
    -------
    Pareto
        Curves, and times at equal error.
    """
    compared = tuple(sorted(set(errors)))
    low, high = 0.5 * compared[0], 2.0 * compared[-1]
    others = [
        error
        for error in np.geomspace(low, high, SWEPT).tolist()
        if all(abs(log(error / one)) > 0.05 for one in compared)
    ]
    stand = _Stand(path, config or FeedrateSchedulerConfig(), machine or ContouringConfig())
    limits = stand.full_feed()
    total = len(methods) * (len(compared) + len(others))
    curves = {}
    for number, method in enumerate(methods):
        begun = number * (len(compared) + len(others))

        def tell(done: int, method: str = method, begun: int = begun) -> None:
            progress(method, begun + done, total)

        rider = _Refinement(stand) if method == REFINED else _Knob(stand, method)
        curves[method] = _curve(rider, compared, others, tell)
    return Pareto(path.name, compared, curves, limits)


class _Stand:
    """A path on a machine, on which schedules are driven."""

    def __init__(
        self, path: ParetoPath, config: FeedrateSchedulerConfig, machine: ContouringConfig
    ) -> None:
        self.path, self.config, self.machine = path, config, machine
        self.sharpest = float(path.sampled.curvature.max())

    @property
    def feed_max(self) -> float:
        """Largest feed [m/s]: the schedulers', but no more than the machine has."""
        return min(self.config.feed_max, self.machine.velocity_max)

    def feed(self, method: str, knob: str, setting: float) -> Array:
        """Return the schedule of a method at a setting of its knob [m/s]."""
        settings = {'feed_max': self.feed_max, 'method': method, knob: setting}
        scheduler = make_scheduler(replace(self.config, **settings))  # type: ignore[arg-type]
        return scheduler.feed(self.path.sampled)

    def drive(self, feed: Array) -> ContouringRun:
        """Drive a schedule and measure it."""
        step = np.diff(self.path.arc_length)
        if float((2.0 * step / (feed[1:] + feed[:-1])).sum()) > _SEARCHED * DURATION_MAX:
            raise _TooSlowError
        return simulate_contouring(self.path.contour, self.path.arc_length, feed, self.machine)

    def full_feed(self) -> ParetoPoint:
        """Drive at full feed."""
        run = self.drive(np.full(len(self.path.arc_length), self.feed_max))
        return ParetoPoint(run.error_max, run.duration)


class _Knob:
    """A method that is turned by one knob."""

    def __init__(self, stand: _Stand, method: str) -> None:
        self._stand, self._method, self._knob = stand, method, KNOBS[method]
        self._known: dict[float, ParetoPoint] = {}
        config = stand.config
        self._low, self._high = {
            'feed_max': (config.feed_min, stand.feed_max),
            'tolerance': (1e-8, 1e-2),
            'chord_error': (1e-10, 1e-2),
        }[self._knob]

    def at(self, error: float) -> ParetoPoint:
        """Turn the knob until the largest contour error is this one."""
        found = knob_at_error(
            self._drive, error, self._guess(error), low=self._low, high=self._high
        )
        return ParetoPoint(found.run.error_max, found.run.duration)

    def near(self, error: float) -> ParetoPoint:
        """Turn the knob to where the error should be near this one, by those known."""
        self._drive(self._guess(error))
        return self._known[self._guess_made]

    def _guess(self, error: float) -> float:
        """Return the setting that should lead to an error."""
        self._guess_made = min(max(self._expected(error), self._low), self._high)
        return self._guess_made

    def _expected(self, error: float) -> float:
        if len(self._known) > 1:
            by_error = sorted((point.error, knob) for knob, point in self._known.items())
            values = np.log(np.array(by_error))
            return exp(_line(log(error), values[:, 0], values[:, 1]))
        config = self._stand.config
        allowed = error / config.machine_constant
        if self._knob == 'tolerance':
            return error
        if self._knob == 'chord_error':
            return allowed * config.period**2 / 8.0
        # slow enough to be driven at all
        slowest = self._stand.path.contour.length / (0.2 * DURATION_MAX)
        return max(sqrt(allowed / self._stand.sharpest), slowest)

    def _drive(self, setting: float) -> ContouringRun:
        run = self._stand.drive(self._stand.feed(self._method, self._knob, setting))
        self._known[setting] = ParetoPoint(run.error_max, run.duration)
        return run


class _Refinement:
    """The default method, refined against the error that it leaves."""

    def __init__(self, stand: _Stand) -> None:
        self._stand = stand

    def at(self, error: float) -> ParetoPoint:
        """Refine for a largest contour error."""
        stand = self._stand
        refined = refine(
            stand.feed('log_fuzzy', 'tolerance', error),
            stand.path.arc_length,
            stand.drive,
            error,
            feed_max=stand.feed_max,
        )
        if refined.run.error_max < 0.98 * error:
            raise UnreachableToleranceError
        return ParetoPoint(refined.run.error_max, refined.run.duration)

    near = at


def _curve(
    rider: _Knob | _Refinement,
    compared: Sequence[float],
    others: Sequence[float],
    tell: Callable[[int], None],
) -> MethodCurve:
    """Measure a method at the compared errors, then between and beyond them."""
    points: list[ParetoPoint] = []
    times: dict[float, float | None] = {}
    reasons: dict[float, str] = {}
    for number, error in enumerate([*compared, *others]):
        wanted = number < len(compared)
        try:
            point = rider.at(error) if wanted else rider.near(error)
            if point.duration > DURATION_MAX:
                raise _TooSlowError
        except _TooSlowError:
            reasons[error] = f'would take more than {DURATION_MAX:g} s'
        except UnreachableToleranceError:
            reasons[error] = 'leaves less at full feed'
        else:
            points.append(point)
            times[error] = point.duration
        tell(number + 1)
    return MethodCurve(
        _distinct(points),
        {error: times.get(error) for error in compared},
        {error: reasons[error] for error in compared if error in reasons},
    )


def _distinct(points: Sequence[ParetoPoint]) -> tuple[ParetoPoint, ...]:
    """Return points by error, without those that are the same to four digits."""
    found: list[ParetoPoint] = []
    for point in sorted(points, key=lambda point: (point.error, point.duration)):
        if not found or log10(point.error / found[-1].error) > 1e-4:
            found.append(point)
    return tuple(found)


def _line(at: float, x: Array, y: Array) -> float:
    """Return a value on the line through points, which goes on beyond them."""
    if x[0] < x[-1] and not x[0] <= at <= x[-1]:
        end = 0 if at < x[0] else -1
        slope = (y[-1] - y[0]) / (x[-1] - x[0])
        return float(y[end] + slope * (at - x[end]))
    return float(np.interp(at, x, y))
