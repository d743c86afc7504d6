# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Stability of a variable-universe controller on an axis, with its margins.

Near the target the controller is linear, and the sampled loop with its observer has eigenvalues
and margins like any other.  Farther out the equivalent gains of a sine of that amplitude stand for
the contracted surface (describing function).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, nan, pi

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.core.servo.controller import closed_loop
from fuzzycnc_ros.core.servo.params import ultimate_gain
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController

_GAINS = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75)
"""Gains of the axis, as multiples of the nominal one, that a report covers."""

_PHASES = np.linspace(0.0, 2.0 * pi, 256, endpoint=False)
_FREQUENCIES = 4000
_AMPLITUDES = np.geomspace(1e-7, 0.1, 61)
"""Amplitudes that are searched for a limit cycle [m]."""


@dataclass(frozen=True, kw_only=True)
class StabilityReport:
    """Stability margins of the loop.

    Attributes
    ----------
    error_gain, rate_gain : float
        Duty per error [1/m] and error rate [s/m] at the origin.
    ultimate_gain : float
        Error gain at which the loop without any rate action begins to swing [1/m].
    error_floor_min : float
        Contraction floor of the error that would just do without rate action [-].
    gain_margin : tuple of float
        Factors on the axis' gain, below and above 1, at which the loop begins to swing; 0 and
        infinite if none does.
    phase_margin : float
        Least phase to spare where the loop's gain is 1 [rad].
    crossover : float
        Frequency there [rad/s].
    spectral_radius : dict of float to float
        Largest magnitude of an eigenvalue per gain factor; below 1 it settles.
    limit_cycle : float
        Amplitude of the error of a lasting oscillation [m]; 0 if none is predicted.
    limit_cycle_frequency : float
        Its frequency [rad/s]; NaN if there is none.
    """

    error_gain: float
    rate_gain: float
    ultimate_gain: float
    error_floor_min: float
    gain_margin: tuple[float, float]
    phase_margin: float
    crossover: float
    spectral_radius: dict[float, float]
    limit_cycle: float
    limit_cycle_frequency: float

    @property
    def settles(self) -> bool:
        """True if all gains settle and no limit cycle is predicted at the nominal one."""
        return max(self.spectral_radius.values()) < 1.0 and self.limit_cycle == 0.0


def stability_report(
    controller: VariableUniverseController, gains: Sequence[float] = _GAINS
) -> StabilityReport:
    """Return how stable the loop of a controller around its own axis is.

    Parameters
    ----------
    controller : VariableUniverseController
        Controller; its state is of no matter.  Of `paper_literal` the recursion is left out: it
        only ever lowers the gain.
    gains : sequence of float
        Gain factors of the axis, positive.

    Raises
    ------
    ValueError
        If a gain factor is not positive.

    Examples
    --------
    >>> lags = {'amplifier': 8e-4, 'torque': 1.5e-3}
    >>> axis = LinearAxis.chain(0.286, lags, 0.017, sensor_lag=6e-3, period=1e-3)
    >>> report = stability_report(VariableUniverseController(axis), gains=(1.0, 1.75))
    >>> {gain: round(radius, 3) for gain, radius in report.spectral_radius.items()}
    {1.0: 0.968, 1.75: 1.014}
    """
    radii = spectral_radii(controller, gains)
    params, axis = controller.params, controller.axis
    linear = params.error_gain, params.rate_gain
    most = ultimate_gain(axis)
    margin, phase, crossover = _margins(controller, *linear)
    amplitude, frequency = _limit_cycle(controller)
    return StabilityReport(
        error_gain=linear[0],
        rate_gain=linear[1],
        ultimate_gain=most,
        error_floor_min=params.error_floor * linear[0] / most,
        gain_margin=margin,
        phase_margin=phase,
        crossover=crossover,
        spectral_radius=radii,
        limit_cycle=amplitude,
        limit_cycle_frequency=frequency,
    )


def spectral_radii(
    controller: VariableUniverseController, gains: Sequence[float]
) -> dict[float, float]:
    """Return the largest magnitude of an eigenvalue of the loop near the target, by gain.

    Parameters
    ----------
    controller : VariableUniverseController
        Controller; its state is of no matter.
    gains : sequence of float
        Gain factors of the axis, positive.

    Raises
    ------
    ValueError
        If a gain factor is not positive.
    """
    for gain in gains:
        if not 0.0 < gain < inf:
            raise ValueError(f'gains: expected positive factors but found {gain}')
    linear = controller.params.error_gain, controller.params.rate_gain
    return {gain: float(np.abs(_eigenvalues(controller, *linear, gain)).max()) for gain in gains}


def _changed(axis: LinearAxis, factor: float) -> LinearAxis:
    """Return an axis whose gain has changed by a factor."""
    velocity = axis.states.index('velocity')
    a, b, disturbance = axis.a.copy(), axis.b.copy(), axis.disturbance * factor
    kept = a[velocity, velocity]
    a[velocity] *= factor
    a[velocity, velocity] = kept
    b[velocity] *= factor
    return replace(axis, a=a, b=b, disturbance=disturbance, gain=axis.gain * factor)


def _eigenvalues(
    controller: VariableUniverseController, error_gain: float, rate_gain: float, factor: float
) -> Array:
    """Return the eigenvalues of the sampled loop with linear gains."""
    axis = _changed(controller.axis, factor)
    dynamics, duty, _ = axis.discrete()
    whole = closed_loop(dynamics, duty, axis.c, controller.linear_law(error_gain, rate_gain))
    return np.asarray(np.linalg.eigvals(whole))


def _margins(
    controller: VariableUniverseController, error_gain: float, rate_gain: float
) -> tuple[tuple[float, float], float, float]:
    """Return gain margins, least phase margin [rad] and its frequency [rad/s]."""
    axis = controller.axis
    dynamics, duty, _ = axis.discrete()
    inner, entry, row, direct = controller.linear_law(error_gain, rate_gain)
    # up to just below half the sampling frequency, where everything is real
    frequency = np.geomspace(0.05, 0.999 * pi / axis.period, _FREQUENCIES)
    z = np.exp(1j * frequency * axis.period)[:, np.newaxis, np.newaxis]
    loop = -(_response(dynamics, duty, z) @ axis.c) * (_response(inner, entry, z) @ row + direct)
    turned = (loop.imag[1:] * loop.imag[:-1] <= 0.0) & (loop.real[1:] < 0.0)
    factors = -1.0 / loop.real[1:][turned]
    below, above = factors[factors < 1.0], factors[factors >= 1.0]
    margin = (float(below.max(initial=0.0)), float(above.min(initial=inf)))
    size = np.abs(loop)
    crossing = np.flatnonzero((size[1:] - 1.0) * (size[:-1] - 1.0) <= 0.0) + 1
    if not len(crossing):
        return margin, nan, nan
    spare = np.abs(np.angle(-loop[crossing]))
    least = int(spare.argmin())
    return margin, float(spare[least]), float(frequency[crossing[least]])


def _response(dynamics: Array, entry: Array, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the states' response to their entry at points (k, 1, 1) of the z plane, (k, n)."""
    shifted = z * np.eye(len(dynamics)) - dynamics
    column = np.broadcast_to(entry[:, np.newaxis], (len(z), len(entry), 1))
    return np.asarray(np.linalg.solve(shifted, column)[..., 0])


def _limit_cycle(controller: VariableUniverseController) -> tuple[float, float]:
    """Return amplitude [m] and frequency [rad/s] of the largest lasting oscillation."""
    swings, frequencies = [], []
    for amplitude in _AMPLITUDES:
        radius, frequency = _swing(controller, float(amplitude))
        swings.append(radius > 1.0)
        frequencies.append(frequency)
    # lasting: smaller ones grow, larger ones die down
    last = [k for k in range(len(swings) - 1) if swings[k] and not swings[k + 1]]
    if not last:
        return 0.0, nan
    low, high = _AMPLITUDES[last[-1]], _AMPLITUDES[last[-1] + 1]
    for _ in range(20):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if _swing(controller, middle)[0] > 1.0 else (low, middle)
    return float(low), frequencies[last[-1]]


def _swing(controller: VariableUniverseController, amplitude: float) -> tuple[float, float]:
    """Return spectral radius and frequency [rad/s] of the loop for a swing of an amplitude."""
    period = controller.period
    gains = controller.params.error_gain, controller.params.rate_gain
    frequency = 0.1 / period
    radius = 0.0
    for _ in range(8):
        gains = _equivalent(controller, amplitude, frequency)
        values = _eigenvalues(controller, *gains, 1.0)
        # slow real ones, of integrals, do not swing
        swinging = values[np.abs(values.imag) > 1e-9]
        if not len(swinging):
            return 0.0, nan
        worst = swinging[np.abs(swinging).argmax()]
        radius = float(abs(worst))
        frequency = float(abs(np.angle(worst)) / period)
    return radius, frequency


def _equivalent(
    controller: VariableUniverseController, amplitude: float, frequency: float
) -> tuple[float, float]:
    """Return the gains [1/m, s/m] of the cut duty for a sine of the error."""
    error = amplitude * np.sin(_PHASES)
    rate = amplitude * frequency * np.cos(_PHASES)
    top = controller.duty_max
    sign = 1.0 if controller.axis.gain > 0.0 else -1.0
    duty = sign * np.clip(controller.surface(error, rate), -top, top)
    in_phase = 2.0 * float((duty * np.sin(_PHASES)).mean()) / amplitude
    ahead = 2.0 * float((duty * np.cos(_PHASES)).mean()) / (amplitude * frequency)
    return in_phase, ahead
