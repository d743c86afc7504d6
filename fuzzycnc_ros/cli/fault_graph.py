# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A supervised graph of thermal compensation that faults are put into."""

import os
import random
import resource
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_msgs.msg import String

from fuzzycnc_ros.bags.files import storage_files
from fuzzycnc_ros.cli.graph_processes import GraphError, GraphProcesses, NodeSpec
from fuzzycnc_ros.cli.supervision import RestartPolicy, Supervisor
from fuzzycnc_ros.cli.up import node_specs
from fuzzycnc_ros.components.codes import AppliedStatus, CompensationState
from fuzzycnc_ros.components.component import HISTORY, STREAM
from fuzzycnc_ros.components.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    MachineState,
    Record,
    RecorderProgress,
    Temperatures,
    ThermalError,
)
from fuzzycnc_ros.components.registry import COMPONENTS
from fuzzycnc_ros.convert import decode
from fuzzycnc_ros.faults.evidence import MARKS
from fuzzycnc_ros.faults.relay import THERMAL, Relay, direct, remappings
from fuzzycnc_ros.faults.scenario import Stage
from fuzzycnc_ros.faults.strangers import STRANGE_EPOCH, Strangers, highest_order
from fuzzycnc_ros.nodes.qos import create_subscription, publisher_qos, subscription_qos

MACHINE = 'mill'
MAKES_TIME = 'simulated_machine'
WITNESS = 'witness'
DUTY = 'T2'
AT_WORK = 2e-6
"""Offset from which on compensation is at work [m]."""
LASTING = 10
"""Ticks in a row in which it has to be at work: after a jump of clocks it comes and goes."""
PATIENCE = 60.0
"""Wall time [s] for what must happen on the graph; a loaded computer takes long to start nodes."""
MEETING = 0.8
"""Wall time [s] in which all readers have met a node that speaks to one of them."""
REPORTS = 1.2
"""Wall time [s] in which every node has reported its health once."""
SPEAKS = {
    'temperature_acquisition': ('temperatures', Temperatures),
    'thermal_predictor': ('thermal_error', ThermalError),
    'compensator': ('compensation', Compensation),
    'recorder': ('recorder/progress', RecorderProgress),
}
"""What shows that a node is at work again."""


class _Lifecycles:
    """All managed nodes are to be active again."""

    def begin(self, machine: str, node: str) -> None:
        """Forget nothing."""

    def lifecycle(self, machine: str, node: str) -> str:
        """Return nothing."""
        return ''

    def was_active(self, machine: str, node: str) -> bool:
        """Return that none was taken out of its work by an operator."""
        return False


class LiveGraph:
    """The nodes of a stage under supervision, a witness, and the relay in its routes.

    Parameters
    ----------
    stage : Stage
        Speed of machine time and routes of the relay.
    model : Path
        Model of the predictor; it is copied, as scenarios damage it.
    folder : Path
        Where bags, logs and states go.
    seed : int
        Of what is random.
    """

    def __init__(self, stage: Stage, model: Path, folder: Path, seed: int) -> None:
        self.rate = stage.rate
        self.folder = folder
        self.destroyed = 0
        self.findings: list[str] = []
        self.heard: list[tuple[str, int, float]] = []
        """Topic, stamp [ns] and wall time [s] of what the witness has heard."""
        self.outages: list[tuple[str, float, float]] = []
        """Node that was dead, and from when to when [s of wall time] what it publishes, or all if
        it is the recorder, may be missing: readers meet a new life one after the other."""
        self._random = random.Random(seed)
        self._model = folder / 'model.json'
        self._model.write_bytes(model.read_bytes())
        self._applied: CompensationApplied | None = None
        self._told: Compensation | None = None
        self._error: ThermalError | None = None
        self._spoken: dict[str, int] = {}
        self._now = self._working = 0
        self._full_since = 0.0  # wall time from which on the disk refuses [s]; 0 if it does not
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node(WITNESS, namespace=f'/{MACHINE}', context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self.relay = Relay(self.node, stage.routes)
        self._marks = self.node.create_publisher(String, MARKS, publisher_qos(HISTORY))
        self._listen(stage)
        self.graph = GraphProcesses(MACHINE, folder=folder, remap=remappings(stage.routes))
        policy = RestartPolicy(delay=0.2, restarts_max=20)
        self.supervisor = Supervisor(lambda text: None, _Lifecycles(), policy)
        *others, machine = self._specs()
        for spec in others:
            self.supervisor.start(self.graph, [spec])
        # What the machine says first, cold, must reach everybody through the relay.
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

    def at_work(self) -> bool:
        """Whether the machine has followed a compensator that moves it for some ticks."""
        return self._working >= LASTING

    def _works(self) -> bool:
        return (
            self._applied is not None
            and self._told is not None
            and self._error is not None
            and self._applied.status == AppliedStatus.FOLLOWING
            and self._told.state == CompensationState.ACTIVE
            and self._error.valid
            and bool(np.abs(self._applied.offset).max() > AT_WORK)
        )

    def at_zero(self) -> bool:
        """Whether no offset is in force."""
        return self._applied is not None and not self._applied.offset.any()

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
        """Let machine time pass [min], and two reports of every node."""
        since, wall = self._now, time.monotonic()
        self.until(
            lambda: (
                self._now - since >= 60.0 * minutes * SECOND and time.monotonic() - wall >= REPORTS
            ),
            f'{minutes:g} min of machine time',
        )

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
        if node in SPEAKS:
            self.until(lambda: self._spoken.get(node, 0) > spoken + 1, f'{node} speaks again')
        else:
            self.run(5.0)
        self.wait(MEETING)
        self.outages.append((node, down, time.monotonic()))

    def restart_machine(self) -> None:
        """Kill the simulated machine and start it anew."""
        self.signal(MAKES_TIME, signal.SIGKILL)
        while MAKES_TIME not in self.graph.poll():
            time.sleep(0.01)
        self.graph.start(next(spec for spec in self._specs() if spec.name == MAKES_TIME))
        self._now = 0
        self.until(lambda: self._now > 0, 'the machine ticks again')

    def fill_disk(self) -> None:
        """Let the recorder's file grow no further: every write beyond fails."""
        (file,) = storage_files(self.bags[-1])
        size = file.stat().st_size + 4096
        limit = (size, resource.RLIM_INFINITY)
        self._full_since = time.monotonic()
        resource.prlimit(self.graph.pid('recorder'), resource.RLIMIT_FSIZE, limit)

    def refused_everywhere(self) -> None:
        """Set each live parameter of each node out of its range; all must be refused."""
        for name in (*SPEAKS, 'sensor_selector'):
            if name == 'recorder':
                continue
            for item in fields(COMPONENTS[name].CONFIG):
                if not item.metadata['live'] or item.metadata['high'] is None:
                    continue
                high = item.metadata['high']
                wrong: list[Any] = [type(high)(2 * high + 1), 'many']
                if isinstance(item.default, float):
                    wrong = [2.0 * high + 1.0, -2.0 * abs(high) - 1.0, float('nan'), 'many']
                for value in wrong:
                    if not self.set_parameters(name, {item.name: value}):
                        self.findings.append(f'{name} takes {item.name} = {value}')

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> list[str]:
        """Set parameters of a node; return why they were refused, empty if taken."""
        client = self.node.create_client(SetParameters, f'{node}/set_parameters')
        try:
            self.until(client.service_is_ready, f'{node} has parameters')
            given = [
                Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
            ]
            future = client.call_async(SetParameters.Request(parameters=given))
            if not self.until(future.done, f'{node} answers'):
                return []
            results = future.result().results
            return [item.reason or 'refused' for item in results if not item.successful]
        finally:
            self.node.destroy_client(client)

    def damage_model(self) -> str:
        """Cut the model file at a random byte; return its name."""
        size = self._model.stat().st_size
        with self._model.open('r+b') as file:
            file.truncate(self._random.randrange(1, size - 1))
        return str(self._model)

    def stranger(self, topic: str, names: tuple[str, ...]) -> Strangers:
        """Return nodes that publish a topic which is not theirs."""

        def order() -> Record:
            return highest_order(topic, self._now + SECOND, self._told)

        return Strangers(self.context, f'/{MACHINE}', topic, names, order)

    def second_compensator(self) -> Callable[[], None]:
        """Start another compensator of the machine; return what ends it."""
        folder = self.folder / 'second'
        folder.mkdir(exist_ok=True)
        params = folder / 'second.yaml'
        params.write_text('/**: {ros__parameters: {autostart: true, use_sim_time: true}}\n')
        second = GraphProcesses(
            MACHINE, folder=folder, params=[params], remap=['__node:=compensator_2']
        )
        second.start(NodeSpec('compensator'))
        return second.stop

    def _specs(self) -> list[NodeSpec]:
        return node_specs(
            duties=(DUTY,),
            model=self._model,
            record=self.folder / 'bag',
            autostart=True,
            state_directory=self.folder / 'state',
            machine_parameters={
                'rate': self.rate,
                'lockstep_nodes': [*THERMAL, WITNESS],  # the relay is there with the witness
                'start_timeout': PATIENCE / 2,
            },
        )

    def _listen(self, stage: Stage) -> None:
        def hear(name: str, topic: str, kind: Any, note: Callable[[Any], None]) -> None:
            def on_message(message: Any) -> None:
                self._spoken[name] = self._spoken.get(name, 0) + 1
                note(decode(kind, message))

            create_subscription(
                self.node,
                kind.TYPE,
                topic,
                on_message,
                subscription_qos(STREAM, lockstep=True),
            )

        notes: dict[str, Callable[[Any], None]] = {
            'compensator': self._note_told,
            'thermal_predictor': self._note_error,
        }
        for node, (topic, kind) in SPEAKS.items():
            heard = direct(topic) if topic in stage.routes else topic
            hear(node, heard, kind, notes.get(node, lambda record: None))
        for topic, kind, note in (
            ('compensation_applied', CompensationApplied, self._note_applied),
            ('machine_state', MachineState, self._note_state),
        ):
            hear(MAKES_TIME, direct(topic) if topic in stage.routes else topic, kind, note)

    def _note_told(self, record: Compensation) -> None:
        if record.epoch < STRANGE_EPOCH:
            self._told = record
            self._hear('compensation', record)

    def _note_error(self, record: ThermalError) -> None:
        self._error = record
        self._hear('thermal_error', record)

    def _note_applied(self, record: CompensationApplied) -> None:
        self._applied = record
        self._working = self._working + 1 if self._works() else 0
        self._hear('compensation_applied', record)

    def _note_state(self, record: MachineState) -> None:
        self._now = record.stamp
        self._hear('machine_state', record)

    def _hear(self, topic: str, record: Any) -> None:
        self.heard.append((topic, record.stamp, time.monotonic()))

    def _spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.002 if self.relay.fault else 0.02)
        self.relay.send_due()
        try:
            self.supervisor.poll(time.monotonic())
        except GraphError as error:
            if str(error) not in self.findings:
                self.findings.append(str(error))
