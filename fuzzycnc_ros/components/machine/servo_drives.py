# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The machine side of driven axes: what it lets drives do, whatever it is told."""

from collections.abc import Mapping, Sequence

from fuzzycnc_ros.core.servo.axis import velocity_lag
from fuzzycnc_ros.runtime.records import AxisCommand
from fuzzycnc_ros.simulation.servo.axes import AxisPlant


class ServoDrives:
    """Holds the newest command while it is valid, and takes the drives to zero otherwise.

    Parameters
    ----------
    plants : mapping of str to AxisPlant
        Axes by name.
    travel : mapping of str to tuple of float
        Ends of the travel of each axis [m].

    Attributes
    ----------
    epoch : int
        Owner of the newest command that was followed; 0 before the first.
    tripped : str
        Why an axis that would have left its travel keeps the drives at zero; empty if none did.
    reason : str
        Why the drives are at zero, or a command was refused; empty if all is well.
    late : int
        Periods that were driven by a command for an earlier one.

    Notes
    -----
    A command is refused if the machine does not allow motion, its epoch is lower than one that
    was followed, its axes are not those of the machine or a duty is not finite.  An axis that
    could not come to rest within its travel with its drive at zero trips the drives: they stay
    at zero until a higher epoch takes over.
    """

    def __init__(
        self, plants: Mapping[str, AxisPlant], travel: Mapping[str, tuple[float, float]]
    ) -> None:
        self._names = tuple(plants)
        self._axes = [_Stopping(name, plant, travel[name]) for name, plant in plants.items()]
        self._zero = [0.0] * len(plants)
        self._forbidden = self.tripped = ''
        self._duties: list[float] = self._zero
        self._stamp = self._until = -1
        self.epoch = 0
        self.reason = 'no axis_command yet'
        self.late = 0

    def allow(self, allowed: bool, why: str) -> None:
        """Say whether the machine may move; if not, the drives are at zero at once."""
        self._forbidden = '' if allowed else f'the machine does not allow motion: {why}'
        if not allowed:
            self._stop(self._forbidden)

    def command(self, command: AxisCommand) -> None:
        """Take a command, or refuse it and keep to the last as long as that is valid."""
        refusal = self._forbidden or self._refused(command.epoch, command.axis)
        duties = command.duty.tolist()
        if not refusal and not (len(duties) == len(command.axis) and all(map(_is_duty, duties))):
            refusal = f'duty: expected one within -1 to 1 per axis but found {duties}'
        if refusal:
            self.reason = refusal
            return
        self.epoch, self.tripped, self.reason = command.epoch, '', ''
        given = dict(zip(command.axis, duties, strict=True))
        self._duties = [given.get(name, 0.0) for name in self._names]
        self._stamp, self._until = command.stamp, command.valid_until

    def duties(self, begin: int, end: int) -> Sequence[float]:
        """Return the duties [-] over a period between two times [ns]."""
        rests = [axis.rest() for axis in self._axes]
        if self._until < 0 or self.tripped:
            return self._zero
        for axis, rest in zip(self._axes, rests, strict=True):
            if not axis.low <= rest <= axis.high:
                self.tripped = (
                    f'{axis.name} would leave its travel of {1e3 * axis.low:g} to '
                    f'{1e3 * axis.high:g} mm; drives at zero until a new owner commands'
                )
                self._stop(self.tripped)
                return self._zero
        if end > self._until:
            self._stop(f'axis_command of epoch {self.epoch} is out of date; drives at zero')
            return self._zero
        if self._stamp < begin:
            self.late += 1
        return self._duties

    def _stop(self, reason: str) -> None:
        self.reason = reason
        self._duties, self._until = self._zero, -1

    def _refused(self, epoch: int, axes: Sequence[str]) -> str:
        if epoch < max(self.epoch, 1):
            return f'expected epoch {max(self.epoch, 1)} or higher but found {epoch}'
        if self.tripped and epoch == self.epoch:
            return self.tripped
        if len(set(axes)) != len(axes) or not set(axes) <= set(self._names):
            return f'axis: expected {", ".join(self._names)} but found {", ".join(axes)}'
        return ''


class _Stopping:
    """Where an axis comes to rest if its drive goes to zero now: limit switches know no sensor."""

    def __init__(self, name: str, plant: AxisPlant, travel: tuple[float, float]) -> None:
        model = plant.linear()
        self.name = name
        self.low, self.high = travel
        self._plant = plant
        self._coasting = model.lag + model.period
        # what the drive has in store accelerates the axis on
        self._growth = (model.lag - velocity_lag(model)) / model.period + 2.0
        self._speed = 0.0

    def rest(self) -> float:
        """Return the position [m]; to be asked once per period."""
        speed = self._plant.velocity
        gain, self._speed = speed - self._speed, speed
        if gain * speed > 0.0:
            speed += gain * self._growth
        return self._plant.position + speed * self._coasting


def _is_duty(value: float) -> bool:
    return -1.0 <= value <= 1.0  # false for NaN
