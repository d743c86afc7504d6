# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes of the simulated contouring machine: interpolator filter, position and velocity loop."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.config import Config, param

_STRETCH = 4096
"""Control steps that are filtered in one go; a limit that is met ends a stretch early."""

_CALM = 64
"""Control steps without a limit after which filtering is tried again."""


@dataclass(frozen=True, kw_only=True)
class ContouringConfig(Config):
    """The simulated contouring machine of method sheet 002 section 6; all axes are equal."""

    interpolation_period: float = param(
        1e-3, 's', 'Time between two positions of the interpolator', low=1e-5, high=0.1
    )
    control_steps: int = param(4, '-', 'Control steps in an interpolation period', low=1, high=100)
    filter_samples: int = param(
        8, '-', 'Positions of the interpolator that are averaged', low=1, high=1000
    )
    position_gain: float = param(
        40.0, '1/s', 'Velocity asked for per position error', low=0.1, high=1000.0
    )
    velocity_bandwidth: float = param(
        250.0, 'rad/s', 'Bandwidth of the velocity loop', low=1.0, high=10_000.0
    )
    velocity_max: float = param(
        0.25, 'm/s', 'Largest velocity of an axis and along the path', low=1e-4, high=10.0
    )
    acceleration_max: float = param(
        4.0, 'm/s^2', 'Largest acceleration of an axis', low=1e-3, high=1000.0
    )
    path_acceleration_max: float = param(
        1.5, 'm/s^2', 'Largest change of speed along the path', low=1e-3, high=1000.0
    )
    velocity_min: float = param(
        2e-5, 'm/s', 'Speed along the path that is never undercut', low=1e-9, high=1e-2
    )
    run_out: float = param(0.3, 's', 'Time to come to rest at the end', low=0.0, high=60.0)

    def __post_init__(self) -> None:
        """Check the fields, and that the loops are stable at this control step.

        Raises
        ------
        ValueError
            If a field is out of its bounds or the sampled loops would not settle.
        """
        super().__post_init__()
        gain, damping = self.loop
        # both roots of z^2 - (2 - damping - gain) z + (1 - damping) inside the unit circle
        if not (0.0 < damping < 2.0 and gain < 4.0 - 2.0 * damping):
            raise ValueError(
                f'expected loops that settle but found position_gain {self.position_gain} 1/s and '
                f'velocity_bandwidth {self.velocity_bandwidth} rad/s at a control step of '
                f'{self.control_period} s; raise control_steps'
            )

    @property
    def control_period(self) -> float:
        """Time of a control step [s]."""
        return self.interpolation_period / self.control_steps

    @property
    def loop(self) -> tuple[float, float]:
        """Share of the position error and of the velocity that a control step takes away [-]."""
        damping = self.velocity_bandwidth * self.control_period
        return damping * self.position_gain * self.control_period, damping

    @property
    def delay(self) -> float:
        """Time by which the axes lag behind the interpolator [s]."""
        filtering = 0.5 * (self.filter_samples - 1) * self.interpolation_period
        return 1.0 / self.position_gain + filtering

    @property
    def contour_constant(self) -> float:
        """Contour error per normal acceleration, C = 1/(2 Kv^2) - 1/(Kv w) + T^2/24 [s^2].

        Examples
        --------
        >>> f'{ContouringConfig().contour_constant:.4e}'
        '2.1517e-04'
        """
        gain, window = self.position_gain, self.filter_samples * self.interpolation_period
        loops = 0.5 / gain**2 - 1.0 / (gain * self.velocity_bandwidth)
        return loops + window**2 / 24.0


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
