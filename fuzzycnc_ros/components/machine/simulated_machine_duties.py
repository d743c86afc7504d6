# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Duties that the simulated machine can be given: those of method sheet 001 and a whole shift."""

from collections.abc import Mapping
from types import MappingProxyType

from fuzzycnc_ros.core.machine.duties import DUTIES, Duty, DutyBlock
from fuzzycnc_ros.core.machine.mill_network import RPM

WHOLE_SHIFT = Duty(
    'shift',
    tuple(
        DutyBlock(rpm * RPM, 60.0 * minutes)
        for rpm, minutes in (
            (1000, 60),
            (0, 15),
            (1500, 75),
            (0, 30),
            (2000, 60),
            (500, 40),
            (1500, 80),
            (0, 120),
        )
    ),
    base=21.0,
    amplitude=2.0,
    phase_hours=6.0,
)
"""Eight hours from a cold machine: work, pauses, and two hours in which it cools down."""

MACHINE_DUTIES: Mapping[str, Duty] = MappingProxyType({**DUTIES, WHOLE_SHIFT.name: WHOLE_SHIFT})
"""All duties by name."""
