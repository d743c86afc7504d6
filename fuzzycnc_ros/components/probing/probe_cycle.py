# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `probe_cycle`: touches of a probing cycle in, displacement out.

The first cycle after a thermal reference is the zero of those that follow.  The control is told
when a cycle is due; it is the program that calls it.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.probing.evaluation import Coordinates, CycleLimits, coordinates
from fuzzycnc_ros.core.probing.plan import ProbePlan
from fuzzycnc_ros.runtime.component import (
    LATCHED,
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.enums import TouchKind
from fuzzycnc_ros.runtime.records import (
    SECOND,
    CompensationApplied,
    Displacement,
    Floats,
    ProbeCycleState,
    ProbeStatus,
    ProbeTouch,
    Record,
    Stamp,
    ThermalReference,
    nanoseconds,
)

NO_PLAN = 'no plan of a cycle; set the parameter probe_file'


@dataclass(frozen=True, kw_only=True)
class ProbeCycleConfig(Config):
    """Parameters of `probe_cycle`."""

    probe_file: str = param(
        '', '-', 'File that says what is probed, as for `fuzzycnc probe write`; required'
    )
    result_file: str = param(
        '',
        '-',
        'File into which the control writes results; empty where a bridge brings them',
    )
    result_offset: bool = param(
        False, '-', 'Coordinates in the result file contain the offset in force'
    )
    spread_max: float = param(
        5e-6,
        'm',
        'Distance of a touch from the median of its repeats beyond which it does not count',
        low=1e-7,
        high=1e-3,
        live=True,
    )
    size_max: float = param(
        10e-6,
        'm',
        'Change of the distance of two sides beyond which something lies between',
        low=1e-7,
        high=1e-3,
        live=True,
    )
    window: float = param(
        0.5e-3,
        'm',
        'Distance from where a surface is expected beyond which something else was touched',
        low=1e-5,
        high=1e-2,
        live=True,
    )
    drift_max: float = param(
        200e-6, 'm', 'Largest thermal error that can be', low=1e-6, high=1e-2, live=True
    )
    touch_noise: float = param(
        0.3e-6, 'm', 'Least standard deviation of one touch', low=1e-9, high=1e-4, live=True
    )
    zero_time: float = param(
        900.0,
        's',
        'Time after a thermal reference in which the zero has to be probed',
        low=1.0,
        high=86400.0,
        live=True,
    )
    interval_min: float = param(
        600.0,
        's',
        'Time after a cycle in which no other one is due',
        low=0.0,
        high=86400.0,
        live=True,
    )
    failures_max: int = param(
        3,
        '-',
        'Cycles in a row that were not used after which none is due until one is',
        low=1,
        high=100,
        live=True,
    )
    cycle_time_max: float = param(
        1800.0,
        's',
        'Time after which a cycle without end was broken off',
        low=1.0,
        high=86400.0,
    )


class ProbeCycle(Component[ProbeCycleConfig]):
    """Check the touches of each cycle, tell what they mean, and when the next one is due."""

    NAME = 'probe_cycle'
    SUMMARY = (
        'Checks the touches of a probing cycle, publishes displacement, and reports when a cycle '
        'is due.'
    )
    CONFIG = ProbeCycleConfig
    APPLIED = Input('compensation_applied', CompensationApplied, quiet=True, sole=True)
    STATUS = Input('probe_status', ProbeStatus, LATCHED, paced=False)
    REFERENCE = Input('thermal_reference', ThermalReference, LATCHED)
    INPUTS = (
        REFERENCE,
        APPLIED,
        STATUS,
        Input('probe_touch', ProbeTouch, driving=True, sole=True, paced=False),
    )
    OUTPUTS = (
        Output('displacement', Displacement),
        Output('probe_cycle_state', ProbeCycleState, LATCHED, persistent=True),
    )

    def __init__(self, config: ProbeCycleConfig | None = None) -> None:
        super().__init__(config)
        self._plan: ProbePlan | None = None
        self._touches: list[float] | None = None
        """Positions at each touch of the cycle under way, the machine's offset included [m]."""
        self._begun: Stamp = 0
        self._touched: Stamp = 0
        self._ended: Stamp | None = None
        self._zero: Coordinates | None = None
        self._zero_of: tuple[int, Stamp] = (0, 0)
        """Signature of the plan, and thermal reference, that the zero belongs to."""
        self._outcome, self._accepted, self._failures = '', True, 0
        self._told: tuple[bool, str] | None = None
        self._news = True
        self._tell_at: Stamp | None = None

    # What comes in.

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """Take the plan of the cycle by `use_plan`."""
        if name != 'use_plan':
            return super().on_request(name, arguments, stamp)
        try:
            self._plan = ProbePlan.from_json(str(arguments['plan']))
        except ValueError as error:
            return Answer(False, str(error))
        self._touches, self._news = None, True
        text = f'{self._plan.count} touches, signature {self._plan.signature}'
        return Answer(True, text, tuple(self._tell(stamp)))

    def restore(self, output: str, record: Record) -> None:
        """Take back the zero."""
        if isinstance(record, ProbeCycleState):
            self._zero = Coordinates(record.zero, record.size, record.noise, ())
            self._zero_of = record.signature, record.reference_stamp
            self._failures, self._outcome = record.failures, record.outcome
            self._accepted = record.accepted

    def on_thermal_reference(self, reference: ThermalReference) -> None:
        """Tell anew what is due: errors are counted from now on."""
        self._tell_at = reference.stamp

    def on_probe_status(self, status: ProbeStatus) -> None:
        """Tell anew what is due."""
        self._tell_at = status.stamp

    def on_probe_touch(self, touch: ProbeTouch) -> Iterator[Emission]:
        """Take a touch; at the end of a cycle tell what it means."""
        plan = self._plan
        if plan is None:
            return
        if touch.kind == TouchKind.BEGIN:
            if self._touches is not None:
                self._fail(touch.stamp, 'the cycle before was broken off')
            self._touches, self._begun = [], touch.stamp
            if touch.number != plan.signature:
                self._fail(
                    touch.stamp,
                    f'expected a program with the signature {plan.signature} but found '
                    f'{touch.number}; write it anew from probe_file (`fuzzycnc probe write`)',
                )
                yield from self._tell(touch.stamp)
            return
        if self._touches is None:
            return  # the rest of a cycle that is not used
        if touch.kind == TouchKind.TOUCH:
            if touch.number == len(self._touches) + 1 <= plan.count:
                axis = plan.place_of(touch.number).axis
                unseen = not touch.includes_offset
                offset = self._offset(axis, touch.position) if unseen else 0.0
                self._touches.append(touch.position + offset)
                self._touched = touch.stamp
                return
            self._fail(touch.stamp, f'touch {len(self._touches) + 1} was not heard')
        elif touch.kind == TouchKind.MISS:
            self._fail(touch.stamp, self._missed(plan, touch.number))
        elif len(self._touches) < plan.count:
            self._fail(touch.stamp, f'ended after {len(self._touches)} of {plan.count} touches')
        else:
            yield from self._evaluate(plan, np.array(self._touches))
        yield from self._tell(touch.stamp)

    @property
    def next_deadline(self) -> int | None:
        """Time at which a due probe or the end of a broken-off cycle is to be reported."""
        times = [self._tell_at]
        if self._touches is not None:
            times.append(self._begun + nanoseconds(self._config.cycle_time_max))
        if self._ended is not None:
            times.append(self._ended + nanoseconds(self._config.interval_min))
        return min((time for time in times if time is not None), default=None)

    def on_deadline(self, stamp: int) -> Iterable[Emission]:
        """Tell what is due, if that is news, and that a cycle was broken off."""
        config = self._config
        begun = self._begun + nanoseconds(config.cycle_time_max)
        if self._touches is not None and stamp >= begun:
            self._fail(stamp, 'the cycle was broken off')
        if self._ended is not None and stamp >= self._ended + nanoseconds(config.interval_min):
            self._ended = None
        return tuple(self._tell(stamp))

    # What it means.

    def _evaluate(self, plan: ProbePlan, measured: Floats) -> Iterator[Emission]:
        stamp, reference = self._touched, self.last(self.REFERENCE)
        if reference is None or self._begun < reference.stamp:
            self._fail(stamp, 'no thermal reference yet; take one while the machine is at rest')
            return
        zero = self._zero if self._zero_of == (plan.signature, reference.stamp) else None
        config = self._config
        limits = CycleLimits(
            spread_max=config.spread_max,
            size_max=config.size_max,
            window=config.window,
            drift_max=config.drift_max,
            noise=config.touch_noise,
        )
        found = coordinates(plan, measured, limits, zero)
        if zero is None:
            if found.doubts:
                self._fail(stamp, f'no zero: {"; ".join(found.doubts)}')
                return
            if stamp - reference.stamp > nanoseconds(config.zero_time):
                self._fail(stamp, self._too_late(reference))
                return
            zero = self._zero = found
            self._zero_of = plan.signature, reference.stamp
        elif not np.isfinite(found.coordinate).any():
            self._fail(stamp, '; '.join(found.doubts))
            return
        self._touches, self._ended = None, stamp
        self._outcome, self._accepted = '; '.join(found.doubts), True
        self._failures, self._news = 0, True
        offset = np.array([self._offset(place.axis, place.position) for place in plan.places])
        yield Emission(
            'displacement',
            Displacement(
                stamp=stamp,
                frame_id=self.frame('workpiece'),
                axis=plan.axes,
                channel=plan.channels,
                displacement=zero.coordinate - found.coordinate + offset,
                standard_deviation=np.hypot(found.noise, zero.noise),
                includes_compensation=bool(offset.any()),
                position=np.array([place.position for place in plan.places]),
            ),
        )

    def _offset(self, axis: str, place: float) -> float:
        """Return the offset in force at a place of an axis [m], as it was read back last."""
        applied = self.last(self.APPLIED)
        offset = 0.0 if applied is None else applied.offset_at(axis, place)
        return offset if isfinite(offset) else 0.0

    @staticmethod
    def _missed(plan: ProbePlan, number: int) -> str:
        """Say where the probe missed."""
        if not 1 <= number <= plan.count:
            return 'no touch where one was expected'
        place = plan.place_of(number)
        return (
            f'{place.name}, {place.axis}: no touch where one was expected, or one on the way; '
            'look at the probe and at what it should touch'
        )

    def _too_late(self, reference: ThermalReference) -> str:
        return (
            f'no zero was probed within zero_time {self._config.zero_time:g} s after the thermal '
            f'reference at {reference.stamp / SECOND:.0f} s; take a new one while the machine is '
            'at rest, and run the cycle then'
        )

    def _fail(self, stamp: Stamp, why: str) -> None:
        """Note that a cycle is not used."""
        self._touches, self._ended = None, stamp
        self._outcome, self._accepted = why, False
        self._failures, self._news = self._failures + 1, True

    def _due(self, stamp: Stamp) -> tuple[bool, str]:
        """Return whether a cycle is due at a stamp, and why."""
        config, status, reference = self._config, self.last(self.STATUS), self.last(self.REFERENCE)
        if self._plan is None:
            return False, NO_PLAN
        if reference is None:
            return False, 'no thermal reference yet'
        if self._failures >= config.failures_max:
            return False, f'{self._failures} cycles in a row were not used; {self._outcome}'
        if self._ended is not None and stamp - self._ended < nanoseconds(config.interval_min):
            return False, 'there was one just now'
        if self._zero_of != (self._plan.signature, reference.stamp):
            if stamp - reference.stamp > nanoseconds(config.zero_time):
                return False, self._too_late(reference)
            return True, 'no cycle since the thermal reference: it is the zero of all others'
        if status is None:
            return False, 'the predictor reports nothing'
        return status.due, status.reason

    def _tell(self, stamp: Stamp) -> Iterator[Emission]:
        """Yield the state, if there is news."""
        self._tell_at = None
        news = self._due(stamp)
        if not self._news and self._told is not None and news[0] == self._told[0]:
            return
        self._told, self._news = news, False
        zero = self._zero or Coordinates(np.zeros(0), np.zeros(0), np.zeros(0), ())
        yield Emission(
            'probe_cycle_state',
            ProbeCycleState(
                stamp=stamp,
                frame_id=self.frame('machine'),
                due=news[0],
                reason=news[1],
                outcome=self._outcome,
                accepted=self._accepted,
                failures=self._failures,
                signature=self._zero_of[0],
                reference_stamp=self._zero_of[1],
                zero=zero.coordinate,
                size=zero.size,
                noise=zero.noise,
            ),
        )

    def health(self) -> list[Health]:
        """Report what became of the newest cycle, and whether one is due."""
        if self._plan is None:
            return [Health('cycle', Level.ERROR, NO_PLAN)]
        due, reason = self._told or (False, 'not known yet')
        level = Level.OK if self._accepted and not self._outcome else Level.WARN
        if self._failures >= self._config.failures_max:
            level = Level.ERROR
        text = self._outcome or ('used' if self._ended or self._zero else 'none yet')
        return [
            Health('cycle', level, text),
            Health('due', Level.OK, f'{"yes" if due else "no"}: {reason}'),
        ]
