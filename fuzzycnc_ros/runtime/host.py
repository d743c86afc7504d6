# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Records of the hosts, beside those of their components.

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


FINALIZED = 'finalized'
"""State of a managed node after a shutdown, in which it can do nothing any more but end."""
WAS_FINALIZED = (
    'was shut down for good; end its process to activate it again: fuzzycnc up and the launch '
    'file start it anew, elsewhere start it yourself'
)
"""Message on a node in that state, after its name."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NodeConfiguration(Record):
    """Configuration that a node runs with."""

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
    """Progress of the recorder."""

    TYPE: ClassVar[str] = 'fuzzycnc_msgs/msg/RecorderProgress'

    received: int
    written: int
    lost: int
