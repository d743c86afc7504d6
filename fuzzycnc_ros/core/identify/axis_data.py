# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""From an identified axis to the machine data of an axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import isfinite

import numpy as np

from fuzzycnc_ros.core.identify.axis_fit import AxisFit, AxisRecording, fit_axis
from fuzzycnc_ros.core.identify.frequency import FrequencyResponse, frequency_response
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData

_ROOM = 1.1
"""What limits are above what was recorded [-]."""


def _told(fit: AxisFit, name: str) -> bool:
    """Whether a parameter was identified, and the data can tell it."""
    return any(one.name == name and not one.why_not for one in fit.parameters)


def identified_dead_time(fit: AxisFit, response: FrequencyResponse) -> tuple[float, str]:
    """Return the dead time [s] and how it was found.

    The phase of the frequency response tells it better than an open-loop simulation, where it
    shows; lags of the drive are part of it.
    """
    delay, error = response.dead_time
    if isfinite(delay) and delay > 2.0 * error:
        return delay, 'phase'
    if _told(fit, 'delay'):
        return fit.model.delay + fit.model.drive_lag, 'output error'
    return 0.0, ''


def identify_axis(
    recordings: Sequence[AxisRecording],
    *,
    force: float | None = None,
    direction: float = 1.0,
    before: AxisData | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[AxisFit, FrequencyResponse, AxisData]:
    """Return the fit of an axis, its frequency response, and its machine data.

    Parameters
    ----------
    recordings : sequence of AxisRecording
        Stretches with commands as duties.
    force, direction, before
        As of `identified_axis`.
    progress : callable, optional
        Told what is fitted, how many fits are done, and how many there are.
    """
    fit = fit_axis(recordings, progress)
    response = frequency_response(recordings, fit.model.gain)
    data = identified_axis(
        fit, response, recordings, force=force, direction=direction, before=before
    )
    return fit, response, data


def identified_axis(
    fit: AxisFit,
    response: FrequencyResponse,
    recordings: Sequence[AxisRecording],
    *,
    force: float | None = None,
    direction: float = 1.0,
    before: AxisData | None = None,
) -> AxisData:
    """Return the machine data of an identified axis.

    Parameters
    ----------
    fit, response
        What was identified, from commands as duties.
    recordings : sequence of AxisRecording
        What it was identified from: its count, period and limits follow.
    force : float, optional
        Force at full duty [N]; without it the mass is called 1 kg.
    direction : float
        Sign of the positions that a positive duty drives to; the recordings are turned to 1.
    before : AxisData, optional
        What is kept of the axis; its limits but for resonance, where it has a plant.
    """
    model = fit.model
    mass = 1.0 if force is None else force / model.gain
    full = mass * model.gain
    delay, _ = identified_dead_time(fit, response)
    steps = np.abs(np.concatenate([np.diff(one.position) for one in recordings]))
    count = float(steps[steps > 0.0].min())
    period = recordings[0].period
    plant = BallscrewAxisConfig(
        mass=max(mass, 0.1),
        viscous_forward=max(mass * model.viscous_forward, 1.0),
        viscous_backward=max(mass * model.viscous_backward, 1.0),
        coulomb_forward=max(mass * model.coulomb, 0.0),
        coulomb_backward=max(mass * model.coulomb, 0.0),
        offset=mass * model.offset,
        force_constant=full / 10.0,
        voltage_max=10.0,
        delay=min(delay, 0.1),
        count=count if count < 1e-4 else 0.0,
        noise=0.0 if count < 1e-4 else 1e-7,
        direction=direction,
        period=period,
    )
    known = before or AxisData()
    limits = replace(known.limits, resonance=response.resonance)
    if known.plant is None:
        speed = max(float(np.abs(np.diff(one.position)).max()) / period for one in recordings)
        low = min(float(one.position.min()) for one in recordings)
        high = max(float(one.position.max()) for one in recordings)
        middle = 0.5 * (low + high)
        half = 0.5 * _ROOM * (high - low)
        limits = replace(
            limits,
            velocity=min(max(_ROOM * speed, 1e-4), 100.0),
            acceleration=max(0.4 * model.gain, 1e-3),
            travel_low=middle - half,
            travel_high=middle + half,
        )
    return replace(known, limits=limits, plant=plant)
