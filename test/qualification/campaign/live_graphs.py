# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A supervised graph of a simulated machine that faults are put into."""

import os
import resource
import signal
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String

from campaign.evidence import MARKS, RECORDS
from campaign.relay import Relay, direct, durability, remappings
from campaign.scenario import Stage
from fuzzycnc_ros.bags.metadata import storage_files
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.cli.live.operator_client import parameter_request, refusals
from fuzzycnc_ros.cli.live.supervision import Supervisor
from fuzzycnc_ros.graph.bring_up import NodeSpec, RestartPolicy, node_specs
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.ros.topics import create_subscription, publisher_qos, subscription_qos
from fuzzycnc_ros.runtime.component import HISTORY
from fuzzycnc_ros.runtime.convert import decode
from fuzzycnc_ros.runtime.host import RecorderProgress
from fuzzycnc_ros.runtime.records import SECOND, Record

MACHINE = 'mill'
MAKES_TIME = 'simulated_machine'
WITNESS = 'witness'
PATIENCE = 60.0
"""Wall time [s] for what must happen on the graph; a loaded computer takes long to start nodes."""
MEETING = 0.8
"""Wall time [s] in which all readers have met a node that speaks to one of them."""
RECORDER_PATIENCE = 10.0
"""Wall time [s] that a recorder gets at the end."""
REPORTS = 2
"""Reports of its health after which a node has told of what was done before the first."""


class _Lifecycles:
    """All managed nodes are to be active again."""

    def begin(self, machine: str, node: str) -> None:
        """Forget nothing."""

    def heard_at(self, machine: str, node: str) -> float:
        """Return that nothing was heard: who stands still is not ended."""
        return 0.0

    def lifecycle(self, machine: str, node: str) -> str:
        """Return nothing."""
        return ''

    def was_active(self, machine: str, node: str) -> bool:
        """Return that none was taken out of its work by an operator."""
        return False


class LiveGraph(ABC):
    """The nodes of a stage under supervision, a witness, and the relay in its routes.

    Parameters
    ----------
    stage : Stage
        Nodes, speed of machine time and routes of the relay.
    folder : Path
        Where bags, logs and states go.
    """

    SPEAKS: ClassVar[Mapping[str, tuple[str, type[Any]]]]
    """Topic of a node that shows that it is at work again."""
    REJOINS: ClassVar[float]
    """Machine time [min] in which a node that shows nothing is at work again."""

    def __init__(self, stage: Stage, folder: Path) -> None:
        self.rate = stage.rate
        self.folder = folder
        self.destroyed = 0
        self.findings: list[str] = []
        self.heard: list[tuple[str, int, float]] = []
        """Topic, stamp [ns] and wall time [s] of what the witness has heard."""
        self.outages: list[tuple[str, float, float]] = []
        """Node that was dead, and from when to when [s of wall time] what it publishes, or all if
        it is the recorder, may be missing: readers meet a new life one after the other."""
        self._routes = stage.routes
        self._nodes = stage.nodes
        self._spoken: dict[str, int] = {}
        self._reports: Counter[str] = Counter()  # of the health of each node
        self._now = 0
        self._full_since = 0.0  # wall time from which on the disk refuses [s]; 0 if it does not
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node(WITNESS, namespace=f'/{MACHINE}', context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self.relay = Relay(self.node, stage.routes, stage.nodes)
        self._marks = self.node.create_publisher(String, MARKS, publisher_qos(HISTORY))
        for name, (topic, kind) in self.SPEAKS.items():
            self._listen(topic, kind, self._noting(name))
        self._listen('recorder/progress', RecorderProgress, self._noting('recorder'))
        self._listen_to_machine()
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._count_reports, 10)
        self.graph = GraphProcesses(MACHINE, folder=folder, remap=remappings(stage.routes))
        policy = RestartPolicy(delay=0.2, restarts_max=20)
        self.supervisor = Supervisor(lambda text: None, _Lifecycles(), policy)
        *others, machine = self._specs()
        for spec in others:
            self.supervisor.start(self.graph, [spec])
        # What the machine says first must reach everybody through the relay.
        self.until(self.relay.matched, 'all readers have met the relay')
        self.supervisor.start(self.graph, [machine])

    def __enter__(self) -> 'LiveGraph':
        """Return the graph."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """End all nodes, the recorder last."""
        for name in self.graph.names:
            if name not in self.graph.poll():
                os.kill(self.graph.pid(name), signal.SIGCONT)
        self.graph.stop(*(name for name in self.graph.names if name != 'recorder'))
        self.graph.stop('recorder')
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def let_record(self) -> None:
        """Let a busy recorder take what was said: a node that ends takes the rest along."""
        spoken, until = self._spoken.get('recorder', 0), time.monotonic() + RECORDER_PATIENCE
        while self._spoken.get('recorder', 0) < spoken + REPORTS and time.monotonic() < until:
            self._spin()

    @property
    def bags(self) -> list[Path]:
        """The bags that were recorded, in their order."""
        return sorted(self.folder.glob('bag*'), key=lambda path: (len(path.name), path.name))

    @property
    def ended(self) -> bool:
        """Whether the machine has come to the end of its duty."""
        return MAKES_TIME in self.graph.poll()

    def mark(self, text: str) -> None:
        """Write a mark into the recording."""
        self._marks.publish(String(data=text))
        self.wait(0.05)

    @abstractmethod
    def at_work(self) -> bool:
        """Whether the machine does what it is there for."""

    @abstractmethod
    def _listen_to_machine(self) -> None:
        """Hear what the machine says."""

    @abstractmethod
    def _note(self, topic: str, record: Any) -> None:
        """Note what a node has said."""

    @abstractmethod
    def _specs(self) -> list[NodeSpec]:
        """Return the nodes, the machine last."""

    @abstractmethod
    def _operate(self) -> None:
        """Do what an operator does so that the machine works again; nothing if it does."""

    def until(self, condition: Callable[[], bool], what: str) -> bool:
        """Wait until a condition holds; note it as a finding if it does not in time."""
        until = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > until or self.ended:
                self.findings.append(f'not within {PATIENCE:g} s of wall time: {what}')
                return False
            self._spin()
        return True

    def run(self, minutes: float) -> None:
        """Let machine time pass [min], and two reports of every node that lives."""
        since, told = self._now, self._reports.copy()

        def over() -> bool:
            dead = self.graph.poll()
            silent = (
                name
                for name in self.graph.names
                if name not in dead and self._reports[name] - told[name] < REPORTS
            )
            return self._now - since >= 60.0 * minutes * SECOND and not any(silent)

        self.until(over, f'{minutes:g} min of machine time, and reports of all nodes')

    def wait(self, duration: float) -> None:
        """Let wall time pass [s]."""
        until = time.monotonic() + duration
        while time.monotonic() < until:
            self._spin()

    def signal(self, node: str, number: int) -> None:
        """Send a signal to the process of a node."""
        os.kill(self.graph.pid(node), number)

    def await_restart(self, node: str) -> None:
        """Wait until a node that was killed is started again and speaks."""
        title = f'{MACHINE}/{node}'
        count = self.supervisor.restarts.get(title, 0)
        self.until(lambda: node in self.graph.poll(), f'{node} ends')
        down, self._full_since = self._full_since or time.monotonic(), 0.0
        if not self.until(
            lambda: self.supervisor.restarts.get(title, 0) > count, f'{node} is started again'
        ):
            return
        spoken = self._spoken.get(node, 0)
        if node in (*self.SPEAKS, 'recorder'):
            self.until(lambda: self._spoken.get(node, 0) > spoken + 1, f'{node} speaks again')
        else:
            self.run(self.REJOINS)
        self.wait(MEETING)
        self.outages.append((node, down, time.monotonic()))

    def fill_disk(self) -> None:
        """Let the recorder's file grow no further: every write beyond fails."""
        (file,) = storage_files(self.bags[-1])
        size = file.stat().st_size + 4096
        limit = (size, resource.RLIM_INFINITY)
        self._full_since = time.monotonic()
        resource.prlimit(self.graph.pid('recorder'), resource.RLIMIT_FSIZE, limit)

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> list[str]:
        """Set parameters of a node; return why they were refused, empty if taken."""
        client = self.node.create_client(SetParameters, f'{node}/set_parameters')
        try:
            self.until(client.service_is_ready, f'{node} has parameters')
            future = client.call_async(parameter_request(values))
            if not self.until(future.done, f'{node} answers'):
                return []
            return refusals(future.result())
        finally:
            self.node.destroy_client(client)

    def _stage_specs(self, machine: Mapping[str, Any], **given: Any) -> list[NodeSpec]:
        """Return the specifications of the stage's nodes, recorder and machine."""
        return node_specs(
            nodes=(*self._nodes, MAKES_TIME),
            record=self.folder / 'bag',
            autostart=True,
            machine_parameters={
                'rate': self.rate,
                'lockstep_nodes': [*self._nodes, WITNESS],  # the relay is there with the witness
                'start_timeout': PATIENCE / 2,
                **machine,
            },
            **given,
        )

    def _listen(self, topic: str, kind: type[Any], note: Callable[[str, Any], None]) -> None:
        """Hear a topic as its publisher says it, and hand it to `note`."""
        heard = direct(topic) if topic in self._routes else topic
        create_subscription(
            self.node,
            kind.TYPE,
            heard,
            lambda message: note(topic, decode(kind, message)),
            subscription_qos(durability(topic), lockstep=True),
        )

    def _noting(self, name: str) -> Callable[[str, Any], None]:
        def note(topic: str, record: Any) -> None:
            self._spoken[name] = self._spoken.get(name, 0) + 1
            self._note(topic, record)

        return note

    def _count_reports(self, message: DiagnosticArray) -> None:
        names = {status.name.partition(':')[0] for status in message.status}
        self._reports.update(name.removeprefix(f'{MACHINE}/') for name in names)

    def _hear(self, topic: str, record: Record) -> None:
        """Note a message; if a scenario is judged by its topic it must be in the recording."""
        if topic in RECORDS:
            self.heard.append((topic, record.stamp, time.monotonic()))

    def _spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.002 if self.relay.fault else 0.02)
        self.relay.send_due()
        self._operate()
        try:
            self.supervisor.poll(time.monotonic())
        except GraphError as error:
            if str(error) not in self.findings:
                self.findings.append(str(error))
