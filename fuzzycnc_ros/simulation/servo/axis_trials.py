# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Controllers of an axis tuned by trials on the axis itself, each near to one that was stable."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf, sqrt

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.identify.robustness import ROBUST_GAINS, AxisModels
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.core.servo.axis_control import (
    AXIS_CONTROLLERS,
    SETTINGS,
    UNTUNED_CONTROLLER,
    setting_ranges,
    untuned_settings,
)
from fuzzycnc_ros.core.servo.course import AxisFigures
from fuzzycnc_ros.simulation.servo.axis_tuning import (
    AxisCase,
    AxisTuning,
    TunedController,
    case_cost,
    settings_at,
    stiff_settings,
    tuning_cost,
    untold_controller,
)

TRIAL_GAINS = (1.0, 1.6, 0.45)
"""Factors on the duty in a trial, in this order: a little beyond half and one and a half times the
gain, which the loop has to bear."""

_PACE, _SHARE, _TIME = 0.5, 0.2, 0.4
"""Pace of a trial, and its way: share of the travel, at most that of so long at full velocity
[s]."""

_STEP, _FINEST = 1.35, 1.06
"""First and last factor by which a setting is changed from trial to trial: from a loop that was
stable at 1.6 times its gain, the next one begins without that factor."""

_CANDIDATES = 4
"""Candidates per setting in the search for the stiffest loop that is stable on all models."""

_BETTER = 0.99
"""Ratio of costs from which on a change is kept [-]."""

_HOPELESS = 2.0
"""Ratio of the costs of the first case from which on the others are not tried [-]."""

_ROOM, _COUNTS = 4.0, 50.0
"""Following error at which a trial ends: multiple of the best one's largest, and counts."""

_FIRST = 0.6
"""Share of the trials that the most promising controller gets; the rest is the second's."""

Drive = Callable[[str, Mapping[str, float], AxisCase, float], AxisFigures]
"""Tries a controller with settings in a case, up to a following error [m]; figures of one that
ended before its time have the reason as `fault`."""


@dataclass(frozen=True)
class _Found:
    """A controller that made all cases."""

    name: str
    settings: dict[str, float]
    figures: tuple[AxisFigures, ...]
    cost: float


class TrialSearch:
    """Search for the controller of an axis by motion on it.

    Parameters
    ----------
    data : AxisData
        The axis, with a plant.
    drive : callable
        Tries a controller on the axis.
    trials : int
        Controllers that are tried at most; each makes up to three ways there and back.
    kinds : sequence of str
        Which controllers may be tried, of `AXIS_CONTROLLERS`.
    progress : callable, optional
        Told after every one: which, of how many.
    """

    def __init__(
        self,
        data: AxisData,
        drive: Drive,
        *,
        trials: int = 48,
        kinds: Sequence[str] = AXIS_CONTROLLERS,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        self._data, self._drive, self._trials, self._kinds = data, drive, trials, kinds
        self._progress = progress
        self._cases = trial_cases(data)
        plant = data.known_plant()
        self._models = AxisModels(data) if isinstance(plant, BallscrewAxisConfig) else None
        self._found: list[_Found] = []
        self._tried: set[tuple[str, tuple[float, ...]]] = set()
        self.reasons: list[str] = []
        """Why controllers were given up on the axis."""

    def run(self) -> AxisTuning:
        """Search; return the best of each kind that was tried, and what was there first.

        Raises
        ------
        ValueError
            If none made its way.
        """
        present, *starts = self._starts()
        self._try(*present, sure=True)
        first = self._found[0] if self._found else None
        for name, settings in starts:
            if len(self._tried) < self._trials:
                self._try(name, settings)
        if not self._found:
            raise ValueError(
                'expected a controller that makes its way on the axis at half to one and a half '
                f'times the gain but found none: {self.reasons[-1]}'
            )
        rank = sorted({one.name for one in self._found}, key=lambda name: self._best(name).cost)
        left = self._trials - len(self._tried)
        for name, share in zip(rank[:2], (_FIRST if len(rank) > 1 else 1.0, 1.0), strict=False):
            self._improve(name, len(self._tried) + round(share * left))
            left = self._trials - len(self._tried)
        bests = [self._best(name) for name in AXIS_CONTROLLERS if name in rank]
        return AxisTuning(
            tuple(
                TunedController(
                    one.name,
                    one.settings,
                    one.cost,
                    0 if one is first else len(self._tried),
                    one.figures,
                    one.cost,
                )
                for one in (*bests, *([first] if first and first not in bests else []))
            ),
            self._cases,
        )

    def _best(self, name: str = '') -> _Found:
        return min(
            (one for one in self._found if one.name == name or not name), key=lambda one: one.cost
        )

    def _starts(self) -> Iterator[tuple[str, dict[str, float]]]:
        """Yield what is there, what is untuned, and the stiffest that is stable on all models."""
        data, plain = self._data, untuned_settings(self._data)
        yield data.controller or UNTUNED_CONTROLLER, plain | dict(data.settings)
        for name in self._kinds:
            if self._models is not None:
                ranges = setting_ranges(data, name, SETTINGS)
                judge = partial(self._models.judge, spread=False)
                stiff = stiff_settings(data, name, ranges, judge, _CANDIDATES, 0)
                yield name, settings_at(ranges, stiff[0])
            yield name, plain

    def _improve(self, name: str, until: int) -> None:
        """Change one setting at a time as long as that helps, by ever smaller factors."""
        ranges = setting_ranges(self._data, name, SETTINGS)
        step, up = _STEP, set(SETTINGS)
        while step >= _FINEST and len(self._tried) < until:
            before = self._best(name)
            for key, (low, high, _) in ranges.items():
                for _ in range(2):
                    now = self._best(name)
                    value = now.settings[key] * (step if key in up else 1.0 / step)
                    changed = {**now.settings, key: min(max(value, low), high)}
                    if len(self._tried) < until:
                        self._try(name, changed)
                    if self._best(name) is not now:
                        break
                    up ^= {key}
            if self._best(name) is before:
                step = sqrt(step)

    def _try(self, name: str, settings: dict[str, float], *, sure: bool = False) -> None:
        """Try a controller on the axis, unless it was, or nothing shows that it is stable."""
        key = name, tuple(round(portable.log(value), 6) for value in settings.values())
        if key in self._tried or not (sure or self._has_margin(name, settings)):
            return
        self._tried.add(key)
        figures: list[AxisFigures] = []
        for number, case in enumerate(self._cases):
            best = self._best() if self._found else None
            one = self._drive(name, settings, case, self._room(case, best, number))
            if one.fault:
                self.reasons.append(one.fault)
                break
            figures.append(one)
            if best is not None and case_cost(self._data, one) > _HOPELESS * case_cost(
                self._data, best.figures[number]
            ):
                break
        if len(figures) == len(self._cases):
            cost = tuning_cost(self._data, figures)
            if not self._found or cost < _BETTER * min(
                (one.cost for one in self._found if one.name == name), default=inf
            ):
                self._found.append(_Found(name, settings, tuple(figures), cost))
        if self._progress is not None:
            self._progress(len(self._tried), self._trials)

    def _room(self, case: AxisCase, best: _Found | None, number: int) -> float:
        """Return the following error at which a trial ends [m]."""
        counts = _COUNTS * self._data.known_plant().count
        if best is None:
            return 0.25 * abs(case.way) + counts
        return _ROOM * best.figures[number].largest + counts

    def _has_margin(self, name: str, settings: dict[str, float]) -> bool:
        """Return True if all models, or a loop next to it on the axis, show that it is stable."""
        most = portable.log(_STEP) + 1e-6
        if any(
            one.name == name
            and one.settings.keys() == settings.keys()
            and all(
                abs(portable.log(settings[key] / value)) <= most
                for key, value in one.settings.items()
            )
            for one in self._found
        ):
            return True
        made = untold_controller(self._data, name, settings)
        if self._models is not None:
            return self._models.margin(made).robust
        return all(made.settles(gain) for gain in ROBUST_GAINS)


def trial_cases(data: AxisData) -> tuple[AxisCase, ...]:
    """Return the ways there and back of a trial on an axis, towards the middle of its travel."""
    travel = data.limits.travel_high - data.limits.travel_low
    way = min(_SHARE * travel, _TIME * data.limits.positioning[0])
    return tuple(AxisCase(way=way, gain=gain, pace=_PACE) for gain in TRIAL_GAINS)
