# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a machine may be moved, as its state says."""

from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import MachineState

_MOVING = (MachineMode.ON, MachineMode.RUNNING)


def motion_refusal(state: MachineState) -> str:
    """Say why a machine must not be moved; empty if it may."""
    if state.state not in _MOVING:
        modes = {int(mode): mode.name.lower() for mode in MachineMode}
        return f'the machine is not on but {modes.get(state.state, state.state)}'
    return '' if state.homed else 'the machine is not homed'
