# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Codes in the fields of records: one enumeration per group of constants of a message."""

from enum import IntEnum


class Status(IntEnum):
    """Verdict on one temperature reading, `Temperatures.STATUS_*`."""

    OK = 0
    MISSING = 1
    OUT_OF_RANGE = 2
    RATE = 3
    STUCK = 4
    DRIFT = 5


class ForgetMode(IntEnum):
    """Parts of the thermal error to forget, `ForgetThermalPosterior.MODE_*`."""

    WIDEN = 0
    UNDO = 1
    ALL = 2


class SpeedStatus(IntEnum):
    """Verdict on a reading of the spindle speed, `SpindleSpeed.STATUS_*`."""

    OK = 0
    MISSING = 1
    OUT_OF_RANGE = 2


class Coolant(IntEnum):
    """Coolant of a machine, `MachineState.COOLANT_*`."""

    UNKNOWN = 0
    OFF = 1
    ON = 2


class TouchKind(IntEnum):
    """Events in a probing cycle, `ProbeTouch.KIND_*`."""

    BEGIN = 0
    TOUCH = 1
    MISS = 2
    END = 3


class Reason(IntEnum):
    """Why a prediction is invalid, `ThermalError.REASON_*`."""

    NONE = 0
    NO_REFERENCE = 1
    NO_MODEL = 2
    SENSOR_LOST = 3
    STATE_LOST = 4
    GAP = 5


class CompensationState(IntEnum):
    """States of the compensator, `Compensation.STATE_*`."""

    INACTIVE = 0
    ACTIVE = 1
    HOLDING = 2
    RAMPING = 3
    EXPIRED = 4


class ServoStatus(IntEnum):
    """States of the position controllers, `ServoState.STATUS_*`."""

    INACTIVE = 0
    RESTING = 1
    MOVING = 2
    FOLLOWING = 3
    FAULT = 4


class TrialStatus(IntEnum):
    """Outcome of a trial of a controller, `ServoTrialState.STATUS_*`."""

    RUNNING = 0
    DONE = 1
    ENDED = 2
    REFUSED = 3


class SegmentKind(IntEnum):
    """Kind of a segment of a tool path, `ToolPath.KIND_*`."""

    LINE = 0
    ARC = 1
    NURBS = 2
    DWELL = 3


class Junction(IntEnum):
    """Transitions at the end of a segment of a tool path, `ToolPath.JUNCTION_*`."""

    CONTINUOUS = 0
    EXACT_STOP = 1


class PrimitiveKind(IntEnum):
    """Kind of a primitive of a pattern, `StitchPattern.KIND_*`."""

    LINE = 0
    ARC = 1
    JUMP = 2
    TRIM = 3
    STOP = 4


class MachineMode(IntEnum):
    """Operating state of the machine, `MachineState.STATE_*`."""

    OFF = 0
    ESTOP = 1
    ON = 2
    RUNNING = 3
    FAULT = 4
