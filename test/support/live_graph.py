# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A real graph for tests: nodes as processes, and a node of the test to watch them.

A `conftest.py` imports the fixtures by name; `domain` is in the top one.

Every test has a ROS domain of its own, or shares one with the tests of its module.  Nodes are
started with this interpreter and environment, each in a process group of its own, and always
killed at the end; what they wrote is shown when a test fails.  Tests wait for conditions and never
sleep for luck; the limits of waiting only guard against a hang, however slow the machine is.
"""

import contextlib
import fcntl
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from kept import kept
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from processes import HANG, start
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.bags.typestore import ROSBAGS
from fuzzycnc_ros.cli.live.graph_processes import parameter_file, ros_arguments
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.graph.bring_up import NodeSpec, node_specs
from fuzzycnc_ros.ros.processes import prepare_environment
from fuzzycnc_ros.ros.run import run
from fuzzycnc_ros.ros.topics import message_class, subscription_qos
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration, run_shift

ROOT = Path(__file__).parents[2]
DOMAINS = 100
"""Domains 1 to 100: above 101 the ports would lie among those that the system hands out."""
PORTS, PORTS_EACH = 7400, 250
"""First port of domain 0, and ports of each domain, as DDS-RTPS lays down."""
OWN_PORTS = range(10, 90)
"""Of them, those that forty participants listen on, each alone."""
START_TIMEOUT = 120.0
STOP_TIMEOUT = 120.0
RUN_TIMEOUT = 240.0
CLOSE_TIMEOUT = 10.0
ANSWER_TIMEOUT = 60.0
"""After which a node of a lock-step run is lost, for runs in which none may be."""
KILL_TIMEOUT = 10.0
"""The same for runs in which one is killed: they prove as much if a living one is late."""
SET_CLOCK = """
import sys
from importlib import import_module
from pathlib import Path
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
file, true = Path(sys.argv.pop(1)), Clock.now
def now(self):
    if self.clock_type is ClockType.STEADY_TIME:
        return true(self)
    return true(self) + Duration(nanoseconds=int(file.read_text()))
Clock.now = now
import_module(f'fuzzycnc_ros.nodes.{sys.argv.pop(1)}').main()
"""
"""Runs a node whose wall clock is set; the monotonic one goes on, as it does on a computer."""
DRAIN, SETTLED = 20, 10
"""Idle callbacks here, and requests that a node answers, after which all is taken."""
AGAIN = 5.0
"""Wall time [s] after which a question that changes nothing is asked again."""
GOALS = {
    Transition.TRANSITION_CONFIGURE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_ACTIVATE: State.PRIMARY_STATE_ACTIVE,
    Transition.TRANSITION_DEACTIVATE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_CLEANUP: State.PRIMARY_STATE_UNCONFIGURED,
}
STREAM, LATCHED = Durability.STREAM, Durability.LATCHED
_SEGMENT_LOCK = re.compile(r'(/dev/shm/fastrtps_[0-9a-f]{16})_el')

prepare_environment()
_turn = count()


@contextmanager
def free_domain() -> Iterator[int]:
    """Yield a ROS domain that nobody on this host uses; a lock file holds it.

    The lock keeps out other tests of this user, in whatever process; ports in use tell of nodes
    of others, and of those that outlived a test that was killed.
    """
    first = os.getpid() + 7 * next(_turn)
    for offset in range(DOMAINS):
        number = 1 + (first + offset) % DOMAINS
        path = Path(tempfile.gettempdir()) / f'fuzzycnc-domain-{os.getuid()}-{number}.lock'
        with path.open('w') as handle:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                for port in OWN_PORTS:
                    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                        probe.bind(('', PORTS + PORTS_EACH * number + port))
            except OSError:
                continue
            _remove_ports(number)
            try:
                yield number
            finally:
                _remove_ports(number)
            return
    pytest.fail(f'expected a free ROS domain among 1 to {DOMAINS} but all are in use')


def _remove_ports(number: int) -> None:
    """Remove what killed nodes of a domain left of their ports in shared memory."""
    for file in Path('/dev/shm').glob('*fastrtps_port*'):
        port = int(re.findall(r'port(\d+)', file.name)[0])
        if 0 <= port - PORTS - PORTS_EACH * number < PORTS_EACH:
            with contextlib.suppress(FileNotFoundError, PermissionError):
                file.unlink()


def owned_segments(process: int) -> set[str]:
    """Return the segments of shared memory whose locks a process holds, and these locks.

    It leaves them if it is killed.  What it has mapped beside them is others'.  Nor are its ports
    its own for ever: those from 7000 on are handed out to the nodes of all domains.
    """
    owned: set[str] = set()
    with contextlib.suppress(OSError):  # it has ended
        for link in Path(f'/proc/{process}/fd').iterdir():
            with contextlib.suppress(FileNotFoundError):  # it has closed the file
                if held := _SEGMENT_LOCK.fullmatch(os.readlink(link)):
                    owned.update(held.group(0, 1))
    return owned


@pytest.fixture(scope='module')
def shared_domain() -> Iterator[int]:
    """A ROS domain of the tests of a module."""
    with free_domain() as number:
        yield number


class Running:
    """A node that was started as a process."""

    def __init__(self, name: str, process: subprocess.Popen[bytes], log: Path) -> None:
        self.name, self.process, self.log = name, process, log

    @property
    def output(self) -> str:
        """What the node has written so far."""
        return self.log.read_text(errors='replace')

    @property
    def outcome(self) -> dict[str, Any]:
        """What a machine or player says of its run in its last line."""
        lines = [line for line in self.output.splitlines() if line.startswith('{')]
        assert lines, f'{self.name} told no outcome: {self.output}'
        return json.loads(lines[-1])

    def send(self, number: int) -> None:
        """Send a signal to the node's process group."""
        os.killpg(self.process.pid, number)

    def wait(self, timeout: float = RUN_TIMEOUT) -> int:
        """Wait for the node's end; return its exit code."""
        try:
            return self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
                self.send(signal.SIGABRT)  # its stack says what it is at
                self.process.wait(timeout)
            raise AssertionError(
                f'{self.name} did not end within {timeout:g} s: {self.output}'
            ) from None

    def interrupt(self, number: int = signal.SIGINT, timeout: float = STOP_TIMEOUT) -> int:
        """Ask the node to end; return its exit code."""
        self.send(number)
        return self.wait(timeout)


class Graph:
    """The nodes of a test, or of the tests of a module."""

    def __init__(self, domain: int, folder: Path) -> None:
        self.domain = domain
        self.folder = folder
        self.tree = ROOT
        """Where the package lies that nodes are started from."""
        self.running: list[Running] = []
        self._shared: set[str] = set()

    def start(
        self,
        node: str,
        parameters: Mapping[str, Any] | None = None,
        *,
        files: tuple[Path, ...] = (),
        arguments: tuple[str, ...] = (),
        namespace: str = '/mill',
        interrupts: str = 'default',
    ) -> Running:
        """Start a node with parameters, parameter files read before them, and remappings."""
        folder = self.folder / f'{len(self.running)}-{node}'
        folder.mkdir(parents=True)
        own = parameter_file(folder, namespace, [NodeSpec(node, parameters or {})])
        command = [sys.executable, '-m', f'fuzzycnc_ros.nodes.{node}']
        command += [*ros_arguments(namespace, [*files, own]), *arguments]
        return self.launch(node, command, folder, interrupts)

    def start_by(self, clock: Path, node: str, parameters: Mapping[str, Any]) -> Running:
        """Start a node on a computer whose clock a file sets forward [ns]."""
        folder = self.folder / f'{len(self.running)}-{node}'
        folder.mkdir(parents=True)
        own = parameter_file(folder, '/mill', [NodeSpec(node, parameters)])
        command = [sys.executable, '-c', SET_CLOCK, str(clock), node]
        return self.launch(node, [*command, *ros_arguments('/mill', [own])], folder)

    def compose(
        self,
        *nodes: str,
        parameters: Mapping[str, Mapping[str, Any]] | None = None,
        files: tuple[Path, ...] = (),
        interrupts: str = 'default',
    ) -> Running:
        """Start nodes in one process, which starts as quickly as one of them."""
        folder = self.folder / f'{len(self.running)}-composed'
        folder.mkdir(parents=True)
        specs = [NodeSpec(node, own) for node, own in (parameters or {}).items()]
        given = [*files, parameter_file(folder, '/mill', specs)]
        command = [sys.executable, '-m', 'fuzzycnc_ros.nodes.composed', *nodes]
        command += ros_arguments('/mill', given)
        return self.launch('composed', command, folder, interrupts)

    def start_shift(
        self,
        model: Path,
        *,
        bag: Path | None = None,
        lockstep: bool = True,
        overrides: Mapping[str, Mapping[str, Any]] | None = None,
        without: tuple[str, ...] = (),
        **machine: Any,
    ) -> dict[str, Running]:
        """Start the nodes that compensate a duty, the simulated machine last."""
        specs = node_specs(
            duties=tuple(machine.pop('duties', ('T2',))),
            model=model,
            record=bag,
            lockstep=lockstep,
            autostart=True,
            # However busy the computer is, a living node answers within a minute.
            machine_parameters={'answer_timeout': ANSWER_TIMEOUT, **machine},
        )
        return {
            spec.name: self.start(
                spec.name, {**spec.parameters, **(overrides or {}).get(spec.name, {})}
            )
            for spec in specs
            if spec.name not in without
        }

    def launch(
        self, name: str, command: list[str], folder: Path, interrupts: str = 'default'
    ) -> Running:
        """Start any command in the test's domain."""
        environment = {
            **os.environ,
            'ROS_DOMAIN_ID': str(self.domain),
            'PYTHONPATH': os.pathsep.join([str(self.tree), os.environ.get('PYTHONPATH', '')]),
            'PYTHONUNBUFFERED': '1',
            'OMP_NUM_THREADS': '1',
        }
        log = folder / 'output.log'
        with log.open('wb') as output:
            process = start(
                command,
                interrupts=interrupts,
                stdout=output,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=environment,
                cwd=self.tree,
                start_new_session=True,
            )
        self.running.append(Running(name, process, log))
        return self.running[-1]

    def kill(self, node: Running) -> None:
        """Kill a node as a power cut would."""
        self._shared |= owned_segments(node.process.pid)
        node.send(signal.SIGKILL)
        node.process.wait()

    def stop(self) -> None:
        """Ask all nodes to end; each must end with code 0."""
        living = [node for node in self.running if node.process.poll() is None]
        for node in living:
            node.send(signal.SIGINT)
        codes = {node.name: node.wait(STOP_TIMEOUT) for node in living}
        assert set(codes.values()) <= {0}, codes

    def close(self) -> None:
        """End what still runs, kill what does not end, remove what is left in shared memory."""
        living = [node for node in self.running if node.process.poll() is None]
        for node in living:
            self._shared |= owned_segments(node.process.pid)
            with contextlib.suppress(ProcessLookupError):
                node.send(signal.SIGCONT)
                node.send(signal.SIGINT)
        deadline = time.monotonic() + CLOSE_TIMEOUT
        for node in living:
            with contextlib.suppress(subprocess.TimeoutExpired):
                node.process.wait(max(0.0, deadline - time.monotonic()))
            with contextlib.suppress(ProcessLookupError):
                node.send(signal.SIGKILL)
            node.process.wait()
        for path in self._shared:
            Path(path).unlink(missing_ok=True)


class Observer:
    """A node of the test itself, in the same domain."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(
            context=self.context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node('observer', namespace='/mill', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._readers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._taken = 0
        self.statuses: dict[str, list[tuple[int, str]]] = {}
        """Level and text of each diagnostic item that was ever reported, in order of change."""

    def records(self, topic: str, kind: Any, durability: Durability = STREAM) -> list[Any]:
        """Return a list that grows with the records of a topic."""
        heard: list[Any] = []
        self._readers[topic] = self.node.create_subscription(
            message_class(kind.TYPE),
            topic,
            lambda message: self._note(heard, decode(kind, message)),
            subscription_qos(durability, lockstep=True),
        )
        return heard

    def _note(self, heard: list[Any], record: Any) -> None:
        heard.append(record)
        self._taken += 1

    def hears(self, topic: str) -> bool:
        """Whether somebody publishes a topic that is listened to, and the route stands."""
        return bool(self._readers[topic].get_publisher_count())

    def forget(self, topic: str) -> None:
        """Hear no more of a topic: listening costs the graph time."""
        self.node.destroy_subscription(self._readers.pop(topic))

    def watch_diagnostics(self) -> None:
        """Note every change on /diagnostics."""

        def note(array: DiagnosticArray) -> None:
            for status in array.status:
                news = (status.level[0], status.message)
                heard = self.statuses.setdefault(status.name, [])
                if not heard or heard[-1] != news:
                    heard.append(news)

        self.node.create_subscription(DiagnosticArray, '/diagnostics', note, 100)

    def told(self, item: str, text: str) -> bool:
        """Whether a diagnostic item has ever said something."""
        return any(text in message for _, message in self.statuses.get(item, ()))

    def spin(self) -> None:
        """Work for a moment."""
        self.executor.spin_once(timeout_sec=0.02)

    def spin_for(self, duration: float) -> None:
        """Work for some wall time [s], in which something must not happen."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self.spin()

    def drain(self, timeout: float = 0.0) -> None:
        """Take what has arrived, until nothing comes for some callbacks or waits."""
        idle = 0
        while idle < DRAIN:
            before = self._taken
            self.executor.spin_once(timeout_sec=timeout)
            idle = 0 if self._taken > before else idle + 1

    def settle(self, *nodes: str) -> None:
        """Wait until nodes have taken what was published here, and hear what they said to it.

        Before a request they take what came earlier, one message of each topic at a time.
        """
        for node in nodes:
            name = f'/mill/{node}/get_parameters'
            for _ in range(SETTLED):
                self.call(GetParameters, name, GetParameters.Request(), again=AGAIN)
        self.drain()

    def until(
        self, condition: Callable[[], Any], what: str = '', timeout: float = START_TIMEOUT
    ) -> None:
        """Spin until a condition holds.

        Raises
        ------
        AssertionError
            If it does not hold in time.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, f'not within {timeout:g} s: {what}'
            self.spin()

    def until_ended(self, node: Running, timeout: float = RUN_TIMEOUT) -> int:
        """Spin until a node has ended; return its exit code."""
        what = f'end of {node.name}'
        self.until(lambda: node.process.poll() is not None, what, timeout)
        self.drain(0.02)  # a busy test lags behind, by thousands of messages
        return int(node.process.returncode)

    def call(
        self,
        kind: Any,
        name: str,
        request: Any,
        timeout: float = START_TIMEOUT,
        again: float = math.inf,
    ) -> Any:
        """Call a service and return its response.

        A server that has not found this client yet drops its response.  What may be asked twice
        is asked `again` after so much wall time [s].
        """
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f'service {name}', timeout)
        futures: list[Any] = []
        asked = -math.inf

        def answered() -> bool:
            nonlocal asked
            if not futures or time.monotonic() - asked > again:
                futures.append(client.call_async(request))
                asked = time.monotonic()
            return any(future.done() for future in futures)

        self.until(answered, f'answer of {name}', timeout)
        return next(future.result() for future in futures if future.done())

    def state(self, node: str, machine: str = 'mill') -> int:
        """Ask for the lifecycle state of a node."""
        name = f'/{machine}/{node}/get_state'
        return self.call(GetState, name, GetState.Request(), again=AGAIN).current_state.id

    def change(self, node: str, transition: int, machine: str = 'mill') -> bool:
        """Ask a node for a transition; return whether it was carried out.

        Its state tells if its answer was dropped.
        """
        request = ChangeState.Request(transition=Transition(id=transition))
        name = f'/{machine}/{node}/change_state'
        # It is there: what a killed one left looks like its service.
        before = self.state(node, machine)
        try:
            return self.call(ChangeState, name, request, 2 * AGAIN).success
        except AssertionError:
            return before != self.state(node, machine) == GOALS[transition]

    def close(self) -> None:
        """Leave the domain."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@contextmanager
def opened(domain: int, folder: Path) -> Iterator[Graph]:
    """Nodes as processes in a domain, which end in the end."""
    started = Graph(domain, folder)
    try:
        yield started
    finally:
        started.close()


@pytest.fixture
def graph(domain: int, tmp_path: Path) -> Iterator[Graph]:
    """Nodes as processes in a domain of their own."""
    with opened(domain, tmp_path / 'nodes') as started:
        yield started


@pytest.fixture(scope='module')
def shared_graph(shared_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """Nodes as processes that the tests of a module share."""
    with opened(shared_domain, tmp_path_factory.mktemp('nodes')) as started:
        yield started


@pytest.fixture
def observer(domain: int, graph: Graph) -> Iterator[Observer]:
    """A node of the test in the same domain, closed before the nodes are."""
    with contextlib.closing(Observer(domain)) as watching:
        yield watching


@pytest.fixture
def shared_observer(shared_domain: int, shared_graph: Graph) -> Iterator[Observer]:
    """A node of the test among the nodes that the tests of a module share."""
    with contextlib.closing(Observer(shared_domain)) as watching:
        yield watching


@kept
def model_of_the_mill() -> str:
    """Return a model trained on three calibration runs of the simulated mill."""
    return train_model(record_calibration().runs).to_json()


@pytest.fixture(scope='session')
def model_text() -> str:
    """A model trained on three calibration runs of the simulated mill."""
    return model_of_the_mill()


@pytest.fixture
def model_file(model_text: str, tmp_path: Path) -> Path:
    """The trained model as a file."""
    path = tmp_path / 'model.json'
    path.write_text(model_text, encoding='utf-8')
    return path


OUTPUTS = (
    'machine_state',
    'compensation_applied',
    'displacement',
    'sensor_readings',
    'thermal_reference',
    'temperatures',
    'thermal_error',
    'predictor_state',
    'compensation',
)
"""Topics of a shift that must come out alike."""


@pytest.fixture(scope='session')
def outputs() -> tuple[str, ...]:
    """Topics of a shift that must come out alike, without namespace."""
    return OUTPUTS


@pytest.fixture(scope='session')
def bag_hashes() -> Callable[[Path], dict[str, str]]:
    """Return the canonical hash of each output in a bag."""

    def find(bag: Path) -> dict[str, str]:
        found = topic_hashes(bag)
        return {name: found[f'/mill/{name}'] for name in OUTPUTS if f'/mill/{name}' in found}

    return find


class InProcess:
    """The same shift in one process, without DDS."""

    def __init__(self, model_text: str) -> None:
        self._model_text = model_text

    def run(
        self, *, duties: tuple[str, ...] = ('T2',), seed: int = 0, **machine: Any
    ) -> dict[str, list[Any]]:
        """Return the records of each output."""
        log: dict[str, list[Any]] = {name: [] for name in OUTPUTS}

        def sink(topic: str, record: Any) -> None:
            if topic in log:
                log[topic].append(record)

        parameters = {'simulated_machine': machine}
        run_shift(self._model_text, duties=duties, seed=seed, parameters=parameters, sink=sink)
        return log

    def hashes(self, **machine: Any) -> dict[str, str]:
        """Return the canonical hash of each output."""
        found = topic_hashes(
            (f'/mill/{name}', record.TYPE, record.stamp, encode(record, ROSBAGS))
            for name, records in self.run(**machine).items()
            for record in records
        )
        return {name: found[f'/mill/{name}'] for name in OUTPUTS}


@pytest.fixture(scope='session')
def in_process(model_text: str) -> InProcess:
    """The same shift in one process, without DDS."""
    return InProcess(model_text)


@pytest.fixture
def refusal(
    domain: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> Callable[[str, Mapping[str, Any]], str]:
    """Start a node with parameters that it must refuse; return its one line.

    It runs in this process, since a process of its own takes half a second to start.
    """
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setattr('fuzzycnc_ros.ros.run.LETTING_GO', int(HANG))  # else it ends all tests
    monkeypatch.chdir(tmp_path)

    def start(node: str, parameters: Mapping[str, Any]) -> str:
        file = parameter_file(tmp_path, '/mill', [NodeSpec(node, parameters)])
        module = import_module(f'fuzzycnc_ros.nodes.{node}')
        assert run([module.make], ros_arguments('/mill', [file])) == 2
        lines = capfd.readouterr().err.splitlines()
        errors = [line for line in lines if line.startswith('error: ')]
        assert len(errors) == 1, lines
        assert not any(line.startswith('Traceback') for line in lines), lines
        return errors[0]

    return start


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Show what the nodes wrote when a test fails."""
    outcome = yield
    report = outcome.get_result()
    if not report.failed:
        return
    for name in ('graph', 'shared_graph'):
        nodes = getattr(item, 'funcargs', {}).get(name)
        for node in nodes.running if isinstance(nodes, Graph) else ():
            code = node.process.poll()
            report.sections.append((f'{node.name}, exit code {code}', node.output))
