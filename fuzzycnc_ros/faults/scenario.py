# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a scenario of the fault campaign is, and when the machine has to be safe again."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

from fuzzycnc_ros.components.compensator import CompensatorConfig
from fuzzycnc_ros.components.simulated_machine_config import SimulatedMachineConfig
from fuzzycnc_ros.faults.relay import Relay

LIMITS, MACHINE = CompensatorConfig(), SimulatedMachineConfig()
_TICKS = 2.0 * MACHINE.tick_period

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


class Ends(Enum):
    """What the machine must do at the end of a scenario."""

    FOLLOWS = 'follows'
    """Compensation is at work again."""
    ZERO = 'zero'
    """No offset is in force."""
    EITHER = 'either'


class Live(Protocol):
    """A running graph that faults are put into.

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
        """Whether the machine follows a compensator that moves it."""

    def at_zero(self) -> bool:
        """Whether no offset is in force."""

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
        Does it to a live graph, and undoes it where that is possible.
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
    """

    name: str
    what: str
    act: Callable[[Live], None]
    stated: float
    ends: Ends = Ends.FOLLOWS
    says: str = ''
    loses: bool = False
    cuts: bool = False


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
    """

    name: str
    rate: float
    scenarios: tuple[Scenario, ...]
    routes: Mapping[str, str]
