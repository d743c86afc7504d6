# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes of the simulated contouring machine: interpolator filter, position and velocity loop."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
        lines = np.ascontiguousarray(average.T)  # by axis
        steps = self._config.control_steps
        result = np.empty_like(lines)
        done, count = 0, steps * len(average)
        while done < count:
            period = slice(done // steps, -(-(done + _STRETCH) // steps))
            held = np.repeat(lines[:, period], steps, axis=1)[:, done % steps :][:, :_STRETCH]
            course, speed, over = self._linear(held, self._position, self._velocity)
            if over.any():
                break
            ends = slice(done // steps, (done + held.shape[1]) // steps)
            result[:, ends] = course[:, (-1 - done) % steps :: steps]
            self._position, self._velocity = course[:, -1].copy(), speed[:, -1].copy()
            done += held.shape[1]
        # from the first limit on each axis has stretches of its own
        for axis in range(len(lines) if done < count else 0):
            position, velocity = self._axis_course(
                np.repeat(lines[axis], steps)[done:],
                float(self._position[axis]),
                float(self._velocity[axis]),
            )
            result[axis, done // steps :] = position[(-1 - done) % steps :: steps]
            self._position[axis], self._velocity[axis] = position[-1], velocity
        return np.ascontiguousarray(result.T)

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
            ahead = held[done : done + _STRETCH]
            part, speed, over = self._linear(ahead, np.array(position), np.array(velocity))
            within = int(over.argmax()) if over.any() else len(ahead)
            course[done : done + within] = part[:within]
            done += within
            if within:
                position, velocity = float(part[within - 1]), float(speed[within - 1])
            if within == _STRETCH or done == len(held):
                continue
            ahead = held[done : done + _STRETCH]
            slow, velocity = self._limited(ahead, position, velocity, calm=_CALM)
            course[done : done + len(slow)] = slow
            done += len(slow)
            position = slow[-1]
        return course, velocity

    def _linear(
        self, held: Array, position: Array, velocity: Array
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Run the loop as a filter along the last dimension.

        Return positions and velocities, and where a limit would be met: from there on they are
        not true.
        """
        # Here, since `step` does without: half a second that a node saves when it starts.
        from scipy.signal import lfilter

        config = self._config
        period, (gain, damping) = config.control_period, config.loop
        position, velocity = position[..., np.newaxis], velocity[..., np.newaxis]
        last = 1.0 - damping
        # a filter that was at 0 a step ago and came from -period * velocity
        memory = np.concatenate([last * (period * velocity), np.zeros_like(velocity)], axis=-1)
        away = held - position
        relative, _ = lfilter([gain], [1.0, damping + gain - 2.0, last], away, zi=memory)
        before = np.zeros_like(relative)
        before[..., 1:] = relative[..., :-1]
        speed = (relative - before) / period
        change = np.diff(speed, prepend=velocity) / period
        asked = config.position_gain * (away - before)
        over = (np.abs(asked) > config.velocity_max) | (np.abs(change) > config.acceleration_max)
        return position + relative, speed, over

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
