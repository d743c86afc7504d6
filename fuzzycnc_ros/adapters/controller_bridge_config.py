# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters that every bridge to a controller has."""

from dataclasses import dataclass

from fuzzycnc_ros.core.config import Config, param


@dataclass(frozen=True, kw_only=True)
class ControllerBridgeConfig(Config):
    """Parameters that every bridge to a controller has."""

    autostart: bool = param(
        False, '-', 'Configure and activate at start; otherwise a lifecycle manager does'
    )
    axes: tuple[str, ...] = param(('X', 'Y', 'Z'), '-', 'Axes that take offsets')
    offset_max: float = param(60e-6, 'm', 'Largest offset of an axis', low=1e-6, high=1e-3)
    slew_max: float = param(5e-6, 'm/s', 'Fastest change of an offset', low=1e-9, high=1e-3)
    lead_max: float = param(
        5.0, 's', 'How far ahead of the machine a command may be stamped', low=0.0, high=3600.0
    )
    validity_max: float = param(
        180.0,
        's',
        'How long after its stamp a command acts at most, whatever it says itself: three times '
        'the period of its source',
        low=0.01,
        high=7200.0,
    )
    adopt_time: float = param(
        120.0,
        's',
        'How long offsets that stand at the activation are kept while no command comes',
        low=0.0,
        high=7200.0,
    )
    cycle_period: float = param(
        0.005, 's', 'Time between two looks at the controller', low=0.001, high=0.1
    )
    report_period: float = param(
        0.2, 's', 'Time between two reports while nothing changes', low=0.01, high=10.0
    )
