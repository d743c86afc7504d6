# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Start nodes again that die or hang, ever later, and give up those that keep dying."""

import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses, node_title, process_name
from fuzzycnc_ros.graph.bring_up import NodeSpec, RestartPolicy, again, stop_timeout
from fuzzycnc_ros.ros.presence import TIME_SOURCES, GraphError
from fuzzycnc_ros.ros.processes import REFUSED

Tell = Callable[[str], None]

SILENT = 5.0
"""Wall time [s] without a word from a node, which reports every second."""
COMPUTES = 0.1
"""Share of a processor from which on a silent process is at work, as on a program of a million
lines; the middleware's own threads need less."""


class ProcessState(Enum):
    """States of a supervised process."""

    RUNNING = 'running'
    WAITING = 'waiting'
    GIVEN_UP = 'given up'
    ENDED = 'ended'


class Lifecycles(Protocol):
    """Health of nodes by their own report; managed ones report their lifecycle too."""

    def begin(self, machine: str, node: str) -> None:
        """Forget what an earlier life of a node has said."""

    def heard_at(self, machine: str, node: str) -> float:
        """Return the wall time of a node's newest report [s]; 0 before the first of its life."""

    def lifecycle(self, machine: str, node: str) -> str:
        """Return the lifecycle state that a node has told last; empty if none."""

    def was_active(self, machine: str, node: str) -> bool:
        """Return True if a node has been active in its present life."""


@dataclass
class Supervised:
    """One process with one node or several composed ones.

    Attributes
    ----------
    beside : bool
        Whether it only serves people, as the live page does: the run does not depend on it.
    resume : set of str
        Managed nodes that are to become active when the process is started again.
    ends : list of str
        Why it ended each time that nobody had asked it to.
    begun : list of float
        When it was started anew [s of wall time], as far back as that counts.
    restarts : int
        How often it was started anew, ever.
    worked : float or None
        Processor time that it had used when it fell silent [s]; None while it speaks.
    hung_at : float
        When it was asked to end because it said nothing any more [s of wall time]; 0 if it was
        not.
    """

    graph: GraphProcesses
    specs: tuple[NodeSpec, ...]
    resume: set[str]
    beside: bool = False
    state: ProcessState = ProcessState.RUNNING
    ends: list[str] = field(default_factory=list)
    begun: list[float] = field(default_factory=list)
    restarts: int = 0
    start_at: float = 0.0
    worked: float | None = None
    hung_at: float = 0.0
    reason: str = ''

    @property
    def name(self) -> str:
        """Name of the process."""
        return process_name(self.specs)

    @property
    def title(self) -> str:
        """Name for people."""
        return node_title(self.graph.machine, self.name)

    @property
    def makes_time(self) -> bool:
        """True if the run is over with this process."""
        return any(spec.name in TIME_SOURCES for spec in self.specs)


class Supervisor:
    """Watch the processes of some graphs.

    Parameters
    ----------
    tell : callable
        Told in words what happens.
    lifecycles : Lifecycles
        Source of what nodes say of themselves.
    policy : RestartPolicy, optional
        When nodes are started again.
    """

    def __init__(
        self, tell: Tell, lifecycles: Lifecycles, policy: RestartPolicy | None = None
    ) -> None:
        self._tell, self._lifecycles = tell, lifecycles
        self._policy = policy or RestartPolicy()
        self.processes: list[Supervised] = []
        self._polled_at = 0.0
        self._listens_since = 0.0  # wall time from which on silence is that of the others [s]

    def start(
        self, graph: GraphProcesses, specs: Sequence[NodeSpec], *, beside: bool = False
    ) -> Supervised:
        """Start a process and watch it from now on; one that is beside the run never ends it."""
        resume = {spec.name for spec in specs if spec.parameters.get('autostart')}
        process = Supervised(graph, tuple(specs), resume, beside)
        self.processes.append(process)
        self._run(process)
        return process

    @property
    def over(self) -> bool:
        """True if all that make time have come to their end, or nothing is left to watch."""
        own = [item for item in self.processes if not item.beside]
        makers = [item for item in own if item.makes_time] or own
        done = (ProcessState.ENDED, ProcessState.GIVEN_UP)
        return bool(makers) and all(item.state in done for item in makers)

    @property
    def given_up(self) -> list[str]:
        """Processes of the run that are not started any more."""
        own = (item for item in self.processes if not item.beside)
        return [item.title for item in own if item.state is ProcessState.GIVEN_UP]

    @property
    def restarts(self) -> dict[str, int]:
        """Number of restarts of each process; those without any are left out."""
        return {item.title: item.restarts for item in self.processes if item.restarts}

    def poll(self, now: float) -> None:
        """Look after all processes at wall time `now` [s].

        Raises
        ------
        GraphError
            If a node refuses its parameters at the start, or one that makes time has failed:
            neither can be mended by starting it again.
        """
        self._attend(now)
        for process in self.processes:
            if process.state is ProcessState.RUNNING:
                code = process.graph.poll().get(process.name)
                if code is not None:
                    self._ended(process, code, now)
                elif not process.makes_time:
                    self._end_if_it_hangs(process, now)
            elif process.state is ProcessState.WAITING and now >= process.start_at:
                process.restarts += 1
                process.begun.append(now)
                process.specs = tuple(
                    again(spec, process.restarts, resume=spec.name in process.resume)
                    for spec in process.specs
                )
                self._run(process)

    def _heard_at(self, process: Supervised) -> float:
        """Return the wall time of the newest report of a process [s]; 0 before the first."""
        machine = process.graph.machine
        return max(self._lifecycles.heard_at(machine, spec.name) for spec in process.specs)

    def _attend(self, now: float) -> None:
        """Note since when it would hear who speaks: not while it stood still or heard nobody."""
        newest = max(map(self._heard_at, self.processes), default=0.0)
        if now - min(self._polled_at, newest) > SILENT:
            self._listens_since = now
        self._polled_at = now

    def _end_if_it_hangs(self, process: Supervised, now: float) -> None:
        """End a process of which nothing is heard any more, so that it is started anew.

        Participants of the middleware give one another up in that time, and not all of them find
        each other again: who goes on after it may be deaf to some of the others for good.  One
        that computes has threads that keep it known.
        """
        heard = self._heard_at(process)
        silence = now - max(heard, self._listens_since)
        if not heard or silence <= SILENT:
            process.worked = None
            return
        if process.worked is None:
            process.worked = process.graph.worked(process.name)
        if silence <= self._policy.silence_max:
            return
        if process.hung_at:
            if now - process.hung_at > stop_timeout(spec.name for spec in process.specs):
                process.graph.signal(process.name, signal.SIGKILL)
        elif process.graph.worked(process.name) - process.worked < COMPUTES * silence:
            process.hung_at = now
            process.graph.signal(process.name, signal.SIGTERM)
            self._tell(f'{process.title} said nothing for {silence:.0f} s; it is ended')

    def _run(self, process: Supervised) -> None:
        for spec in process.specs:
            self._lifecycles.begin(process.graph.machine, spec.name)
        process.graph.start(*process.specs)
        process.state = ProcessState.RUNNING
        process.reason, process.worked, process.hung_at = '', None, 0.0
        self._tell(f'{process.title} runs as process {process.graph.pid(process.name)}')

    def _ended(self, process: Supervised, code: int, now: float) -> None:
        told = process.graph.last_words if code > 0 else process.graph.starved
        cause = 'was ended' if process.hung_at and not code else _cause(code)
        cause = f'fell silent and {cause}' if process.hung_at else cause
        process.reason = ': '.join(filter(None, (cause, told(process.name))))
        process.ends.append(process.reason)
        if process.makes_time:
            if code:
                raise GraphError(f'{process.title} {process.reason}')
            process.state = ProcessState.ENDED
            return
        if code == REFUSED and not process.restarts and not process.beside:
            raise GraphError(f'{process.title} {process.reason}')
        self._note_lifecycles(process)
        policy = self._policy
        process.begun = [time for time in process.begun if now - time < policy.window]
        delay = None if code == REFUSED else policy.delay_after(process.begun, now)
        if delay is None:
            process.state = ProcessState.GIVEN_UP
            after = f' after {len(process.begun)} restarts within {policy.window:g} s'
            self._tell(f'{process.title} {process.reason}; given up{after * (code != REFUSED)}')
            return
        process.state, process.start_at = ProcessState.WAITING, now + delay
        self._tell(f'{process.title} {process.reason}; starts again in {delay:g} s')

    def _note_lifecycles(self, process: Supervised) -> None:
        """Remember which managed nodes were active; one that never got so far still shall."""
        for spec in process.specs:
            if 'autostart' not in spec.parameters:
                continue
            key = (process.graph.machine, spec.name)
            active = self._lifecycles.lifecycle(*key) == 'active'
            if not active and self._lifecycles.was_active(*key):
                process.resume.discard(spec.name)


def _cause(code: int) -> str:
    if code < 0:
        try:
            return f'was killed by {signal.Signals(-code).name}'
        except ValueError:
            return f'was killed by signal {-code}'
    return f'ended with code {code}' if code else 'ended by itself'
