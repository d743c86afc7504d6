# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bring graphs up in order, watch them until they are over or interrupted, take them down."""

import signal
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from fuzzycnc_ros.bags.recording_loss import LACKING, loss
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses, process_name
from fuzzycnc_ros.cli.live.supervision import ProcessState, Supervised, Supervisor
from fuzzycnc_ros.cli.live.supervision_view import ProcessView
from fuzzycnc_ros.graph.bring_up import ACTIVE_TIMEOUT, RECORDER_STOP, NodeSpec
from fuzzycnc_ros.ros.presence import TIME_SOURCES, GraphError, Presence, at_work, in_the_way
from fuzzycnc_ros.ros.service_manager import ServiceManager

if TYPE_CHECKING:
    from fuzzycnc_ros.cli.live.supervision_monitor import Monitor

GIVEN_UP = 1
"""Exit code where a node was given up."""

DECIDED = 6.0
"""Wall time [s] after which who is in the graph but does not speak counts as dead."""
SPOKE = 4.0
"""Wall time [s] since its newest report for a node that is alive: it reports every second, a busy
computer permitting."""

COMING_BACK = 30.0
"""Wall time [s] in which a node that was started anew reports, also on a busy computer."""

ENDED_FIRST = (('simulated_machine', 'simulated_body'), ('temperature_acquisition',))
"""Nodes that are ended before the others, in this order: where readings come from."""

Plan = Sequence[tuple[NodeSpec, ...]]
"""Processes of one machine, each with one node or several composed ones."""


def check_free(monitor: 'Monitor', presence: Presence, plans: Mapping[str, Plan]) -> None:
    """Refuse to start nodes beside others of the same name, or beside another machine.

    On this computer those count whose processes live; this command is one of them from here on.
    Elsewhere, who is in the graph only may be dead: what was killed stays there for two minutes.
    So those count that go on speaking.

    Parameters
    ----------
    monitor : Monitor
        Listens to these machines.
    presence : Presence
        Holds the names of the nodes that are to be started.
    plans : mapping of str to Plan
        What is to be started, by machine.

    Raises
    ------
    GraphError
        If somebody works there; the text names the nodes.
    """
    # Here, so that `fuzzycnc --help` works where ROS is not installed.
    from fuzzycnc_ros.cli.live.operator_client import SETTLED

    wanted = {
        machine: {spec.name for group in plan for spec in group} for machine, plan in plans.items()
    }
    own = [(machine, name) for machine, names in wanted.items() for name in names]
    taken = {(machine, name) for machine, names in wanted.items() for name in in_the_way(names)}
    monitor.spin_until(SETTLED)
    living = presence.claim(own, taken)
    # Killed nodes end by themselves, within moments of the command that started them.
    while (living or monitor.present() & taken) and monitor.age < DECIDED:
        monitor.spin()
        living = living and presence.claim(own, taken)
    now = time.monotonic()
    heard = {key for key in monitor.present() if now - monitor.view(*key).heard_at < SPOKE}
    found = sorted(living | (heard & taken))
    if found:
        raise GraphError(
            f'expected no nodes in {", ".join(sorted({machine for machine, _ in found}))} but '
            f'found {at_work(found)}: end them, choose another --machine or ROS_DOMAIN_ID, or add '
            '--takeover to run beside them'
        )


def supervise(
    console: Console,
    monitor: 'Monitor',
    graphs: Sequence[GraphProcesses],
    plans: Sequence[Plan],
    manager: ServiceManager,
    page: tuple[GraphProcesses, NodeSpec] | None,
) -> dict[str, Any]:
    """Run the processes of some graphs until they are over or interrupted; return how it went.

    The service manager, if there is one, learns when all nodes have reported, and as long as they
    do.  A live page beside them is started again like a node, but nothing depends on it.
    """
    with ProcessView(console) as view:
        supervisor = Supervisor(view.tell, monitor)
        try:
            if page is not None:
                supervisor.start(page[0], [page[1]], beside=True)
            _bring_up(supervisor, monitor, view, graphs, plans)
            view.tell(f'all started: {_names(supervisor)}; Ctrl-C ends them')
            while not supervisor.over:
                _watch(supervisor, monitor, view)
                _tell(manager, silent_nodes(supervisor.processes, monitor, time.monotonic()))
        except KeyboardInterrupt:
            view.tell('ending all nodes')
        manager.stopping()
        _end(graphs)
        lacking = _lacking(supervisor)
        for text in lacking:
            view.tell(f'error: {text}')
    document: dict[str, Any] = {
        'nodes': [spec.name for group in plans[0] for spec in group],
        'exit_code': GIVEN_UP if supervisor.given_up else LACKING if lacking else 0,
        'restarts': supervisor.restarts,
        'given_up': supervisor.given_up,
        'lacking': lacking,
    }
    told = {
        graph.machine: _outcome(graph, plan) for graph, plan in zip(graphs, plans, strict=True)
    }
    if len(graphs) == 1:
        return {**document, **told[graphs[0].machine]}
    return {**document, 'machines': told}


def _watch(supervisor: Supervisor, monitor: 'Monitor', view: ProcessView) -> None:
    """Listen for a moment, look after the processes, show it."""
    monitor.spin()
    supervisor.poll(time.monotonic())
    view.update(supervisor.processes, monitor)


def silent_nodes(processes: Sequence[Supervised], monitor: 'Monitor', now: float) -> list[str]:
    """Return the nodes that should report at wall time `now` [s] and do not.

    One that is about to be started anew need not, and one that was has some time for it.
    """
    found = []
    for process in processes:
        if process.beside:
            continue
        if process.state is ProcessState.GIVEN_UP:
            found.append(process.title)
        if process.state is not ProcessState.RUNNING:
            continue
        coming = bool(process.begun) and now - process.begun[-1] < COMING_BACK
        for spec in process.specs:
            node = monitor.view(process.graph.machine, spec.name)
            if node.silent(now) or (not node.heard_at and not coming):
                found.append(f'{process.graph.machine}/{spec.name}')
    return found


def _tell(manager: ServiceManager, silent: Sequence[str]) -> None:
    """Tell the service manager how the graph is; of one that hangs there is no sign of life."""
    if silent:
        manager.status(f'nothing heard of {", ".join(silent)}')
        return
    manager.ready()
    manager.pulse()
    manager.status('all nodes report')


def _bring_up(
    supervisor: Supervisor,
    monitor: 'Monitor',
    view: ProcessView,
    graphs: Sequence[GraphProcesses],
    plans: Sequence[Plan],
) -> None:
    """Start what serves, then the managed nodes one after the other, then what makes time."""
    waiting: list[tuple[GraphProcesses, tuple[NodeSpec, ...]]] = []
    managed: list[tuple[GraphProcesses, tuple[NodeSpec, ...]]] = []
    for graph, plan in zip(graphs, plans, strict=True):
        for group in plan:
            if any(spec.parameters.get('autostart') for spec in group):
                managed.append((graph, group))
            elif any(spec.name in TIME_SOURCES for spec in group):
                waiting.append((graph, group))
            else:
                supervisor.start(graph, group)
    for graph, group in managed:
        process = supervisor.start(graph, group)
        for spec in group:
            if spec.parameters.get('autostart'):
                _await_active(supervisor, monitor, view, process, spec.name)
    for graph, group in waiting:
        supervisor.start(graph, group)


def _await_active(
    supervisor: Supervisor, monitor: 'Monitor', view: ProcessView, process: Supervised, node: str
) -> None:
    """Wait until a managed node is active; say why if it does not get so far."""
    machine = process.graph.machine
    until = time.monotonic() + ACTIVE_TIMEOUT
    while not monitor.was_active(machine, node):
        _watch(supervisor, monitor, view)
        late = time.monotonic() > until
        if late or process.state in (ProcessState.GIVEN_UP, ProcessState.ENDED):
            state = monitor.lifecycle(machine, node) or 'not heard of'
            why = process.reason or '; '.join(monitor.view(machine, node).trouble)
            why = why or process.graph.last_words(process.name)
            view.tell(f'{machine}/{node} did not become active, it is {state}: {why}')
            return


def _end(graphs: Sequence[GraphProcesses]) -> None:
    """End all nodes along the way of a reading; the recorders last, as they hear the others out.

    Who is ended before what it reads from would leave the last message without an answer, which
    the recording then lacks.
    """
    ordered = {name for names in ENDED_FIRST for name in names} | {'recorder'}
    others = {name for graph in graphs for name in graph.names} - ordered
    for phase in (*map(set, ENDED_FIRST), others, {'recorder'}):
        asked = [
            (graph, graph.interrupt(name))
            for graph in graphs
            for name in graph.names
            if name in phase
        ]
        for graph, names in asked:
            graph.wait_ended(names)


def _lacking(supervisor: Supervisor) -> list[str]:
    """Return in words what the recordings of a run lack."""
    found = []
    for process in supervisor.processes:
        if not any(spec.name == 'recorder' for spec in process.specs):
            continue
        code = process.graph.poll().get(process.name)
        reasons = list(process.ends)
        if code == -signal.SIGKILL and process.state is ProcessState.RUNNING:
            bags = ', '.join(f'{bag}' for bag in _bags(process))
            found.append(
                f'{process.title} did not close its bag within {RECORDER_STOP:g} s and was '
                'killed, the disk was too slow: the recording lacks its end; complete it '
                f'with `fuzzycnc info {bags} --repair`'
            )
        elif code and process.state is ProcessState.RUNNING:  # it was asked to end, and failed
            reasons.append(f'ended with code {code}: {process.graph.last_words(process.name)}')
        if reasons:
            found.append(f'{process.title} {reasons[0]}: the recording has a gap there')
        found += _losses(process)
    return found


def _losses(process: Supervised) -> list[str]:
    """Return what the newest bag of a recorder says that it lacks."""
    from fuzzycnc_ros.bags.errors import BagError

    try:
        return [text for text in map(loss, _bags(process)) if text]
    except BagError:
        return []  # torn or not begun; why was said above


def _bags(process: Supervised) -> list[Path]:
    """Return the newest bags of a process."""
    return [
        Path(str(spec.parameters['output'])) for spec in process.specs if spec.name == 'recorder'
    ]


def _names(supervisor: Supervisor) -> str:
    titles = [process.title for process in supervisor.processes]
    return ', '.join(titles)


def _outcome(graph: GraphProcesses, plan: Plan) -> dict[str, Any]:
    """Return what the simulated machine of a graph said of its run."""
    for group in plan:
        if any(spec.name in TIME_SOURCES for spec in group):
            return graph.outcome(process_name(group))
    return {}
