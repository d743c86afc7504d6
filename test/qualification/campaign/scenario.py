# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a scenario of the fault campaign is, and when the machine has to be safe again."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from math import log
from typing import Any, Protocol

from campaign.relay import Relay
from fuzzycnc_ros.components.machine.simulated_machine_config import SimulatedMachineConfig
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.servo.servo_controller_config import ServoControllerConfig
from fuzzycnc_ros.components.thermal.compensator import CompensatorConfig
from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.graph.bring_up import THERMAL

LIMITS, MACHINE = CompensatorConfig(), SimulatedMachineConfig()
SCHEDULER, SERVO = FeedrateSchedulerConfig(), ServoControllerConfig()
_TICKS = 2.0 * MACHINE.tick_period

RESTING = 2e-3
"""Speed below which an axis rests [m/s]."""

BY_MACHINE = LIMITS.validity + MACHINE.offset_max / MACHINE.slew_max + _TICKS
"""Machine time [s] in which the machine side is at zero by itself: the last command expires, and
the largest offset ramps away at its own slew limit."""
BY_COMPENSATOR = (
    LIMITS.hold_time
    + LIMITS.stale_after
    + LIMITS.offset_max / LIMITS.ramp_rate
    + 2.0 * LIMITS.period
    + _TICKS
)
"""Machine time [s] in which the compensator is at zero: it notices, holds, and ramps the largest
offset away."""

_BRAKING = SCHEDULER.path_velocity / SCHEDULER.path_acceleration
BY_PATH = SCHEDULER.lead + _BRAKING + SCHEDULER.settle + 2.0 * SCHEDULER.period
"""Machine time [s] in which axes rest that get no more parts of a trajectory, from when the next
one was to be sent: what they have been given is over, they brake on the path, and arrive."""
AXIS: LinearAxis = LatheAxisConfig(period=SERVO.period).linear()
"""Nominal model of the driven axes."""
_COASTING = AXIS.lag * log(AXIS.gain / RESTING)
BY_DRIVE = SERVO.command_validity + SERVO.silence_max + _COASTING + 10.0 * SERVO.period
"""Machine time [s] in which a driven axis rests that nobody answers for: what is wrong is found,
the last command runs out of date, and the axis coasts from full speed to rest."""


SPEED_MAX = MACHINE.axis_velocity_max
"""Largest speed of an axis whose drives get no false duties [m/s]: what the machine allows."""


class Kind(Enum):
    """What the machine of a stage does, and so what is safe."""

    OFFSETS = 'offsets'
    """It warms up and is compensated."""
    PATH = 'path'
    """It follows tool paths with axes of its own."""
    DRIVE = 'drive'
    """Its axes are driven from outside."""
    PATTERN = 'pattern'
    """It stitches soft sheets."""


class Ends(Enum):
    """What the machine must do at the end of a scenario."""

    FOLLOWS = 'follows'
    """Compensation is at work again."""
    ZERO = 'zero'
    """No offset is in force."""
    EITHER = 'either'


class Live(Protocol):
    """A running graph that faults are put into.

    It has an operator too, who sends paths, moves and patterns anew when nothing moves any more.

    Attributes
    ----------
    rate : float
        Speed of machine time.
    relay : Relay
        Stands in the routes that the stage names.
    destroyed : int
        Messages that the scenario has destroyed on purpose.
    findings : list of str
        What went wrong and cannot be seen in a bag; one makes the scenario unsafe.
    """

    rate: float
    relay: Relay
    destroyed: int
    findings: list[str]

    def at_work(self) -> bool:
        """Whether the machine does what it is there for."""

    def until(self, condition: Callable[[], bool], what: str) -> bool:
        """Wait until a condition holds; note it as a finding if it does not in time."""

    def run(self, minutes: float) -> None:
        """Let machine time pass [min], and two reports of every node."""

    def wait(self, duration: float) -> None:
        """Let wall time pass [s]."""

    def signal(self, node: str, number: int) -> None:
        """Send a signal to the process of a node."""

    def await_restart(self, node: str) -> None:
        """Wait until a node that was killed is started again and speaks."""


class MovingLive(Live, Protocol):
    """A graph whose axes move."""

    def begin_anew(self) -> None:
        """Have what leads the axes begin something else at once."""


class ThermalLive(Live, Protocol):
    """A graph of thermal compensation."""

    def at_zero(self) -> bool:
        """Whether no offset is in force."""

    def restart_machine(self) -> None:
        """Kill the simulated machine and start it anew."""

    def fill_disk(self) -> None:
        """Let the recorder's file grow no further: every write beyond fails."""

    def refused_everywhere(self) -> None:
        """Set each live parameter of each node out of its range; all must be refused."""

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> list[str]:
        """Set parameters of a node; return why they were refused, empty if taken."""

    def damage_model(self) -> str:
        """Cut the model file at a random byte; return its name."""

    def stranger(self, topic: str, names: tuple[str, ...]) -> 'Strangers':
        """Return nodes that publish a topic which is not theirs."""

    def second_compensator(self) -> Callable[[], None]:
        """Start another compensator of the machine; return what ends it."""


class Strangers(Protocol):
    """Nodes that publish what they should not."""

    def heard(self) -> bool:
        """Whether somebody would hear them."""

    def order(self) -> None:
        """Send commands of the highest rank."""

    def leave(self) -> None:
        """Leave the graph."""


@dataclass(frozen=True)
class Scenario:
    """One fault.

    Attributes
    ----------
    name : str
        Name in tables and for `--only`.
    what : str
        What is done, in a few words.
    act : callable
        Does it to a live graph of its stage's kind, and undoes it where that is possible.
    stated : float
        Machine time [s] that the machine may be out of a safe state.
    ends : Ends
        What the machine must do at the end.
    says : str
        What diagnostics must tell, a regular expression over `item: text`; empty for nothing.
    loses : bool
        Whether the scenario destroys a part of the recording, but for the last second before.
    cuts : bool
        Whether the finished bag is damaged afterwards.
    found : bool
        Whether what is false can be told from what is right, so that it may drive nothing for
        longer than `stated`.
    speed_max : float
        Largest speed of a driven axis [m/s].
    """

    name: str
    what: str
    act: Callable[[Any], None]
    stated: float
    ends: Ends = Ends.FOLLOWS
    says: str = ''
    loses: bool = False
    cuts: bool = False
    found: bool = True
    speed_max: float = SPEED_MAX


@dataclass(frozen=True)
class Stage:
    """Scenarios that share a graph, one after the other.

    Attributes
    ----------
    name : str
        Name of its folder.
    rate : float
        Speed of machine time; 1 is real time.
    routes : mapping of str to str
        Topics into which the relay is put, each with the node that publishes it.
    scenarios : tuple of Scenario
        In the order in which they are run.
    kind : Kind
        What the machine does.
    nodes : tuple of str
        Nodes of the graph beside machine and recorder.
    """

    name: str
    rate: float
    scenarios: tuple[Scenario, ...]
    routes: Mapping[str, str]
    kind: Kind = Kind.OFFSETS
    nodes: tuple[str, ...] = THERMAL
