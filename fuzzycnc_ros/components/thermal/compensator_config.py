# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of `compensator`."""

from dataclasses import dataclass

from fuzzycnc_ros.core.config import Config, param

AXES = ('X', 'Y', 'Z', 'A', 'B', 'C', 'U', 'V', 'W')
"""Axis names of ISO 841."""


@dataclass(frozen=True, kw_only=True)
class CompensatorConfig(Config):
    """Parameters of `compensator`."""

    autostart: bool = param(
        False, '-', 'Configure and activate at start; otherwise a lifecycle manager does'
    )
    axes: tuple[str, ...] = param(('Y', 'Z'), '-', 'Axes that are compensated, ISO 841 names')
    offset_max: float = param(
        50e-6, 'm', 'Largest offset on any axis', low=0.0, high=1e-3, live=True
    )
    error_max: float = param(
        200e-6,
        'm',
        'Largest thermal error that a model may say; what is beyond is held to be wrong, where '
        'one beyond offset_max is cut',
        low=1e-6,
        high=1e-2,
        live=True,
    )
    slew_max: float = param(
        0.1e-6, 'm/s', 'Fastest change of an offset', low=1e-9, high=1e-3, live=True
    )
    ramp_rate: float = param(
        0.1e-6, 'm/s', 'Speed at which offsets go to zero; not above slew_max', low=1e-9, high=1e-3
    )
    period: float = param(
        10.0, 's', 'Time between updates while offsets move without an input', low=0.01, high=600.0
    )
    stale_after: float = param(
        150.0, 's', 'Age of the error beyond which offsets are held', low=0.01, high=7200.0
    )
    hold_time: float = param(
        300.0, 's', 'How long offsets are held before they ramp to zero', low=0.0, high=7200.0
    )
    validity: float = param(
        180.0, 's', 'How long the machine side may trust one message', low=0.01, high=7200.0
    )
