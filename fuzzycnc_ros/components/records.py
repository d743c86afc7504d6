# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What components take and give: one frozen record per message of `fuzzycnc_msgs`.

Field names, order and meaning are those of the `.msg` files, where units and conventions are
written down; `header` is spread into `stamp` and `frame_id`.  Stamps are whole nanoseconds of
machine time.  `fuzzycnc_ros.convert` turns records into messages and back, and a contract test
holds both sides together.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

Stamp: TypeAlias = Annotated[int, 'time']
"""Machine time [ns]."""
Floats: TypeAlias = NDArray[np.float64]
Bytes: TypeAlias = NDArray[np.uint8]
Bools: TypeAlias = NDArray[np.bool_]
Counts: TypeAlias = Annotated[NDArray[np.uint64], 'uint64']
Offsets: TypeAlias = Annotated[NDArray[np.uint32], 'uint32']
Blocks: TypeAlias = Annotated[NDArray[np.int64], 'int64']
Names: TypeAlias = tuple[str, ...]

SECOND = 1_000_000_000
"""One second [ns]."""


def nanoseconds(duration: float) -> int:
    """Return a duration [s] in whole nanoseconds."""
    return round(duration * SECOND)


class Status(IntEnum):
    """Verdict on one temperature reading, `Temperatures.STATUS_*`."""

    OK = 0
    MISSING = 1
    OUT_OF_RANGE = 2
    RATE = 3
    STUCK = 4
    DRIFT = 5


class Reason(IntEnum):
    """Why a prediction is invalid, `ThermalError.REASON_*`."""

    NONE = 0
    NO_REFERENCE = 1
    NO_MODEL = 2
    SENSOR_LOST = 3
    STATE_LOST = 4
    GAP = 5


class CompensationState(IntEnum):
    """What the compensator is doing, `Compensation.STATE_*`."""

    INACTIVE = 0
    ACTIVE = 1
    HOLDING = 2
    RAMPING = 3
    EXPIRED = 4


class AppliedStatus(IntEnum):
    """What the machine side does, `CompensationApplied.STATUS_*`."""

    IDLE = 0
    FOLLOWING = 1
    EXPIRED = 2
    REFUSED = 3


class TrajectoryStatus(IntEnum):
    """What the machine side makes of its trajectory, `TrajectoryState.STATUS_*`."""

    IDLE = 0
    FOLLOWING = 1
    FINISHED = 2
    STARVED = 3
    REFUSED = 4


class ServoStatus(IntEnum):
    """What the position controllers do, `ServoState.STATUS_*`."""

    INACTIVE = 0
    RESTING = 1
    MOVING = 2
    FOLLOWING = 3
    FAULT = 4


class SegmentKind(IntEnum):
    """Kind of a segment of a tool path, `ToolPath.KIND_*`."""

    LINE = 0
    ARC = 1
    NURBS = 2
    DWELL = 3


class Junction(IntEnum):
    """What happens at the end of a segment of a tool path, `ToolPath.JUNCTION_*`."""

    CONTINUOUS = 0
    EXACT_STOP = 1


class MachineMode(IntEnum):
    """Operating state of the machine, `MachineState.STATE_*`."""

    OFF = 0
    ESTOP = 1
    ON = 2
    RUNNING = 3
    FAULT = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """Base of all records that travel on a topic."""

    TYPE: ClassVar[str]
    """Name of the message type."""

    stamp: Stamp
    frame_id: str = ''


@dataclass(frozen=True, kw_only=True, eq=False)
class Temperatures(Record):
    """One sample of all temperature sensors."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/Temperatures'

    sensor: Names
    temperature: Floats
    status: Bytes
    readings: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorCluster:
    """One group of sensors that warm up alike."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/SensorCluster'

    member: Names
    score: Floats
    chosen: str
    substitute: Names
    gain: Floats
    correlation: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorSelection(Record):
    """Which few sensors represent a machine's temperature field."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/SensorSelection'

    method: str
    cluster: tuple[SensorCluster, ...]
    partition_coefficient: float
    xie_beni: float
    dropped: Names
    calibration: Names


@dataclass(frozen=True, kw_only=True, eq=False)
class ThermalReference(Record):
    """The temperatures against which rises are meant."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ThermalReference'

    cold_since: Stamp
    set_by: str
    sensor: Names
    temperature: Floats
    samples: int


@dataclass(frozen=True, kw_only=True, eq=False)
class ThermalError(Record):
    """Predicted thermal error."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ThermalError'

    axis: Names
    channel: Names
    error: Floats
    standard_deviation: Floats
    valid: bool
    reason: int
    in_domain: bool
    model: str
    substituted: Names
    substitute: Names


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictorState(Record):
    """Checkpoint of the thermal predictor."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/PredictorState'

    model_hash: str
    reference_stamp: Stamp
    input: Names
    last_rise: Floats
    state: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Displacement(Record):
    """Measured displacement of the tool since the thermal reference."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/Displacement'

    axis: Names
    channel: Names
    displacement: Floats
    standard_deviation: Floats
    includes_compensation: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Compensation(Record):
    """Offsets that the machine shall add to its commanded positions."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/Compensation'

    epoch: int
    state: int
    axis: Names
    offset: Floats
    slope: Floats
    reference_position: Floats
    at_limit: Bools
    slewing: Bools
    valid_until: Stamp
    source: Names


@dataclass(frozen=True, kw_only=True, eq=False)
class CompensationApplied(Record):
    """What the machine side really applies."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/CompensationApplied'

    epoch: int
    status: int
    reason: str
    axis: Names
    offset: Floats
    at_limit: Bools


@dataclass(frozen=True, kw_only=True, eq=False)
class MachineState(Record):
    """State of the machine as its controller reports it."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/MachineState'

    state: int
    homed: bool
    offsets_allowed: bool
    cold_since: Stamp
    spindle_speed: float
    axis: Names
    position: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolPath(Record):
    """A path of the tool relative to the workpiece."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ToolPath'

    path_id: str
    includes_compensation: bool
    axis: Names
    start: Floats
    kind: Bytes
    junction: Bytes
    block: Blocks
    feedrate: Floats
    offset: Offsets
    data: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class FeedSchedule(Record):
    """Feed along the stretch of a tool path that one part of the trajectory covers."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/FeedSchedule'

    path_id: str
    part: int
    last: bool
    method: str
    tolerance: float
    feed_override: float
    arc_length: Floats
    curvature: Floats
    feed: Floats
    speed: Floats
    block: Blocks


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory(Record):
    """Motion of the axes over the next stretch of time, with a way to rest at its end."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/Trajectory'

    path_id: str
    epoch: int
    part: int
    last: bool
    start: Stamp
    period: float
    committed: int
    axis: Names
    position: Floats
    velocity: Floats
    arc_length: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectoryState(Record):
    """What the machine side makes of the trajectory that it was given."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/TrajectoryState'

    path_id: str
    epoch: int
    part: int
    status: int
    reason: str
    arc_length: float


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisState(Record):
    """Where the axes of a machine are and where they are told to be."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/AxisState'

    axis: Names
    reference: Floats
    position: Floats
    velocity: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisCommand(Record):
    """What the drives of the axes shall do until the next command."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/AxisCommand'

    epoch: int
    axis: Names
    duty: Floats
    valid_until: Stamp


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionCommand(Record):
    """Where axes shall go, each from where it is and to rest there."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/PositionCommand'

    axis: Names
    position: Floats
    velocity: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class ServoState(Record):
    """What the position controllers of the axes do."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ServoState'

    epoch: int
    status: int
    reason: str
    axis: Names
    reference: Floats
    error: Floats
    disturbance: Floats
    saturated: Bools
    missed: int


@dataclass(frozen=True, kw_only=True, eq=False)
class ContourError(Record):
    """Distance of the tool from its path over a stretch of time."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ContourError'

    path_id: str
    period: float
    arc_length: Floats
    error: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class MachineTick(Record):
    """Lock-step: one node's turn."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/MachineTick'

    tick: int
    node: str
    probe: bool
    probe_number: int = 0
    topic: Names
    published: Counts
    readers: Offsets


@dataclass(frozen=True, kw_only=True, eq=False)
class TickAnswer(Record):
    """Lock-step: a node has done its work."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/TickAnswer'

    tick: int
    node: str
    probe: bool
    probe_number: int = 0
    missed: bool
    topic: Names
    published: Counts
    reads: Names
    next_deadline: Stamp


@dataclass(frozen=True, kw_only=True, eq=False)
class DeadlineFired(Record):
    """Real time: a node acted because nothing arrived."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/DeadlineFired'

    node: str


@dataclass(frozen=True, kw_only=True, eq=False)
class NodeConfiguration(Record):
    """What a node runs with."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/NodeConfiguration'

    node: str
    version: str
    message_set: int
    lifecycle_state: str
    parameters: str
    model: str
    model_hash: str


@dataclass(frozen=True, kw_only=True, eq=False)
class NodeEvent(Record):
    """A service, action or transition changed a node's state."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/NodeEvent'

    node: str
    name: str
    request: str


@dataclass(frozen=True, kw_only=True, eq=False)
class RecorderProgress(Record):
    """How far the recorder has come."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/RecorderProgress'

    received: int
    written: int
    lost: int


AnyRecord: TypeAlias = Any
"""A record of any type; each input and output declares its own."""
