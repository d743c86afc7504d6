# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trial of another controller on an axis: there and back, ended at the first sign of growth."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf, isfinite, nan, sqrt

from fuzzycnc_ros.components.servo.servo_axes import FROM_FILE, parse_axes
from fuzzycnc_ros.components.servo.servo_axis import ServoAxis
from fuzzycnc_ros.components.servo.servo_controller_config import (
    ServoControllerConfig,
    file_controller,
    profile_limits,
)
from fuzzycnc_ros.core.machine.machine_data import AxisData, axis_hash
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.course import AxisFigures, Course, LedCourse, there_and_back
from fuzzycnc_ros.core.servo.feedback_watch import SWINGING
from fuzzycnc_ros.core.servo.params import ServoParamsWarning
from fuzzycnc_ros.core.servo.profile import ProfileLimits
from fuzzycnc_ros.runtime.enums import MachineMode, TrialStatus
from fuzzycnc_ros.runtime.records import MachineState, ServoTrial, ServoTrialState, nanoseconds

VALIDITY = nanoseconds(0.5)
"""Time for which a trial goes on after a sign of life of its operator [ns]."""

LONGEST = 12.0
"""Longest way there and back [s]."""

CHATTER, FAST, OVER = 0.15, 0.005, 0.2
"""RMS of the duty about its mean from which on it chatters [-], and the times over which mean and
RMS are taken [s]: the quickest profile stays below."""

GAIN_MAX = 3.0
"""Largest factor on the duty [-]."""

UNSTABLE = 'expected a loop that is stable with its model'
"""Part of the refusal that is about the controller, not about the axis: another may be tried."""

AT_LIMIT = 0.1
"""Time at the limit of the drive after which a trial ends [s]: there no loop is closed."""


class AxisTrial:
    """A controller that drives an axis in the place of its own, along a course.

    Parameters
    ----------
    axis : ServoAxis
        The axis, at rest.
    asked : ServoTrial
        The trial.
    controller : AxisController
        Its controller.
    course : Course, optional
        The way there and back; by default whoever leads the axis makes it.
    travel : tuple of float
        Ends of the travel [m].
    reading : float
        Where the axis reads [m].

    Attributes
    ----------
    axis, number
        The axis, and the number of the trial.
    status, reason
        What became of it, and why it ended.
    """

    def __init__(
        self,
        axis: ServoAxis,
        asked: ServoTrial,
        controller: AxisController,
        course: Course | None,
        travel: tuple[float, float],
        reading: float,
    ) -> None:
        self.axis, self.number = axis, asked.trial
        self.status, self.reason = TrialStatus.RUNNING, ''
        self._start, self._held = axis.reference, axis.duty
        self._low, self._high = travel
        self._way, self._led = course, LedCourse(controller.period)
        self._error_max = asked.error_max
        self._until = asked.stamp + VALIDITY
        self._errors: list[float] = []
        period = controller.period
        self._at_limit, self._limit = 0, round(AT_LIMIT / period)
        self._longest = round(LONGEST / period)
        self._fast, self._over = period / FAST, period / OVER
        self._mean, self._ripple = axis.duty, 0.0
        axis.lend(controller, asked.gain, reading)
        if course is not None:
            rows = course.rows.tolist()
            axis.go([(self._start + place, speed, rise) for place, speed, rise in rows])

    @property
    def led(self) -> bool:
        """True if a trajectory makes the way."""
        return self._way is None

    def renew(self, stamp: int) -> None:
        """Take a sign of life of the operator [ns]."""
        self._until = max(self._until, stamp + VALIDITY)

    def end(self, reason: str) -> None:
        """End before its time, with the next reading."""
        self.status, self.reason = TrialStatus.ENDED, reason

    def judge(self, reading: float, forbidden: str, stamp: int) -> None:
        """Judge a period that was driven.

        Parameters
        ----------
        reading : float
            Where the axis reads [m]; NaN where it did not.
        forbidden : str
            What of the machine forbids a trial; empty if nothing does.
        stamp : int
            Machine time [ns].
        """
        if self.status != TrialStatus.RUNNING:
            return
        known = isfinite(reading)
        last = self._errors[-1] if self._errors else 0.0
        self._errors.append(self.axis.reference - reading if known else last)
        if self._way is None:
            self._led.add(self.axis.velocity != 0.0 or self.axis.acceleration != 0.0)
        reason = forbidden or self._reason(reading, stamp)
        if reason:
            self.end(reason)
        elif self._led.over if self._way is None else len(self._errors) >= len(self._way.rows):
            self.status = TrialStatus.DONE

    def restore(self, reading: float, way_back: ProfileLimits) -> None:
        """Have the controller that was there drive the axis, back to where it rested.

        Parameters
        ----------
        reading : float
            Where the axis reads [m].
        way_back : ProfileLimits
            Limits of the way back.
        """
        axis = self.axis
        if self.status == TrialStatus.DONE:
            axis.give_back(axis.duty, reading)
            axis.stop()
            return
        axis.give_back(self._held, reading)
        axis.take_over(reading)
        if self._way is None:
            return  # whoever leads it does so
        try:
            axis.go(axis.way(self._start, way_back))
        except ValueError:  # too fast for it, and too near to an end of the travel
            axis.stop()

    def state(self, stamp: int) -> ServoTrialState:
        """Return what became of it."""
        done = self.status == TrialStatus.DONE
        figures: AxisFigures | None = None
        if done:
            figures = (self._way or self._led.course).figures(self._errors)
        return ServoTrialState(
            stamp=stamp,
            axis_name=self.axis.name,
            trial=self.number,
            status=int(self.status),
            reason=self.reason,
            rms=figures.rms if figures else nan,
            largest=figures.largest if figures else nan,
            rest=figures.rest if figures else nan,
        )

    def _reason(self, reading: float, stamp: int) -> str:
        """Say why it ends now; empty while it goes on."""
        controller, duty = self.axis.controller, self.axis.duty
        swing = controller.watch.swing
        full = abs(duty) >= controller.duty_max * min(self.axis.gain, 1.0)
        self._at_limit = self._at_limit + 1 if full else 0
        self._mean += (duty - self._mean) * self._fast
        off = duty - self._mean
        self._ripple += (off * off - self._ripple) * self._over
        if stamp > self._until:
            return 'its operator gave no sign of life for 0.5 s'
        if controller.watch.fault.startswith(SWINGING):
            return controller.watch.fault
        if controller.taken_back or swing.grows or swing.lasts:
            return f'{SWINGING} ({swing.frequency:.3g} Hz)' if swing.frequency else SWINGING
        if sqrt(self._ripple) > CHATTER:
            return 'the duty chatters: the gains are too high for this axis'
        if self._at_limit >= self._limit:
            return f'the drive was at its limit for {AT_LIMIT:g} s'
        if abs(self._errors[-1]) > self._error_max:
            return f'the following error is beyond {1e3 * self._error_max:.3g} mm'
        if reading < self._low or reading > self._high:  # false for NaN
            return f'{self.axis.name} left its travel'
        if self._way is None and len(self._errors) > self._longest:
            return f'it was not there and back within {LONGEST:g} s'
        return ''


class ServoTrials:
    """Trials of the axes of a servo controller: begun where that is safe, and told of.

    Parameters
    ----------
    config : ServoControllerConfig
        Parameters of the servo controller.
    """

    def __init__(self, config: ServoControllerConfig) -> None:
        self._config, self._known = config, config.driven
        self._hashes = {
            name: axis_hash(name, self._known[name])
            for name, model in parse_axes('axes', config.axes).items()
            if model == FROM_FILE
        }
        self._trial: AxisTrial | None = None
        self._asked: ServoTrial | None = None
        self._number: int | None = None
        self._told: list[ServoTrialState] = []

    @property
    def running(self) -> bool:
        """True while a trial drives an axis, or is about to."""
        return self._trial is not None or self._asked is not None

    @property
    def led(self) -> bool:
        """True while an axis is tried that a trajectory leads."""
        return self._trial is not None and self._trial.led

    @property
    def pending(self) -> bool:
        """True if there is a trial to begin, or something to tell."""
        return self._asked is not None or bool(self._told)

    def take(self, asked: ServoTrial) -> None:
        """Take a sign of life of an operator, or the wish for another trial."""
        trial = self._trial
        if asked.trial != self._number:
            self._number = asked.trial
            self._asked = asked if asked.controller else None
            if trial is not None:
                trial.end('another trial was asked for')
            return
        if not asked.controller:
            self._asked = None
        if trial is not None and trial.status == TrialStatus.RUNNING:
            if asked.controller:
                trial.renew(asked.stamp)
            else:
                trial.end('its operator has ended it')

    def begin(
        self,
        axes: Sequence[ServoAxis],
        readings: Mapping[str, float],
        machine: MachineState | None,
        busy: str,
        stamp: int,
    ) -> None:
        """Begin the trial that was asked for, or refuse it.

        Parameters
        ----------
        axes : sequence of ServoAxis
            All axes.
        readings : mapping of str to float
            Where they read [m].
        machine : MachineState or None
            What the machine said last.
        busy : str
            Why the axes are not at rest; empty if they are.
        stamp : int
            Machine time [ns].
        """
        asked, self._asked = self._asked, None
        if asked is None:
            return
        try:
            late = stamp > asked.stamp + VALIDITY
            refusal = 'its operator gave no sign of life for 0.5 s' if late else busy
            refusal = refusal or machine_forbids(machine) or self._misfit(asked)
            if refusal:
                raise ValueError(refusal)
            axis = next(one for one in axes if one.name == asked.axis_name)
            self._trial = self._made(asked, axis, readings.get(asked.axis_name, nan))
            self._told.append(self._trial.state(stamp))
        except ValueError as error:
            self._told.append(
                ServoTrialState(
                    stamp=stamp,
                    axis_name=asked.axis_name,
                    trial=asked.trial,
                    status=int(TrialStatus.REFUSED),
                    reason=str(error),
                    rms=nan,
                    largest=nan,
                    rest=nan,
                )
            )

    def judge(
        self,
        axes: Sequence[ServoAxis],
        readings: Sequence[float],
        machine: MachineState | None,
        stamp: int,
    ) -> None:
        """Judge the trial in a period that was driven; at its end restore what was there.

        Parameters
        ----------
        axes, readings : sequence
            All axes, and where they read [m]; NaN where they did not.
        machine : MachineState or None
            What the machine said last.
        stamp : int
            Machine time [ns].
        """
        trial = self._trial
        if trial is None:
            return
        axis = trial.axis
        fault = axis.controller.watch.fault
        if axis.motion.fault or (fault and not fault.startswith(SWINGING)):
            return  # the axis is given up, not the trial alone
        reading = readings[axes.index(axis)]
        trial.judge(reading, machine_forbids(machine), stamp)
        if trial.status != TrialStatus.RUNNING and isfinite(reading):
            self._trial = None
            self._told.append(trial.state(stamp))
            trial.restore(reading, profile_limits(self._config, nan, self._known[axis.name]))

    def give_up(self, why: str, stamp: int) -> None:
        """Forget the trial, whose axis is released or at fault."""
        trial, self._trial = self._trial, None
        if trial is not None:
            trial.end(why)
            self._told.append(trial.state(stamp))

    def forget(self) -> None:
        """Drop a wish that was not looked at yet: an activation begins no motion by itself."""
        self._asked = None

    def told(self, frame_id: str) -> list[ServoTrialState]:
        """Return what has happened since it was asked last."""
        found, self._told = self._told, []
        return [replace(one, frame_id=frame_id) for one in found]

    def _misfit(self, asked: ServoTrial) -> str:
        """Say what of a trial does not suit its axis; empty if all does."""
        name = asked.axis_name
        if name not in self._hashes:
            return (
                f'axis: expected one of a machine file, {", ".join(self._hashes) or "none"}, but '
                f'found {name}'
            )
        if asked.machine_file != self._hashes[name]:
            return (
                f'{name}: expected the machine file that servo_controller was started with but '
                'found another; give that one, or start the node with this one'
            )
        if self._known[name].limits.vertical:
            return vertical_refusal(name)
        numbers = (asked.gain, asked.way, asked.pace, asked.error_max)
        if not (
            0.0 < asked.gain <= GAIN_MAX
            and 0.0 < asked.pace <= 1.0
            and isfinite(asked.way)
            and 0.0 < asked.error_max < inf
        ):
            return (
                f'trial: expected a gain within 0 to {GAIN_MAX:g}, a way, a pace within 0 to 1 '
                f'and a largest error above 0 but found {", ".join(f"{n:g}" for n in numbers)}'
            )
        return ''

    def _made(self, asked: ServoTrial, axis: ServoAxis, reading: float) -> AxisTrial:
        """Return a trial that has begun.

        Raises
        ------
        ValueError
            If it leads out of the travel, takes too long, or its loop is unstable on the model.
        """
        data = self._known[asked.axis_name]
        travel = data.limits.travel_low, data.limits.travel_high
        for place in (reading, axis.reference, axis.reference + asked.way):
            if not travel[0] <= place <= travel[1]:
                raise ValueError(
                    f'{axis.name}: expected a way within its travel of {1e3 * travel[0]:g} to '
                    f'{1e3 * travel[1]:g} mm but found {1e3 * place:g} mm'
                )
        course = self._course(asked, data) if asked.way else None
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', ServoParamsWarning)  # its loop is judged below
            settings = dict(zip(asked.setting, asked.value.tolist(), strict=True))
            controller = file_controller(self._config, axis.name, data, asked.controller, settings)
        if not controller.settles(asked.gain):
            raise ValueError(
                f'{axis.name}: {UNSTABLE} at {asked.gain:g} times the gain but found one that is '
                'not'
            )
        return AxisTrial(axis, asked, controller, course, travel, reading)

    def _course(self, asked: ServoTrial, data: AxisData) -> Course:
        """Return the way there and back of a trial.

        Raises
        ------
        ValueError
            If it takes too long.
        """
        limits = profile_limits(self._config, nan, data)
        course = there_and_back(
            asked.way,
            replace(
                limits,
                velocity=limits.velocity * asked.pace,
                acceleration=limits.acceleration * asked.pace,
            ),
            self._config.period,
        )
        time = len(course.rows) * self._config.period
        if time > LONGEST:
            raise ValueError(
                f'way: expected there and back within {LONGEST:g} s but found {time:.1f} s'
            )
        return course


def vertical_refusal(axis: str) -> str:
    """Say why no controller is tried on a vertical axis."""
    return (
        f'{axis}: expected an axis that stays where its drive gives way but found a vertical one, '
        'and no brake that the node can set; tune it on its model'
    )


def machine_forbids(machine: MachineState | None) -> str:
    """Say what of a machine forbids a trial; empty if nothing does."""
    if machine is None:
        return 'machine_state: expected what the machine does but nothing was heard of it'
    if machine.state not in (MachineMode.ON, MachineMode.RUNNING):
        return 'machine_state: expected drives that are on but found otherwise'
    if machine.spindle_speed != 0.0:  # also NaN
        return (
            f'spindle: expected one at rest but found {machine.spindle_speed:.4g} rad/s; stop it'
        )
    return ''
