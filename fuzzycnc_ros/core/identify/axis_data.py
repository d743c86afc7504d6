# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""From a recording to the machine data of an axis, and to how well they are known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite, sqrt
from typing import Any

import numpy as np
from scipy.signal import savgol_filter

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.identify.axis_fit import (
    AxisFit,
    AxisRecording,
    FrictionByRecording,
    check_recordings,
    fit_axis,
    friction_by_recording,
    inverse_dynamics,
    late,
)
from fuzzycnc_ros.core.identify.frequency import FrequencyResponse, frequency_response
from fuzzycnc_ros.core.identify.response_fit import DEAD_TIME_MAX, ResponseFit, fit_response
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.knowledge import AxisKnowledge, remainder_text
from fuzzycnc_ros.core.machine.machine_data import AxisData

_ROOM = 1.1
"""Room of the limits above the largest recorded values [-]."""

_UNFIT = 0.7
"""Share of the acceleration that no model explains from which it is not fit for control [-]."""

_HELD = 0.15
"""Force that grows with the position from which a model without it is not fit for control, at the
end of the way as share of the drive [-]."""

_KNOWN_TO = 4.0
"""Frequency up to which a response has to be known at least [Hz]."""

_FOLLOWS = 40.0
"""Rate of viscous friction from which the speed follows the command at once [1/s]."""

_OCTAVE_PARTS = 2
"""Frequencies of an octave for which the remainder is written down."""

_NO_STEP = 1e-12
"""Change of a reading that is none [m]."""

_PARTS, _NEAR, _OFF = 12, 40.0, 0.2
"""Parts of the least step that one count may be, counts of the steps that are looked at, and what
they may be off a multiple of it [-]."""

_BLOCKS = 20
"""Blocks of a recording over which the force of a spring is judged."""


@dataclass(frozen=True, eq=False)
class IdentifiedAxis:
    """Axis model and limits identified from a recording.

    Attributes
    ----------
    fit : AxisFit
        Gain and friction by the course of the position.
    response : FrequencyResponse
        What was measured of the frequency response.
    linear : ResponseFit or None
        Dead time and mode from that, with intervals; None where too little of it is known.
    data : AxisData
        Machine data.
    period : float
        Time between two samples [s].
    friction : FrictionByRecording or None
        Friction of each recording; None where there is one, or the axis answers by its speed.
    """

    fit: AxisFit
    response: FrequencyResponse
    linear: ResponseFit | None
    data: AxisData
    period: float
    friction: FrictionByRecording | None = None


def identify_axis(
    recordings: Sequence[AxisRecording],
    *,
    force: float | None = None,
    direction: float = 1.0,
    before: AxisData | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> IdentifiedAxis:
    """Identify an axis from recordings of its duty and its position.

    Dead time, mode and how far they are known come from the frequency response, friction from the
    course of the position, with the gain between the ends that the response leaves.  Of several
    recordings the friction of the last one is taken where each tells the friction of the next.

    Parameters
    ----------
    recordings : sequence of AxisRecording
        Stretches with commands as duties; one period for all.
    force : float, optional
        Force at full duty [N]; without it the mass is called 1 kg.
    direction : float
        Sign of the positions that a positive duty drives to; the recordings are turned to 1.
    before : AxisData, optional
        What is kept of the axis; its limits but for resonance, where it has a plant.
    progress : callable, optional
        Told what is fitted, how many fits are done, and how many there are.

    Raises
    ------
    ValueError
        If the data cannot tell an axis: too short, no motion, no command, or no motion that
        follows the command.
    """
    check_recordings(recordings)
    rough = inverse_dynamics(recordings)
    response = frequency_response(recordings, rough.gain)
    linear = fit_response(response, rough.gain, rough.viscous_forward)
    gain, delay = (1e-4, 1e5), 0.0
    if linear is not None:
        delay = linear.model.delay
        if linear.gain.high < 2.0 * linear.gain.low:
            gain = 0.92 * linear.gain.low, 1.08 * linear.gain.high
    acting = [late(one, delay) for one in recordings]
    fit = fit_axis(acting, progress, gain=gain)
    data = _machine_data(fit, linear, recordings, force=force, direction=direction, before=before)
    friction = None
    if len(recordings) > 1 and fit.model.viscous_forward < _FOLLOWS:
        friction = friction_by_recording(acting, fit.model)
        data = _rubbing_as_last(data, friction.latest)
    return IdentifiedAxis(fit, response, linear, data, recordings[0].period, friction)


def _rubbing_as_last(data: AxisData, factor: float) -> AxisData:
    plant = data.plant
    assert isinstance(plant, BallscrewAxisConfig)
    names = ('viscous_forward', 'viscous_backward', 'coulomb_forward', 'coulomb_backward')
    scaled: dict[str, Any] = {name: factor * getattr(plant, name) for name in names}
    scaled |= {name: max(scaled[name], 1.0) for name in names[:2]}
    return replace(data, plant=replace(plant, **scaled))


def _machine_data(
    fit: AxisFit,
    linear: ResponseFit | None,
    recordings: Sequence[AxisRecording],
    *,
    force: float | None,
    direction: float,
    before: AxisData | None,
) -> AxisData:
    """Return the machine data of an axis; what is unknown has its safe end."""
    model = fit.model
    mass = 1.0 if force is None else force / model.gain
    full = mass * model.gain
    count = sensor_count(recordings)
    period = recordings[0].period
    told = linear is not None and linear.resonance_known
    plant = BallscrewAxisConfig(
        mass=max(mass, 0.1),
        viscous_forward=max(mass * model.viscous_forward, 1.0),
        viscous_backward=max(mass * model.viscous_backward, 1.0),
        coulomb_forward=max(mass * model.coulomb, 0.0),
        coulomb_backward=max(mass * model.coulomb, 0.0),
        offset=mass * model.offset,
        force_constant=full / 10.0,
        voltage_max=10.0,
        delay=linear.delay.high if linear is not None else DEAD_TIME_MAX,
        count=count,
        noise=0.0 if count else reading_noise(recordings),
        direction=direction,
        period=period,
    )
    if linear is not None and told:
        plant = replace(
            plant,
            mode=linear.model.mode,
            mode_damping=linear.model.damping,
            mode_ratio=linear.model.ratio,
        )
    known = before or AxisData()
    limits = replace(
        known.limits, resonance=linear.mode.low if linear is not None and told else 0.0
    )
    if known.plant is None:
        speed = max(float(np.abs(np.diff(one.position)).max()) / period for one in recordings)
        low = min(float(one.position.min()) for one in recordings)
        high = max(float(one.position.max()) for one in recordings)
        middle = 0.5 * (low + high)
        half = 0.5 * _ROOM * (high - low)
        limits = replace(
            limits,
            velocity=min(max(_ROOM * speed, 1e-4), 100.0),
            acceleration=min(max(0.4 * model.gain, 1e-3), 1e4),
            travel_low=middle - half,
            travel_high=middle + half,
        )
    delay = linear.model.delay if linear is not None else 0.0
    speed_follows = linear is not None and linear.model.viscous > _FOLLOWS
    unexplained, spring = _unexplained(recordings, delay, plant.mode, speed_follows=speed_follows)
    knowledge = AxisKnowledge(unexplained=unexplained)
    if linear is not None:
        knowledge = replace(
            knowledge,
            known_to=linear.known_to,
            gain_low=min(max(linear.level.low, 0.5), 1.0),
            gain_high=max(min(linear.level.high, 2.0), 1.0),
            delay_low=linear.delay.low,
            mode_low=linear.mode.low,
            mode_high=linear.mode.high if isfinite(linear.mode.high) else 0.0,
            damping_low=max(linear.damping.low, 1e-3) if told else 0.02,
            remainder=remainder_text(_remainders(linear)),
        )
    why = _not_fit(linear, unexplained, spring)
    return replace(
        known, limits=limits, plant=plant, knowledge=replace(knowledge, not_fit_for_control=why)
    )


def _not_fit(linear: ResponseFit | None, unexplained: float, spring: float) -> str:
    """Return why no controller may use what was identified; empty where one may."""
    record = 'record what `fuzzycnc machine excite` writes'
    if spring > _HELD:
        return (
            f'a force that grows with the position takes {100.0 * spring:.0f} % of the drive at '
            'the end of the way, a spring or a hose, which no controller here is told of'
        )
    if linear is None or linear.known_to < _KNOWN_TO:
        return f'the recording moves the axis too slowly to tell how it answers; {record}'
    if unexplained > _UNFIT:
        return (
            f'{100.0 * unexplained:.0f} % of the acceleration is unexplained: check columns, unit '
            f'and direction, or {record}'
        )
    return ''


def sensor_count(recordings: Sequence[AxisRecording]) -> float:
    """Return the count that every step of the sensor is a multiple of [m]; 0 where none is.

    A fast recording may have few steps of one count, or none: the least step is no count yet.

    Parameters
    ----------
    recordings : sequence of AxisRecording
        Recordings in which the axis moves.
    """
    steps = np.abs(np.concatenate([np.diff(one.position) for one in recordings]))
    moved = np.sort(steps[steps > _NO_STEP])
    least = float(moved[0])
    for parts in range(1, _PARTS + 1):
        count = least / parts
        near = moved[moved < _NEAR * count]
        for _ in range(2):  # digits of a file make steps of one count differ by a little
            times = np.rint(near / count)
            count = float(times @ near) / float(times @ times)
        if len(near) >= _PARTS and np.abs(near / count - times).max() < _OFF:
            return count
    return 0.0


def reading_noise(recordings: Sequence[AxisRecording]) -> float:
    """Return the RMS of white noise of the readings [m].

    Parameters
    ----------
    recordings : sequence of AxisRecording
        Recordings of an axis, whose acceleration changes more slowly than its readings.
    """
    bends = np.abs(np.concatenate([np.diff(one.position, 3) for one in recordings]))
    return float(np.median(bends)) / (0.6745 * sqrt(20.0))


def _unexplained(
    recordings: Sequence[AxisRecording], delay: float, mode: float, *, speed_follows: bool
) -> tuple[float, float]:
    """Return the share of the acceleration that a rigid axis with friction leaves unexplained.

    A known mode is smoothed away.  Where the speed follows the command at once it is the share of
    the speed.

    Returns
    -------
    unexplained : float
        RMS of what is left over that of the acceleration, smoothed [-].
    spring : float
        Force that grows with the position, at the end of the way as share of the drive [-]; 0
        where it is within three standard errors of none.
    """
    rows, targets = [], []
    for one in recordings:
        wide = max(61, 2 * round(1.5 / (mode * one.period)) + 1) if mode else 61
        window = max(5, min(wide, 2 * (len(one.position) // 20) + 1))
        speed = savgol_filter(one.position, window, 3, deriv=1, delta=one.period)
        rise = savgol_filter(one.position, window, 3, deriv=2, delta=one.period)
        # filtered as the position is, so that both are equally late
        acted = late(one, delay).command
        command = savgol_filter(_twice_summed(acted), window, 3, deriv=2)
        moving = np.abs(speed) > 0.03 * np.abs(speed).max()
        place = one.position - one.position.mean()
        lost, target = (0.0 * speed, speed) if speed_follows else (-speed, rise)
        sides = np.column_stack([command, lost, -np.sign(speed), -np.ones(len(speed)), -place])
        rows.append(sides[moving])
        targets.append(target[moving])
    sides, target = np.concatenate(rows), np.concatenate(targets)
    if len(target) < 10 * _BLOCKS:
        return 1.0, 0.0
    found, *_ = np.linalg.lstsq(sides[:, :4], target, rcond=None)
    left = target - sides[:, :4] @ found
    share = sqrt(float((left**2).mean() / max((target**2).mean(), 1e-300)))
    every = [np.linalg.lstsq(sides, target, rcond=None)[0]]
    for block in np.array_split(np.arange(len(target)), _BLOCKS):
        keep = np.ones(len(target), bool)
        keep[block] = False
        every.append(np.linalg.lstsq(sides[keep], target[keep], rcond=None)[0])
    springs = np.array([one[4] / max(one[0], 1e-9) for one in every])
    error = sqrt((_BLOCKS - 1) * float(springs[1:].var()))
    reach = 0.5 * max(float(np.ptp(one.position)) for one in recordings)
    held = springs[0] - 3.0 * error
    return min(share, 1.0), max(float(held) * reach, 0.0) if held > 0.0 else 0.0


def _twice_summed(values: Array) -> Array:
    """Return the double sum whose second derivative by samples is the values."""
    mean = float(values.mean())
    parabola = 0.5 * mean * np.arange(len(values), dtype=np.float64) ** 2
    return np.asarray(np.cumsum(np.cumsum(values - mean)) + parabola)


def _remainders(linear: ResponseFit) -> Iterator[tuple[float, float]]:
    """Yield the largest deviation from the model in every part of an octave.

    Where half of the lines are known these alone count: the others are not told by the axis.
    """
    lowest = max(linear.frequency[0], 1.0)
    edge = lowest
    step = 2.0 ** (1.0 / _OCTAVE_PARTS)
    while edge < linear.frequency[-1]:
        inside = (linear.frequency >= edge) & (linear.frequency < step * edge)
        told = inside & linear.known
        inside = told if 2 * told.sum() >= inside.sum() else inside
        if inside.any():
            yield edge * sqrt(step), min(float(linear.remainder[inside].max()), 1e3)
        edge *= step
