# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What hosts say beside the records of their components: turns, provenance, progress.

The conventions are those of `fuzzycnc_ros.runtime.records`.
"""

from dataclasses import dataclass
from typing import ClassVar

from fuzzycnc_ros.runtime.records import Counts, Names, Offsets, Record, Stamp


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
