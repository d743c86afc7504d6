# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes of the simulated contouring machine: interpolator filter, position and velocity loop."""

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig

_STRETCH = 4096
"""Control steps that are filtered in one go; a limit that is met ends a stretch early."""

_CALM = 64
"""Control steps without a limit after which filtering is tried again."""


class ContouringAxes:
    """Axes that follow the interpolator's positions, each for itself.

    The last positions are averaged, the average is held over an interpolation period, and a
    proportional position loop around a first-order velocity loop follows it, velocity and
    acceleration limited, integrated by the semi-implicit Euler rule.

    Parameters
    ----------
    position : array_like, shape (d,)
        Where the axes rest at the beginning [m]; the average begins full of it.
    config : ContouringConfig, optional
        Gains, limits and periods.

    Raises
    ------
    ValueError
        If the position is not a list of finite numbers.

    Notes
    -----
    `follow` gives what as many calls of `step` give, to rounding: where no limit is met the loop
    is linear and runs as a filter.

    Examples
    --------
    >>> axes = ContouringAxes([0.0, 0.0])
    >>> position = axes.follow([[1e-3, 0.0]] * 500)
    >>> (1e3 * position[-1]).round(6).tolist()
    [1.0, 0.0]
    """

    def __init__(self, position: ArrayLike, config: ContouringConfig | None = None) -> None:
        self._config = config or ContouringConfig()
        start = np.array(position, dtype=np.float64)
        if start.ndim != 1 or not len(start) or not np.isfinite(start).all():
            raise ValueError('position: expected one finite number per axis')
        self._position = start
        self._velocity = np.zeros(len(start))
        self._recent = np.tile(start, (self._config.filter_samples - 1, 1))

    @property
    def position(self) -> Array:
        """Positions of the axes, shape (d,) [m]."""
        return self._position.copy()

    @property
    def velocity(self) -> Array:
        """Velocities of the axes, shape (d,) [m/s]."""
        return self._velocity.copy()

    def step(self, reference: ArrayLike) -> Array:
        """Follow one position of the interpolator, shape (d,) [m], for an interpolation period.

        Returns
        -------
        ndarray, shape (d,)
            Positions of the axes at the end of the period [m].

        Raises
        ------
        ValueError
            If the reference has another shape or is not finite.  The state is unchanged.
        """
        average = self._average(np.asarray(reference, dtype=np.float64)[None])[0]
        for axis, held in enumerate(average):
            course, velocity = self._limited(
                np.full(self._config.control_steps, held),
                float(self._position[axis]),
                float(self._velocity[axis]),
                calm=self._config.control_steps + 1,
            )
            self._position[axis], self._velocity[axis] = course[-1], velocity
        return self._position.copy()

    def follow(self, reference: ArrayLike) -> Array:
        """Follow positions of the interpolator, one per interpolation period.

        Parameters
        ----------
        reference : array_like, shape (n, d)
            Positions [m].

        Returns
        -------
        ndarray, shape (n, d)
            Positions of the axes at the end of each period [m].

        Raises
        ------
        ValueError
            If the reference has another shape or is not finite.  The state is unchanged.
        """
        average = self._average(np.asarray(reference, dtype=np.float64))
        steps = self._config.control_steps
        result = np.empty_like(average)
        for axis in range(average.shape[1]):
            course, velocity = self._axis_course(
                np.repeat(average[:, axis], steps),
                float(self._position[axis]),
                float(self._velocity[axis]),
            )
            result[:, axis] = course[steps - 1 :: steps]
            if len(course):
                self._position[axis], self._velocity[axis] = course[-1], velocity
        return result

    def _average(self, reference: Array) -> Array:
        """Return the causal moving average and remember what the next call needs of it."""
        dimensions = len(self._position)
        if reference.ndim != 2 or reference.shape[1] != dimensions:
            raise ValueError(
                f'reference: expected {dimensions} numbers per position but found the shape '
                f'{reference.shape}'
            )
        if not np.isfinite(reference).all():
            raise ValueError('reference: expected finite positions only')
        if not len(reference):
            return reference
        known = np.concatenate([self._recent, reference])
        samples = self._config.filter_samples
        # summed as differences from the first, so that huge offsets cost no digits
        relative = known - known[0]
        total = np.zeros_like(reference)
        for lag in range(samples):
            total += relative[lag : lag + len(reference)]
        self._recent = known[len(reference) :]
        return np.asarray(known[0] + total / samples)

    def _axis_course(self, held: Array, position: float, velocity: float) -> tuple[Array, float]:
        """Run an axis over references per control step; return positions and last velocity."""
        course = np.empty(len(held))
        done = 0
        while done < len(held):
            part, velocity = self._linear(held[done : done + _STRETCH], position, velocity)
            course[done : done + len(part)] = part
            done += len(part)
            position = float(course[done - 1]) if done else position
            if len(part) == _STRETCH or done == len(held):
                continue
            ahead = held[done : done + _STRETCH]
            slow, velocity = self._limited(ahead, position, velocity, calm=_CALM)
            course[done : done + len(slow)] = slow
            done += len(slow)
            position = slow[-1]
        return course, velocity

    def _linear(self, held: Array, position: float, velocity: float) -> tuple[Array, float]:
        """Run the loop as a filter, up to where the first limit would be met."""
        # Here, since `step` does without: half a second that a node saves when it starts.
        from scipy.signal import lfilter, lfiltic

        config = self._config
        period, (gain, damping) = config.control_period, config.loop
        denominator = [1.0, damping + gain - 2.0, 1.0 - damping]
        memory = lfiltic([gain], denominator, [0.0, -period * velocity])
        relative, _ = lfilter([gain], denominator, held - position, zi=memory)
        before = np.append(0.0, relative[:-1])
        speed = (relative - before) / period
        change = np.diff(speed, prepend=velocity) / period
        asked = config.position_gain * (held - position - before)
        over = (np.abs(asked) > config.velocity_max) | (np.abs(change) > config.acceleration_max)
        count = int(over.argmax()) if over.any() else len(held)
        last = float(speed[count - 1]) if count else velocity
        return np.asarray(position + relative[:count]), last

    def _limited(
        self, held: Array, position: float, velocity: float, *, calm: int
    ) -> tuple[list[float], float]:
        """Run the loop step by step until `calm` steps in a row have met no limit."""
        config = self._config
        gain, bandwidth = config.position_gain, config.velocity_bandwidth
        period, top, push = config.control_period, config.velocity_max, config.acceleration_max
        course: list[float] = []
        quiet = 0
        for reference in held.tolist():
            asked = gain * (reference - position)
            target = min(max(asked, -top), top)
            change = bandwidth * (target - velocity)
            limited = min(max(change, -push), push)
            quiet = quiet + 1 if target == asked and limited == change else 0
            velocity += period * limited
            position += period * velocity
            course.append(position)
            if quiet == calm:
                break
        return course, velocity
