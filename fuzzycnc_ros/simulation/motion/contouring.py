# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Contouring on the simulated machine: a feed schedule in, the contour error out.

docs/explanation/methods/feedrate.md says what was measured on it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.limits import reachable_speed
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.motion.contour import Contour
from fuzzycnc_ros.simulation.motion.contouring_axes import ContouringAxes

_WINDOW_LENGTH, _WINDOW_TIME = 2e-3, 0.012
"""Contour error is searched that far [m], and the way of that time [s], around the reference."""


@dataclass(frozen=True)
class ContouringRun:
    """Motion of a machine on a contour, n samples an interpolation period apart.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Time since the start [s].
    reference, position : ndarray, shape (n, d)
        Where the interpolator and the axes were [m].
    arc_length : ndarray, shape (n,)
        Where on the contour the axes should have been, that is the reference a machine's delay
        ago [m].
    error : ndarray, shape (n,)
        Contour error: shortest distance from the axes' position to the contour [m].
    duration : float
        Time of the programmed motion, without the run-out [s].
    """

    time: Array
    reference: Array
    position: Array
    arc_length: Array
    error: Array
    duration: float

    @property
    def error_max(self) -> float:
        """Largest contour error [m]."""
        return float(self.error.max())


def controller_feed(arc_length: ArrayLike, feed: ArrayLike, config: ContouringConfig) -> Array:
    """Return the speed that the controller makes of a feed schedule.

    It starts and ends at rest, keeps the path acceleration, exceeds neither the schedule nor the
    machine's velocity, and never falls below `velocity_min`.

    Parameters
    ----------
    arc_length : array_like, shape (n,)
        Increasing arc lengths of the schedule's points [m].
    feed : array_like, shape (n,)
        Speed asked for at each point [m/s], not negative.
    config : ContouringConfig
        Limits.

    Returns
    -------
    ndarray, shape (n,)
        Speeds [m/s].

    Raises
    ------
    ValueError
        If shapes differ, the arc lengths do not increase, or a feed is negative or not finite.

    Examples
    --------
    >>> speed = controller_feed([0.0, 1e-3, 1.0], [0.1, 0.1, 0.1], ContouringConfig())
    >>> speed.round(5).tolist()
    [2e-05, 0.05477, 2e-05]
    """
    arc, asked = _schedule(arc_length, feed)
    asked = np.minimum(asked, config.velocity_max)
    asked[0] = asked[-1] = 0.0
    speed = reachable_speed(arc, asked, config.path_acceleration_max)
    return np.asarray(np.maximum(speed, config.velocity_min))


def travel(arc_length: ArrayLike, speed: ArrayLike, period: float) -> tuple[Array, float]:
    """Return where a schedule is at multiples of a period.

    Between two points the speed is linear in arc length, so that the way is exponential in time:
    dt = ds ln(v2/v1) / (v2 - v1).

    Parameters
    ----------
    arc_length, speed : array_like, shape (n,)
        Arc lengths [m], increasing, and speeds there [m/s], positive.
    period : float
        Time between two samples [s].

    Returns
    -------
    arc_length : ndarray, shape (m,)
        Arc lengths at 0, 1, 2, ... periods [m]; the last is the end of the schedule.
    duration : float
        Time of the whole schedule [s].

    Raises
    ------
    ValueError
        If shapes differ, the arc lengths do not increase or a speed is not positive.

    Examples
    --------
    >>> travel([0.0, 1.0], [0.5, 0.5], 0.75)
    (array([0.   , 0.375, 0.75 , 1.   ]), 2.0)
    """
    arc, velocity = _schedule(arc_length, speed)
    if not np.all(velocity > 0.0):
        raise ValueError('speed: expected more than 0 m/s everywhere')
    step, change = np.diff(arc), np.diff(velocity)
    rise = change / velocity[:-1]
    moment = np.append(0.0, np.cumsum(step / velocity[:-1] / _ratio(rise, portable.log1p(rise))))
    duration = float(moment[-1])
    time = period * np.arange(int(np.ceil(duration / period)) + 1)
    segment = np.clip(np.searchsorted(moment, time, side='right') - 1, 0, len(step) - 1)
    rate = change[segment] / step[segment]
    since = time - moment[segment]
    way = velocity[segment] * since * _ratio(portable.expm1(rate * since), rate * since)
    return np.minimum(arc[segment] + way, arc[-1]), duration


def simulate_contouring(
    contour: Contour,
    arc_length: ArrayLike,
    feed: ArrayLike,
    config: ContouringConfig | None = None,
) -> ContouringRun:
    """Drive a feed schedule along a contour and measure the contour error.

    Parameters
    ----------
    contour : Contour
        The programmed path, which is also the reference of the error.
    arc_length : array_like, shape (n,)
        Arc lengths of the schedule's points [m], from 0 to the contour's length; of a curve
        those of `contour.arc_length`.  Points should be dense at the ends: between two of them
        the speed is linear, from that of rest.
    feed : array_like, shape (n,)
        Speed asked for at each point [m/s]; `controller_feed` makes it one that starts and ends
        at rest.
    config : ContouringConfig, optional
        The machine.

    Returns
    -------
    ContouringRun
        Reference, position and contour error at every interpolation period.

    Raises
    ------
    ValueError
        If the schedule is not one, or does not span the contour to 0.1 %.

    Examples
    --------
    A quarter of a circle of 20 mm at 0.1 m/s^2 of normal acceleration:

    >>> def quarter(part):
    ...     return 0.02 * np.column_stack([np.cos(part * np.pi / 2), np.sin(part * np.pi / 2)])
    >>> contour = Contour.curve(quarter)
    >>> arc = np.linspace(0.0, contour.length, 500)
    >>> run = simulate_contouring(contour, arc, np.full(500, np.sqrt(0.1 * 0.02)))
    >>> f'{1e6 * np.median(run.error):.1f} um in {run.duration:.2f} s'
    '21.6 um in 0.77 s'
    """
    machine = config or ContouringConfig()
    arc, asked = _schedule(arc_length, feed)
    if max(abs(arc[0]), abs(arc[-1] - contour.length)) > 1e-3 * contour.length:
        raise ValueError(
            f'arc_length: expected 0 m to {contour.length:.6g} m, the length of the contour, but '
            f'found {arc[0]:.6g} m to {arc[-1]:.6g} m'
        )
    speed = controller_feed(arc, asked, machine)
    period = machine.interpolation_period
    way, duration = travel(arc, speed, period)
    way = np.append(way, np.full(round(machine.run_out / period), way[-1]))
    reference = contour.position(way)
    position = np.empty_like(reference)
    position[0] = reference[0]
    # positions at the start of each period: the last reference has not yet moved anything
    position[1:] = ContouringAxes(reference[0], machine).follow(reference[:-1])
    time: Array = period * np.arange(len(way), dtype=np.float64)
    delayed = np.interp(time - machine.delay, time, way)
    reach = _WINDOW_LENGTH + _WINDOW_TIME * float(speed.max())
    found = contour.distance(position, delayed, reach)
    return ContouringRun(time, reference, position, delayed, found.distance, duration)


def circle_contour_constant(
    position: ArrayLike, centre: ArrayLike, radius: float, speed: float
) -> float:
    """Return the contour error per normal acceleration that a driven circle shows.

    C = (radius error) R / v^2, which holds on a real machine as on the simulated one.

    Parameters
    ----------
    position : array_like, shape (n, 2)
        Where the axes were on whole turns at constant speed [m].
    centre : array_like, shape (2,)
        Centre of the programmed circle [m].
    radius : float
        Radius of the programmed circle [m]; positive.
    speed : float
        Programmed speed [m/s]; positive.

    Returns
    -------
    float
        C [s^2]; the driven circle is smaller than programmed where it is positive.

    Raises
    ------
    ValueError
        If shapes are wrong, a number is not finite or radius or speed is not positive.

    Examples
    --------
    >>> turn = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
    >>> driven = 0.0199 * np.column_stack([np.cos(turn), np.sin(turn)])
    >>> f'{circle_contour_constant(driven, [0.0, 0.0], 0.02, 0.1):.3e}'
    '2.000e-04'
    """
    place, middle = np.asarray(position, dtype=np.float64), np.asarray(centre, dtype=np.float64)
    if place.ndim != 2 or place.shape[1] != 2 or not len(place) or middle.shape != (2,):
        raise ValueError(
            f'position: expected the shape (n, 2) and a centre of 2 but found {place.shape} and '
            f'{middle.shape}'
        )
    if not (np.isfinite(place).all() and np.isfinite(middle).all()):
        raise ValueError('position: expected finite numbers only')
    for name, value, unit in (('radius', radius, 'm'), ('speed', speed, 'm/s')):
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f'{name}: expected more than 0 {unit} but found {value} {unit}')
    driven = np.linalg.norm(place - middle, axis=1).mean()
    return float((radius - driven) * radius / (speed * speed))


def identify_contour_constant(
    config: ContouringConfig | None = None, *, radius: float = 0.02, speed: float = 0.05
) -> float:
    """Return C of a simulated machine, from the last of three circles that it is driven on.

    Parameters
    ----------
    config : ContouringConfig, optional
        The machine.
    radius, speed : float
        The circle [m] and the speed along it [m/s]; positive, and best such that no limit is met.

    Returns
    -------
    float
        C [s^2].

    Raises
    ------
    ValueError
        If radius or speed is not positive, or the speed above the machine's velocity.
    """
    machine = config or ContouringConfig()
    if not (0.0 < speed <= machine.velocity_max):
        raise ValueError(
            f'speed: expected more than 0 m/s, at most {machine.velocity_max} m/s, but found '
            f'{speed} m/s'
        )
    if not (np.isfinite(radius) and radius > 0.0):
        raise ValueError(f'radius: expected more than 0 m but found {radius} m')
    turn = 2.0 * np.pi * radius / speed
    # the lag dies out within ten time constants of the position loop
    lead = max(2.0 * turn, 10.0 * machine.delay)
    angle = speed / radius * np.arange(0.0, lead + turn, machine.interpolation_period)
    sine, cosine = portable.sin_cos(angle)
    circle = radius * np.column_stack([cosine, sine])
    driven = ContouringAxes(circle[0], machine).follow(circle)
    last = driven[round(lead / machine.interpolation_period) :]
    return circle_contour_constant(last, [0.0, 0.0], radius, speed)


def _schedule(arc_length: ArrayLike, speed: ArrayLike) -> tuple[Array, Array]:
    """Return arc lengths and speeds as checked arrays."""
    arc, value = (np.array(item, dtype=np.float64) for item in (arc_length, speed))
    if arc.ndim != 1 or arc.shape != value.shape or len(arc) < 2:
        raise ValueError(
            f'expected two or more arc lengths and as many speeds but found the shapes '
            f'{arc.shape} and {value.shape}'
        )
    if not (np.isfinite(arc).all() and np.all(np.diff(arc) > 0.0)):
        raise ValueError('arc_length: expected finite, increasing numbers; drop duplicate points')
    if not (np.isfinite(value).all() and np.all(value >= 0.0)):
        raise ValueError('speed: expected finite numbers, none negative')
    return arc, value


def _ratio(value: Array, over: Array) -> Array:
    """Return `value / over`, and its limit 1 where both vanish."""
    return np.asarray(np.divide(value, over, out=np.ones_like(value), where=over != 0.0))
