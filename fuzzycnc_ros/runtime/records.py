# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs and outputs of components: one frozen record per message of `fuzzycnc_msgs`.

Field names, order and meaning are those of the `.msg` files, where units and conventions are
written down; `header` is spread into `stamp` and `frame_id`.  Stamps are whole nanoseconds of
machine time.  `runtime/convert.py` turns records into messages and back, and a contract test holds
both sides together.
"""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.runtime.enums import CompensationState

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


def _fill(record: 'Record', *names: str, value: float = np.nan) -> None:
    """Let arrays that a record leaves out hold one value for each of its axes."""
    for name in names:
        if not len(getattr(record, name)):
            object.__setattr__(record, name, np.full(len(record.axis), value))  # type: ignore[attr-defined]


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """Base of all records that travel on a topic."""

    TYPE: ClassVar[str]
    """Name of the message type."""

    stamp: Stamp
    frame_id: str = ''

    @property
    def final(self) -> bool:
        """True if its sender owes no further record: silence after it is no fault."""
        return False


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
    slope: Floats = field(default_factory=lambda: np.zeros(0))
    slope_deviation: Floats = field(default_factory=lambda: np.zeros(0))
    reference_position: Floats = field(default_factory=lambda: np.zeros(0))
    line_deviation: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Take what is left out as unknown, in messages too."""
        _fill(self, 'slope', 'slope_deviation', 'reference_position', 'line_deviation')


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
class ThermalPosterior(Record):
    """Posterior of the weights of the thermal error, learnt from probes."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ThermalPosterior'

    model_hash: str
    reference_stamp: Stamp
    interval: float
    input: Names
    axis: Names
    channel: Names
    probes: Counts
    evidence: Floats
    memory: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeEvidence(Record):
    """Evidence that probes see an offset as it is."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ProbeEvidence'

    axis: Names
    channel: Names
    evidence: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Displacement(Record):
    """Measured displacement of the tool since the thermal reference."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/Displacement'

    axis: Names
    channel: Names
    displacement: Floats
    standard_deviation: Floats
    includes_compensation: bool
    position: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Take a position that is left out as an unknown one, in messages too."""
        _fill(self, 'position')


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeTouch(Record):
    """Touch of a probing cycle, or its begin or end."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ProbeTouch'

    kind: int
    number: int
    position: float
    includes_offset: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeStatus(Record):
    """Knowledge of the thermal error from probes."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ProbeStatus'

    due: bool
    reason: str
    due_at: Stamp
    probed_at: Stamp
    axis: Names
    channel: Names
    band: Floats
    change: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeCycleState(Record):
    """State of the probing cycle."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ProbeCycleState'

    due: bool
    reason: str
    outcome: str
    accepted: bool
    failures: int
    signature: int
    reference_stamp: Stamp
    zero: Floats
    size: Floats
    noise: Floats


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

    @property
    def final(self) -> bool:
        """True once its owner has taken its offsets back, or rests without one."""
        at_rest = self.state in (CompensationState.INACTIVE, CompensationState.EXPIRED)
        return at_rest and not (self.offset.any() or self.slope.any())


@dataclass(frozen=True, kw_only=True, eq=False)
class CompensationApplied(Record):
    """Offsets in force at the machine side."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/CompensationApplied'

    epoch: int
    status: int
    reason: str
    axis: Names
    offset: Floats
    at_limit: Bools
    slope: Floats = field(default_factory=lambda: np.zeros(0))
    position: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Take a slope that is left out as none, a position as unknown, in messages too."""
        _fill(self, 'slope', value=0.0)
        _fill(self, 'position')

    def offset_at(self, axis: str, place: float) -> float:
        """Return the offset of an axis at a place [m]; one that takes no offsets has none.

        Where either place is unknown it is the one at which the axis was.
        """
        if axis not in self.axis:
            return 0.0
        number = self.axis.index(axis)
        way = place - float(self.position[number])
        along = float(self.slope[number]) * way if np.isfinite(way) else 0.0
        return float(self.offset[number]) + along


MOTION_FIELDS = ('travel', 'square_speed', 'travel_moment', 'travel_second_moment')
"""Fields of `machine_state` that add up the motion of each axis."""


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
    coolant: int = 0
    spindle_load: float = np.nan
    travel: Floats = field(default_factory=lambda: np.zeros(0))
    square_speed: Floats = field(default_factory=lambda: np.zeros(0))
    travel_moment: Floats = field(default_factory=lambda: np.zeros(0))
    travel_second_moment: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Take what is left out as unknown, in messages too."""
        _fill(self, *MOTION_FIELDS)


@dataclass(frozen=True, kw_only=True, eq=False)
class SpindleSpeed(Record):
    """Spindle speed from a source of its own."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/SpindleSpeed'

    speed: float
    status: int


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
class Material(Record):
    """A sheet of soft material as it lies clamped in the machine."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/Material'

    name: str
    thickness: float
    size: Floats
    young_modulus: float = np.nan
    poisson_ratio: float = np.nan


@dataclass(frozen=True, kw_only=True, eq=False)
class StitchPattern(Record):
    """A pattern to be stitched."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/StitchPattern'

    path_id: str
    start: Floats
    kind: Bytes
    end: Floats
    centre: Floats
    turn: Floats
    depth: Floats
    step: Floats
    feedrate: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class CompensatedPath(Record):
    """The stitches of a pattern and the offsets that were added to them."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/CompensatedPath'

    path_id: str
    material: str
    thickness: float
    model: str
    nominal: Floats
    offset: Floats
    primitive: Offsets
    kind: Bytes
    turn: Floats
    depth: Floats
    step: Floats
    compensation: Floats
    support: Floats
    flag: Bytes


@dataclass(frozen=True, kw_only=True, eq=False)
class StitchedPath(Record):
    """Positions of a pattern's stitches once the sheet has relaxed."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/StitchedPath'

    path_id: str
    time: Floats
    tool: Floats
    stitched: Floats


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

    @property
    def final(self) -> bool:
        """True for the part that ends the path."""
        return self.last


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectoryState(Record):
    """Trajectory state of the machine side."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/TrajectoryState'

    path_id: str
    epoch: int
    part: int
    status: int
    reason: str
    arc_length: float


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisState(Record):
    """Actual and commanded positions of the axes of a machine."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/AxisState'

    axis: Names
    reference: Floats
    position: Floats
    velocity: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisCommand(Record):
    """Command to the drives of the axes, valid until the next one."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/AxisCommand'

    epoch: int
    axis: Names
    duty: Floats
    valid_until: Stamp


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionCommand(Record):
    """Target positions of axes, each approached from its present place and held there."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/PositionCommand'

    axis: Names
    position: Floats
    velocity: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class ServoState(Record):
    """State of the position controllers of the axes."""

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
class ServoTrial(Record):
    """A controller that an operator tries on an axis."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ServoTrial'

    axis_name: str
    trial: int
    machine_file: str
    controller: str
    setting: Names
    value: Floats
    gain: float
    way: float
    pace: float
    error_max: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ServoTrialState(Record):
    """Outcome of a trial of a controller on an axis."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ServoTrialState'

    axis_name: str
    trial: int
    status: int
    reason: str
    rms: float
    largest: float
    rest: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ContourError(Record):
    """Distance of the tool from its path over a stretch of time."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/ContourError'

    path_id: str
    period: float
    arc_length: Floats
    error: Floats
