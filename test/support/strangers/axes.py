# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Strange machine axes: a seeded generator, simulator and judge.

Everything here follows from mechanics alone; nothing is shared with the
identification or the tuning that it judges. ``README.md`` describes the
interface, ``axes.c`` holds the inner loop.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
import os
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    'KINDS',
    'PERIOD',
    'SUBSTEP',
    'Axis',
    'Best',
    'Controller',
    'Course',
    'FactoryLoop',
    'Verdict',
    'draw',
    'judge',
    'run',
    'search_best',
    'sequence',
    'stable',
]

PERIOD = 1e-3
"""Control period, s."""
SUBSTEP = 20e-6
"""Step of the simulation, s."""
GRAVITY = 9.81

KINDS = (
    'rigid',
    'flexible_motor',
    'flexible_load',
    'backlash',
    'dead_time',
    'hydraulic',
    'voice_coil',
)
"""Kinds of axis; seed ``n`` draws kind ``n % 7``."""

Array = NDArray[np.float64]

_RING = 512
_PARAMETERS = (
    'dt',
    'substeps',
    'two_mass',
    'sensor_on_load',
    'mass1',
    'mass2',
    'stiffness',
    'damping',
    'gap',
    'viscous1',
    'viscous2',
    'coulomb1',
    'coulomb2',
    'static_ratio',
    'stribeck_speed',
    'gain_pos',
    'gain_neg',
    'gain_scale',
    'dead_band',
    'back_force',
    'force_rate',
    'valve_rate',
    'delay_steps',
    'gravity',
    'limit',
    'stop_stiffness',
    'stop_damping',
    'count',
    'noise',
)
_STATE = (
    'x1',
    'v1',
    'x2',
    'v2',
    'spool',
    'force',
    'time',
    'spare',
    'has_spare',
    'work_in',
    'work_gravity',
    'lost',
)


class _Struct(ctypes.Structure):
    """Mirror of ``axis_t`` in ``axes.c``."""

    _fields_ = [
        *((name, ctypes.c_double) for name in _PARAMETERS + _STATE),
        ('random', ctypes.c_uint64),
        ('head', ctypes.c_int64),
        ('ring', ctypes.c_double * _RING),
    ]


def _load() -> ctypes.CDLL:
    """Compile ``axes.c`` once per content, and load it."""
    source = Path(__file__).with_name('axes.c')
    digest = hashlib.sha256(source.read_bytes()).hexdigest()[:12]
    folder = Path(tempfile.gettempdir())
    library = folder / f'fuzzycnc_axes_{digest}.so'
    if not library.exists():
        handle, name = tempfile.mkstemp(suffix='.so', dir=folder)
        os.close(handle)
        subprocess.run(
            ['gcc', '-O2', '-shared', '-fPIC', '-o', name, str(source), '-lm'],
            check=True,
        )
        os.chmod(name, 0o755)
        os.replace(name, library)
    loaded = ctypes.CDLL(str(library))
    pointer = ctypes.c_void_p
    loaded.axis_step.argtypes = [pointer, ctypes.c_double]
    loaded.axis_step.restype = ctypes.c_double
    loaded.axis_true.argtypes = [pointer]
    loaded.axis_true.restype = ctypes.c_double
    loaded.axis_measured.argtypes = [pointer]
    loaded.axis_measured.restype = ctypes.c_double
    loaded.axis_size.restype = ctypes.c_uint64
    if loaded.axis_size() != ctypes.sizeof(_Struct):
        raise RuntimeError('axes.c and axes.py disagree about the state')
    return loaded


_LIBRARY = _load()


class Controller(Protocol):
    """What is put on trial: a position controller at 1 kHz."""

    def step(self, setpoint: float, velocity: float, measured: float) -> float:
        """Return the duty for the next period.

        Parameters
        ----------
        setpoint : float
            Commanded position, m.
        velocity : float
            Commanded velocity, m/s; zero in raw position steps.
        measured : float
            Measured position, m.

        Returns
        -------
        float
            Duty; clipped to [-1, 1] by the axis.
        """
        ...


class Axis:
    """A machine axis.

    Parameters
    ----------
    parameters : mapping
        Values of the C structure, SI.
    truth : mapping
        The true values, for the judge only.

    Attributes
    ----------
    truth : dict
        True values in SI units; see ``README.md``.
    """

    def __init__(self, parameters: Mapping[str, float], truth: Mapping[str, Any]) -> None:
        self.truth: dict[str, Any] = dict(truth)
        self._struct = _Struct(**parameters)
        self._address = ctypes.addressof(self._struct)
        self._factory: float | None = None
        self.reset()

    @property
    def gain_scale(self) -> float:
        """Factor on the force per duty (or the speed per duty) of the axis."""
        return float(self._struct.gain_scale)

    @property
    def hold_duty(self) -> float:
        """Duty that balances gravity; zero on a horizontal axis."""
        s = self._struct
        if s.gravity == 0.0:
            return 0.0
        need = -s.gravity / s.gain_scale
        if need > 0.0:
            return float(need / s.gain_pos + s.dead_band)
        return float(need / s.gain_neg - s.dead_band)

    @property
    def position(self) -> float:
        """True position at the sensor, m, neither rounded nor noisy."""
        return float(_LIBRARY.axis_true(self._address))

    @property
    def load_position(self) -> float:
        """True position of the load, m."""
        return float(self._struct.x2)

    @property
    def measured(self) -> float:
        """Measured position, m: the last result of `step`."""
        return float(_LIBRARY.axis_measured(self._address))

    def reset(self, position: float = 0.0, seed: int = 0) -> None:
        """Put the axis at rest.

        The actuator starts at the duty that balances gravity, as it does when
        a brake lets go.

        Parameters
        ----------
        position : float
            Position at the sensor, m; the middle of the travel is 0.
        seed : int
            Seed of the duty noise.
        """
        s = self._struct
        for name in _STATE:
            setattr(s, name, 0.0)
        stretch = 0.0
        if s.two_mass and s.gravity != 0.0:
            stretch = -s.gravity / s.stiffness - math.copysign(0.5 * s.gap, s.gravity)
        if s.two_mass and s.sensor_on_load:
            s.x1, s.x2 = position + stretch, position
        else:
            s.x1, s.x2 = position, position - stretch
        s.force = -s.gravity
        s.spool = self.hold_duty
        s.ring = (ctypes.c_double * _RING)(*([self.hold_duty] * _RING))
        s.head = _RING
        s.random = (seed * 0x9E3779B97F4A7C15 + 0x632BE59BD9B4E019) % 2**64

    def copy(self) -> Axis:
        """Return an independent axis in the same state."""
        twin = object.__new__(Axis)
        twin.__setstate__(self.__getstate__())
        return twin

    def __getstate__(self) -> tuple[dict[str, Any], bytes, float | None]:
        return self.truth, bytes(self._struct), self._factory

    def __setstate__(self, state: tuple[dict[str, Any], bytes, float | None]) -> None:
        # The address belongs to one process and one structure.
        self.truth, self._factory = dict(state[0]), state[2]
        self._struct = _Struct.from_buffer_copy(state[1])
        self._address = ctypes.addressof(self._struct)

    def scaled(self, gain: float) -> Axis:
        """Return a copy with its force per duty multiplied, and reset.

        Parameters
        ----------
        gain : float
            Factor on the gain that was drawn.
        """
        twin = self.copy()
        twin._struct.gain_scale = gain
        twin.reset()
        return twin

    def step(self, duty: float) -> float:
        """Hold a duty for one control period.

        Parameters
        ----------
        duty : float
            In [-1, 1], clipped.

        Returns
        -------
        float
            Measured position at the end of the period, m.
        """
        return float(_LIBRARY.axis_step(self._address, duty))

    @property
    def factory_rate(self) -> float:
        """Rate of the factory loop, rad/s, found once and cautiously.

        The quickest loop is sought that survives the judge's sequence at half
        to one and a half times the gain, and does not chatter at twice the
        gain; half or two thirds of its rate is taken if that survives too.
        """
        if self._factory is None:
            rate = _factory_limit(self.truth)
            while not self._factory_survives(rate):
                rate *= 0.8
                if rate < 1.0:
                    raise RuntimeError(f'no factory loop for {self.truth["name"]}')
            slower = (share * rate for share in (0.5, 0.67, 0.8))
            self._factory = next(filter(self._factory_survives, slower), rate)
        return self._factory

    def _factory_survives(self, rate: float) -> bool:
        def make() -> FactoryLoop:
            return FactoryLoop(self.truth, rate)

        return judge(self, make, 2.0).chatter < CHATTER and all(
            judge(self, make, gain).ok for gain in (1.0, 0.5, 1.5)
        )

    def through_loop(
        self, setpoints: ArrayLike, seed: int = 0
    ) -> tuple[Array, Array, Array, Array]:
        """Follow set points by the factory loop, as recorded on a machine.

        The axis is reset to the first set point.

        Parameters
        ----------
        setpoints : array_like
            Positions at 1 kHz, m.
        seed : int
            Seed of the duty noise.

        Returns
        -------
        t, commanded, actual, duty : ndarray
            ``actual[k]`` is measured at ``t[k]``; ``duty[k]`` is sent at
            ``t[k]`` and held until ``t[k + 1]``.
        """
        commanded = np.array(setpoints, float)
        speeds = np.diff(commanded, prepend=commanded[0]) / PERIOD
        kernel = np.full(5, 0.2)
        speeds = np.convolve(speeds, kernel)[: len(speeds)]
        loop = FactoryLoop(self.truth, self.factory_rate)
        loop.start(commanded[0], self.hold_duty)
        self.reset(float(commanded[0]), seed)
        duty, actual, _ = run(self, loop, commanded, speeds)
        return PERIOD * np.arange(len(commanded)), commanded, actual, duty

    def open_loop(self, duty_series: ArrayLike, seed: int = 0) -> tuple[Array, Array, Array]:
        """Apply a series of duty, kept inside the travel by a soft end stop.

        The series is added to the duty that balances gravity. Towards an end
        of the travel, the duty is bounded by what brakes the axis to a stop
        at 40 % of the travel from the middle.

        Parameters
        ----------
        duty_series : array_like
            Wanted duty at 1 kHz.
        seed : int
            Seed of the duty noise.

        Returns
        -------
        t, actual, duty : ndarray
            The duty is the one really sent, balance and end stop included.
        """
        series = np.array(duty_series, float)
        self.reset(0.0, seed)
        truth, hold = self.truth, self.hold_duty
        loop = FactoryLoop(truth, self.factory_rate)
        edge = 0.4 * truth['travel']
        actual, duty = np.empty(len(series)), np.empty(len(series))
        measured = last = self.measured
        speed = 0.0
        for k, wish in enumerate(series):
            speed += loop.smooth * ((measured - last) / PERIOD - speed)
            last = measured
            high = hold + loop.push(edge - measured, speed)
            low = hold + loop.push(-edge - measured, speed)
            sent = min(max(hold + wish, low), high)
            sent = min(max(sent, -1.0), 1.0)
            actual[k], duty[k] = measured, sent
            measured = self.step(sent)
        return PERIOD * np.arange(len(series)), actual, duty


class FactoryLoop:
    """The modest loop that a machine comes with.

    Position by P with 70 % of velocity feedforward, velocity by PI with 80 %
    of the viscous feedforward and of the dead band. The integral rests within
    an in-position window, and a notch quiets the mode if the load is measured.

    Parameters
    ----------
    truth : mapping
        True values of the axis.
    rate : float
        Rate of the position loop, rad/s.
    """

    def __init__(self, truth: Mapping[str, Any], rate: float) -> None:
        gain = truth['gain']
        self.rate = rate
        self.feed = 0.8 * truth['viscous'] / gain
        inner = 4.0 * rate
        if truth['plant'] == 'speed':
            self.damp = 0.0
        else:
            self.damp = truth['mass'] * inner / gain
        self.integral = 0.25 * rate * (self.damp + self.feed)
        self.dead = 0.8 * truth['dead_band']
        self.brake = truth['accel_max']
        self.slow = 0.02 * truth['speed_max']
        self.most = 1.5 * truth['speed_max']
        self.smooth = 1.0 - math.exp(-PERIOD * min(6.0 * inner, 1500.0))
        self.window = 0.5 * _rest_bound(truth)
        self._notch: tuple[float, ...] | None = None
        if truth['sensor'] == 'load':
            # (s^2 + 0.2 w s + w^2) / (s^2 + 1.6 w s + w^2), bilinear.
            w = math.tan(math.pi * truth['resonance_hz'] * PERIOD)
            scale = 1.0 + 1.6 * w + w * w
            middle = 2.0 * (w * w - 1.0) / scale
            self._notch = (
                (1.0 + 0.2 * w + w * w) / scale,
                middle,
                (1.0 - 0.2 * w + w * w) / scale,
                (1.0 - 1.6 * w + w * w) / scale,
            )
        self._one = self._two = 0.0
        self._last: float | None = None
        self._speed = 0.0
        self._sum = 0.0

    def _filter(self, value: float) -> float:
        if self._notch is None:
            return value
        b0, b1, b2, a2 = self._notch
        result = b0 * value + self._one
        self._one = b1 * (value - result) + self._two
        self._two = b2 * value - a2 * result
        return result

    def start(self, measured: float, hold: float) -> None:
        """Begin at a position, with the integral at a duty."""
        self._last = measured
        self._sum = hold

    def push(self, distance: float, speed: float) -> float:
        """Duty that brakes towards a point, without integral, for end stops."""
        far = abs(distance)
        wanted = min(self.rate * far, math.sqrt(self.brake * far))
        wanted = math.copysign(wanted, distance)
        drive = self.feed * wanted + self.damp * (wanted - speed)
        return drive + self.dead * math.tanh(wanted / self.slow)

    def step(self, setpoint: float, velocity: float, measured: float) -> float:
        """Return the duty for the next period."""
        if self._last is None:
            self._last = measured
        raw = (measured - self._last) / PERIOD
        self._last = measured
        self._speed += self.smooth * (raw - self._speed)
        wanted = self.rate * (setpoint - measured) + 0.7 * velocity
        wanted = min(max(wanted, -self.most), self.most)
        lack = wanted - self._speed
        free = self.feed * wanted + self.damp * lack + self.dead * math.tanh(wanted / self.slow)
        total = self._filter(free) + self._sum
        there = velocity == 0.0 and abs(setpoint - measured) < self.window
        if not there and (total < 1.0 or lack < 0.0) and (total > -1.0 or lack > 0.0):
            self._sum += PERIOD * self.integral * lack
        return min(max(total, -1.0), 1.0)


def _factory_limit(truth: Mapping[str, Any]) -> float:
    """Rate of the factory position loop to try first, rad/s."""
    lag = truth['dead_time'] + truth['valve_lag'] + 1.5 * PERIOD
    if truth['plant'] == 'force':
        lag += truth['force_lag']
    return float(min(0.25 / lag, 100.0))


def run(
    axis: Axis, controller: Controller, setpoints: Array, velocities: Array
) -> tuple[Array, Array, Array]:
    """Run a controller on an axis from the state it is in.

    Parameters
    ----------
    axis : Axis
        Advanced in place.
    controller : Controller
        Called once each period.
    setpoints, velocities : ndarray
        What is commanded at 1 kHz.

    Returns
    -------
    duty, measured, true : ndarray
        Duty sent at each instant, and the measured and the true position at
        the sensor at that instant. A duty that is not finite ends the run:
        the rest of the arrays is NaN.
    """
    count = len(setpoints)
    duty = np.full(count, np.nan)
    measured = np.full(count, np.nan)
    true = np.full(count, np.nan)
    address = axis._address
    advance, truly = _LIBRARY.axis_step, _LIBRARY.axis_true
    value = axis.measured
    pairs = zip(setpoints.tolist(), velocities.tolist(), strict=True)
    for k, (setpoint, velocity) in enumerate(pairs):
        measured[k] = value
        true[k] = truly(address)
        wish = float(controller.step(setpoint, velocity, value))
        if not math.isfinite(wish):
            break
        wish = min(max(wish, -1.0), 1.0)
        duty[k] = wish
        value = advance(address, wish)
    return duty, measured, true


# The sequence and the judgement.

SETTLE = 1.5
"""First standstill, s, not judged: the integrator finds gravity."""
GRACE = 0.4
"""Time after a raw step that does not count as following error, s."""
REST = 2.0
"""Last standstill, s."""
CHATTER = 0.25
"""Largest rms of duty about its 50 ms mean, in any section."""


@dataclass(frozen=True)
class Course:
    """The documented sequence of one axis.

    Attributes
    ----------
    setpoints, velocities : ndarray
        What is commanded at 1 kHz.
    sections : dict of str to slice
        Its parts, by name.
    counted : ndarray of bool
        Where the following error counts.
    step : float
        Size of the raw steps, m.
    """

    setpoints: Array
    velocities: Array
    sections: dict[str, slice]
    counted: NDArray[np.bool_]
    step: float


def _samples(seconds: float) -> int:
    return round(seconds / PERIOD)


def _move(distance: float, speed: float, acceleration: float) -> Array:
    """Rounded trapezoid from 0 to a distance; positions at 1 kHz."""
    length = abs(distance)
    top = min(speed, math.sqrt(length * acceleration))
    ramp = top / acceleration
    total = length / top + ramp
    t = PERIOD * np.arange(_samples(total) + 1)
    v = np.clip(np.minimum(t, total - t) * acceleration, 0.0, top)
    v = np.convolve(v, np.full(40, 1.0 / 40.0))
    x = np.cumsum(v)
    return x * (distance / x[-1])


def sequence(truth: Mapping[str, Any]) -> Course:
    """Build the sequence on which controllers are judged.

    A standstill, raw steps ``+s, -s, 0``, ramps to ``+d, -d, 0`` (constant
    speed between rounded accelerations), a smooth sine of 1 Hz that fades in
    and out, and a standstill. It depends on the truth of the axis, not on the
    gain it is scaled to.

    Parameters
    ----------
    truth : mapping
        True values of the axis.

    Returns
    -------
    Course
        Set points and the names of their sections.
    """
    travel, speed = truth['travel'], 0.5 * truth['speed_max']
    acceleration = 0.5 * truth['accel_max']
    step = max(min(1e-3, 4e-3 * travel), 30.0 * truth['count'], 3.0 * truth['backlash'])
    far = min(0.25 * travel, 0.5 * speed)
    parts: list[tuple[str, Array, bool]] = [
        ('settle', np.zeros(_samples(SETTLE)), False),
        ('step_up', np.full(_samples(0.6), step), True),
        ('step_down', np.full(_samples(0.6), -step), True),
        ('step_back', np.zeros(_samples(0.6)), True),
    ]
    here = 0.0
    for name, there in (('ramp_out', far), ('ramp_over', -far), ('ramp_home', 0.0)):
        path = here + _move(there - here, speed, acceleration)
        dwell = np.full(_samples(0.3), there)
        parts.append((name, np.concatenate([path, dwell]), False))
        here = there
    t = PERIOD * np.arange(_samples(3.0))
    omega = 2.0 * math.pi
    height = min(0.2 * travel, 0.8 * speed / omega, 0.8 * acceleration / omega**2)
    fade = np.sin(0.5 * math.pi * np.clip(np.minimum(t, 3.0 - t) / 0.5, 0, 1)) ** 2
    parts.append(('sine', height * fade * np.sin(omega * t), False))
    parts.append(('rest', np.zeros(_samples(REST)), False))

    setpoints = np.concatenate([part for _, part, _ in parts])
    velocities = np.gradient(setpoints, PERIOD)
    counted = np.ones(len(setpoints), bool)
    sections: dict[str, slice] = {}
    begin = 0
    for name, part, raw in parts:
        end = begin + len(part)
        sections[name] = slice(begin, end)
        if raw:
            velocities[begin - 2 : end] = 0.0
            counted[begin : begin + _samples(GRACE)] = False
        begin = end
    counted[sections['settle']] = False
    return Course(setpoints, velocities, sections, counted, step)


@dataclass(frozen=True)
class Verdict:
    """Outcome of one trial.

    Attributes
    ----------
    ok : bool
        Whether the loop was stable.
    rms, peak : float
        Following error at the sensor, m; infinite if the run broke off.
    reason : str
        What failed, empty if nothing did.
    chatter : float
        Largest rms of duty about its 50 ms mean over the sections.
    rest : float
        Largest error in the last half second, m.
    """

    ok: bool
    rms: float
    peak: float
    reason: str
    chatter: float
    rest: float


def _rest_bound(truth: Mapping[str, Any]) -> float:
    """Largest error at rest at the end, m."""
    return float(10e-6 + 5.0 * truth['count'] + 1.5 * truth['backlash'] + 2e-4 * truth['travel'])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _ripple(values: Array, seconds: float) -> Array:
    """Values about their moving mean, without the ends."""
    width = _samples(seconds)
    mean = np.convolve(values, np.full(width, 1.0 / width), 'valid')
    return values[width // 2 : width // 2 + len(mean)] - mean


def judge(
    axis: Axis,
    make_controller: Callable[[], Controller],
    gain: float = 1.0,
    seed: int = 0,
) -> Verdict:
    """Try a controller on the true axis; see `stable`.

    Parameters
    ----------
    axis : Axis
        Not changed.
    make_controller : callable
        Returns a fresh controller.
    gain : float
        Factor on the force per duty (speed per duty, hydraulic) of the axis.
    seed : int
        Seed of the duty noise.

    Returns
    -------
    Verdict
        With a reason where it fails.
    """
    truth = axis.truth
    twin = axis.scaled(gain)
    twin.reset(0.0, seed)
    course = sequence(truth)
    duty, _, true = run(twin, make_controller(), course.setpoints, course.velocities)
    if not (np.isfinite(duty).all() and np.isfinite(true).all()):
        return Verdict(False, math.inf, math.inf, 'not finite', math.inf, math.inf)

    error = course.setpoints - true
    rms = _rms(error[course.counted])
    peak = float(np.max(np.abs(error[course.counted])))
    bound = _rest_bound(truth)
    half = _samples(0.5)
    chatter = max(
        _rms(_ripple(duty[part], 0.05))
        for name, part in course.sections.items()
        if name != 'settle'
    )
    rest = float(np.max(np.abs(error[-half:])))
    reason = ''
    after = course.sections['settle'].stop
    sine = error[course.sections['sine']]
    middle = _samples(1.0)
    first, last = sine[half : half + middle], sine[-half - middle : -half]
    calm = error[course.sections['rest']]
    earlier, later = (_rms(part - part.mean()) for part in (calm[-2 * half : -half], calm[-half:]))
    amplitude = float(np.ptp(course.setpoints[course.sections['ramp_over']]))
    if np.max(np.abs(true[after:])) > 0.5 * truth['travel']:
        reason = 'beyond the travel'
    elif chatter > CHATTER:
        reason = 'duty chatters'
    elif peak > 0.25 * amplitude + course.step:
        reason = 'does not follow'
    elif _rms(last) > 1.5 * _rms(first) + bound:
        reason = 'grows in the sine'
    elif later > 1.2 * earlier + 0.25 * bound:
        reason = 'grows at rest'
    elif rest > bound:
        reason = 'not at rest'
    return Verdict(not reason, rms, peak, reason, chatter, rest)


def stable(
    axis: Axis, make_controller: Callable[[], Controller], gain: float = 1.0
) -> tuple[bool, float, float]:
    """Judge a controller on the true axis.

    The axis, its force (or speed) per duty multiplied, follows `sequence`. It
    is stable if it stays within the travel, its duty does not chatter, its
    error neither grows nor comes near the size of the moves, and it ends at
    rest within ``10 um + 5 counts + 1.5 backlash + 0.2 mm/m of travel``.

    Parameters
    ----------
    axis : Axis
        Not changed.
    make_controller : callable
        Returns a fresh controller.
    gain : float
        Factor on the gain of the axis, 0.5 to 1.5.

    Returns
    -------
    ok : bool
        Whether the loop was stable.
    rms, peak : float
        Following error at the sensor, m, without the first standstill and the
        first 0.4 s after each raw step.
    """
    verdict = judge(axis, make_controller, gain)
    return verdict.ok, verdict.rms, verdict.peak


@dataclass(frozen=True)
class Best:
    """Result of `search_best`.

    Attributes
    ----------
    parameters : dict or None
        The best ones; None if no trial was stable over all gains.
    cost : float
        Geometric mean of the rms following error over the gains, m.
    rms : tuple of float
        At each gain.
    stable_trials : int
        How many trials were stable at all gains.
    costs : ndarray
        Cost of each trial, infinite where unstable.
    """

    parameters: dict[str, float] | None
    cost: float
    rms: tuple[float, ...]
    stable_trials: int
    costs: Array


def search_best(
    axis: Axis,
    make_controller: Callable[[dict[str, float]], Controller],
    bounds: Mapping[str, tuple[float, float]],
    trials: int = 64,
    seed: int = 0,
    gains: Sequence[float] = (0.5, 1.0, 1.5),
) -> Best:
    """Search tuning parameters on the true axis by a Latin hypercube.

    The first half of the trials fills the bounds; the second half fills a
    box of a third of the size (in the same scale) around the best so far.

    Parameters
    ----------
    axis : Axis
        Not changed.
    make_controller : callable
        Makes a fresh controller from a dict of parameters.
    bounds : mapping of str to (float, float)
        Range of each parameter; on a logarithmic scale if the low end is
        positive and the high end is 10 times it or more.
    trials : int
        Number of parameter sets.
    seed : int
        Seed of the search.
    gains : sequence of float
        Factors on the gain; a set must be stable at all of them.

    Returns
    -------
    Best
        The set with the least geometric mean of the rms error.
    """
    rng = np.random.default_rng(seed)
    names = list(bounds)
    low = np.array([bounds[name][0] for name in names], float)
    high = np.array([bounds[name][1] for name in names], float)
    log = (low > 0.0) & (high >= 10.0 * low)
    low[log], high[log] = np.log(low[log]), np.log(high[log])
    best: dict[str, float] | None = None
    best_cost, best_rms = math.inf, (math.inf,) * len(gains)
    best_at = 0.5 * (low + high)
    costs: list[float] = []
    first = trials - trials // 2
    for size, number in ((1.0, first), (1.0 / 3.0, trials - first)):
        wide = size if best is not None else 1.0
        bottom = np.clip(best_at - 0.5 * wide * (high - low), low, high)
        top = np.clip(best_at + 0.5 * wide * (high - low), low, high)
        cells = np.stack([rng.permutation(number) for _ in names], axis=1)
        unit = (cells + rng.random(cells.shape)) / max(number, 1)
        for row in bottom + unit * (top - bottom):
            values = np.where(log, np.exp(np.where(log, row, 0.0)), row)
            chosen = dict(zip(names, values.tolist(), strict=True))
            errors: list[float] = []
            for gain in gains:
                ok, rms, _ = stable(axis, lambda c=chosen: make_controller(c), gain)
                if not ok:
                    break
                errors.append(max(rms, 1e-12))
            cost = math.inf
            if len(errors) == len(gains):
                cost = float(np.exp(np.mean(np.log(errors))))
            costs.append(cost)
            if cost < best_cost:
                best, best_cost, best_rms = chosen, cost, tuple(errors)
                best_at = row
    array = np.array(costs)
    return Best(best, best_cost, best_rms, int(np.isfinite(array).sum()), array)


# The generator.


class _Dice:
    """Draws of one axis."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([0xA7E5, seed])

    def even(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def log(self, low: float, high: float) -> float:
        return float(np.exp(self.rng.uniform(math.log(low), math.log(high))))

    def chance(self, probability: float) -> bool:
        return bool(self.rng.random() < probability)


def draw(seed: int) -> Axis:
    """Draw an axis.

    Parameters
    ----------
    seed : int
        Seed; the kind is ``KINDS[seed % 7]``.

    Returns
    -------
    Axis
        At rest in the middle of its travel.
    """
    dice = _Dice(seed)
    kind = KINDS[seed % len(KINDS)]
    hydraulic, voice = kind == 'hydraulic', kind == 'voice_coil'
    two_mass = kind in ('flexible_motor', 'flexible_load', 'backlash')

    # Mass and force.
    if voice:
        mass, thrust = dice.log(0.05, 2.0), dice.log(20.0, 120.0)
    elif hydraulic:
        mass, thrust = dice.log(30.0, 800.0), math.nan
    else:
        mass, thrust = dice.log(2.0, 400.0), dice.log(8.0, 40.0)
    gain = mass * thrust

    # Actuator.
    drive, valve_rate, back_force, viscous = 'current', 0.0, 0.0, 0.0
    oil_hz = oil_ratio = math.nan
    if hydraulic:
        # The oil is a spring that leaks: F' = k (speed_gain u - v) - leak F.
        drive = 'valve'
        oil_hz, oil_ratio = dice.log(8.0, 60.0), dice.even(0.12, 0.4)
        oil = 2.0 * math.pi * oil_hz
        force_rate = 2.0 * oil_ratio * oil
        back_force = mass * oil**2 / force_rate
        gain = dice.log(0.1, 1.0) * back_force
        viscous = mass * dice.even(0.5, 4.0)
        valve_rate = 2.0 * math.pi * dice.log(20.0, 120.0)
    elif voice:
        force_rate = 2.0 * math.pi * dice.log(500.0, 2000.0)
        viscous = mass / dice.log(0.3, 4.0)
    elif dice.chance(0.35):
        drive = 'voltage'
        force_rate = dice.log(250.0, 1500.0)
        back_force = mass / dice.log(0.03, 0.15)
        viscous = mass / dice.log(0.5, 3.0)
    else:
        force_rate = 2.0 * math.pi * dice.log(100.0, 1000.0)
        viscous = mass / dice.log(0.2, 3.0)

    # Dry friction.
    if voice:
        coulomb = gain * dice.log(0.002, 0.02)
    elif hydraulic:
        coulomb = mass * dice.even(0.3, 2.0)
    else:
        coulomb = gain * dice.log(0.008, 0.07)
    static_ratio, stribeck_speed = dice.even(1.0, 1.5), dice.log(5e-4, 1e-2)

    # Dead time.
    delay = 0.0
    if kind == 'dead_time':
        delay = dice.log(0.6e-3, 6e-3)
    elif dice.chance(0.35):
        delay = dice.log(0.2e-3, 1.0e-3 if voice else 2.0e-3)
    delay_steps = round(delay / SUBSTEP)

    # Dead band and the two directions.
    dead_band, ratio = 0.0, 1.0
    if hydraulic:
        dead_band, ratio = dice.even(0.01, 0.07), dice.even(1.15, 1.8)
    elif not voice and dice.chance(0.15):
        dead_band, ratio = dice.even(0.003, 0.015), dice.even(1.0, 1.1)
    if dice.chance(0.5):
        ratio = 1.0 / ratio
    gain_pos, gain_neg = gain * math.sqrt(ratio), gain / math.sqrt(ratio)

    # Two masses.
    mass1, mass2, stiffness, damping, gap = mass, 0.0, 0.0, 0.0, 0.0
    share, sensor_on_load = 1.0, False
    resonance: float | None = None
    antiresonance: float | None = None
    mode_ratio: float | None = None
    if two_mass:
        share = dice.even(0.25, 0.6)
        mass1, mass2 = share * mass, (1.0 - share) * mass
        if kind == 'flexible_motor':
            resonance, mode_ratio = dice.log(8.0, 200.0), dice.even(0.01, 0.08)
            if dice.chance(0.2):
                gap = dice.log(5e-6, 30e-6)
        elif kind == 'flexible_load':
            sensor_on_load = True
            resonance, mode_ratio = dice.log(15.0, 200.0), dice.even(0.03, 0.12)
        else:
            resonance, mode_ratio = dice.log(40.0, 180.0), dice.even(0.05, 0.2)
            gap = dice.log(5e-6, 80e-6)
            sensor_on_load = dice.chance(0.5)
        reduced = mass1 * mass2 / mass
        omega = 2.0 * math.pi * resonance
        stiffness = reduced * omega**2
        damping = 2.0 * mode_ratio * reduced * omega
        antiresonance = math.sqrt(stiffness / mass2) / (2.0 * math.pi)
    elif hydraulic:
        resonance, mode_ratio = oil_hz, oil_ratio
    on_motor = dice.even(0.15, 0.5) if two_mass else 1.0

    # Gravity, on the load, against the positive direction.
    net = 0.0
    if kind != 'dead_time' and dice.chance(0.3):
        most = 0.05 if hydraulic else dice.even(0.05, 0.15)
        net = min(mass * GRAVITY, most * min(gain_pos, gain_neg))

    # Travel, speed and acceleration that half the gain can still do.
    weak = 0.5 * min(gain_pos, gain_neg) * (1.0 - dead_band)
    spare = weak - static_ratio * coulomb - net
    whole_viscous = viscous + back_force
    travel = dice.log(5e-3, 50e-3) if voice else dice.log(0.15, 2.5)
    if hydraulic:
        accel_max = 0.2 * 2.0 * math.pi * oil_hz * 0.5 * gain / back_force
        accel_max = min(accel_max, 0.4 * spare / mass, 20.0)
    else:
        accel_max = 0.5 * spare / mass
    speed_max = min(
        dice.log(0.1, 1.0) if voice else dice.log(0.1, 2.0),
        0.6 * spare / whole_viscous,
        math.sqrt(0.2 * travel * accel_max),
    )
    if voice:
        count = dice.log(0.05e-6, 0.5e-6)
    elif hydraulic:
        count = dice.log(1e-6, 10e-6)
    else:
        count = dice.log(0.1e-6, 10e-6)
    noise = dice.log(1e-4, 4e-3)

    bounce = 2.0 * math.pi * 15.0
    parameters = {
        'dt': SUBSTEP,
        'substeps': round(PERIOD / SUBSTEP),
        'two_mass': float(two_mass),
        'sensor_on_load': float(sensor_on_load),
        'mass1': mass1,
        'mass2': mass2,
        'stiffness': stiffness,
        'damping': damping,
        'gap': gap,
        'viscous1': viscous * on_motor,
        'viscous2': viscous * (1.0 - on_motor),
        'coulomb1': coulomb * on_motor,
        'coulomb2': coulomb * (1.0 - on_motor),
        'static_ratio': static_ratio,
        'stribeck_speed': stribeck_speed,
        'gain_pos': gain_pos,
        'gain_neg': gain_neg,
        'gain_scale': 1.0,
        'dead_band': dead_band,
        'back_force': back_force,
        'force_rate': force_rate,
        'valve_rate': valve_rate,
        'delay_steps': float(delay_steps),
        'gravity': -net,
        'limit': 0.5 * travel,
        'stop_stiffness': mass * bounce**2,
        'stop_damping': mass * bounce,
        'count': count,
        'noise': noise,
    }
    truth: dict[str, Any] = {
        'name': f'{kind}-{seed}',
        'seed': seed,
        'kind': kind,
        'drive': drive,
        'plant': 'speed' if hydraulic else 'force',
        'mass': mass,
        'motor_mass': mass1,
        'load_mass': mass2,
        'gain': math.sqrt(gain_pos * gain_neg),
        'gain_positive': gain_pos,
        'gain_negative': gain_neg,
        'speed_gain': gain / whole_viscous,
        'dead_band': dead_band,
        'viscous': whole_viscous,
        'coulomb': coulomb,
        'static': static_ratio * coulomb,
        'stribeck_speed': stribeck_speed,
        'dead_time': delay_steps * SUBSTEP,
        'force_lag': 1.0 / force_rate,
        'valve_lag': 1.0 / valve_rate if valve_rate else 0.0,
        'resonance_hz': resonance,
        'antiresonance_hz': antiresonance,
        'damping_ratio': mode_ratio,
        'backlash': gap,
        'count': count,
        'sensor': 'load' if sensor_on_load else 'motor',
        'travel': travel,
        'limits': (-0.5 * travel, 0.5 * travel),
        'speed_max': speed_max,
        'accel_max': accel_max,
        'vertical': net > 0.0,
        'gravity': net,
        'duty_noise': noise,
    }
    return Axis(parameters, truth)
