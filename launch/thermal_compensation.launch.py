# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Start the graph of one machine or several, as `fuzzycnc up` does; Ctrl-C takes it down.

Which nodes, with which parameters, and what becomes of those that end: both follow
`fuzzycnc_ros/graph/bring_up.py`.
"""

import time
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import Event, EventHandler, LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events.process import ProcessExited
from launch.logging import launch_config
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.ros_adapters import get_ros_node

from fuzzycnc_ros.graph.bring_up import (
    ACTIVE_TIMEOUT,
    ADDED,
    BANNER,
    LAUNCH_ARGUMENTS,
    PAGE,
    Launched,
    RestartPolicy,
    again,
    launched,
    stop_timeout,
    unread_by,
)
from fuzzycnc_ros.ros.presence import TAKEOVER, TIME_SOURCES, GraphError, Presence
from fuzzycnc_ros.ros.processes import REFUSED
from fuzzycnc_ros.ros.topics import HISTORY_DEPTH, create_subscription, durable
from fuzzycnc_ros.runtime.host import NodeConfiguration

PACKAGE = 'fuzzycnc_ros'
PRESENCE = Presence()
"""Names of the nodes of this launch, until its process ends."""


class Told(Event):
    """A node has told its lifecycle state."""

    name = 'fuzzycnc_ros.Told'

    def __init__(self, node: tuple[str, str], state: str) -> None:
        self.node, self.state = node, state


def listen(context: LaunchContext, machine: str) -> None:
    """Let what the nodes of a machine tell of themselves be events of this launch.

    launch's own events follow `transition_event`, which nobody keeps: a node that activates itself
    as soon as it is there has often told so before this process has found it.
    """

    def on_configuration(message: object) -> None:
        told = Told((machine, message.node), message.lifecycle_state)
        context.asyncio_loop.call_soon_threadsafe(context.emit_event_sync, told)

    create_subscription(
        get_ros_node(context),
        NodeConfiguration.TYPE,
        f'/{machine}/node_configuration',
        on_configuration,
        durable(HISTORY_DEPTH),
    )


class Process:
    """One node of the graph: its present process, and those that follow when it dies."""

    def __init__(self, item: Launched) -> None:
        self.item, self.spec = item, item.spec
        self.resume = bool(item.spec.parameters.get('autostart'))
        self.policy, self.begun, self.restarts = RestartPolicy(), [], 0
        self.was_active = False  # in its present life
        self.on_active: list = []
        """Actions that wait for the node to be active for the first time."""

    @property
    def title(self) -> str:
        """Name for people."""
        return f'{self.item.machine}/{self.spec.name}'

    def actions(self) -> list:
        """Return what starts the node, and starts it anew when it ends."""
        node = Node(
            package=PACKAGE,
            executable=self.spec.name,
            name=self.spec.name,
            namespace=self.item.machine,
            output='screen',
            parameters=[*map(str, self.item.files), dict(self.spec.parameters)],
            remappings=[tuple(rule.split(':=')) for rule in self.item.remap],
            additional_env={TAKEOVER: '1'},  # this launch has looked who else is there
            sigterm_timeout=str(stop_timeout([self.spec.name])),
        )
        ended = OnProcessExit(target_action=node, on_exit=self._ended)
        return [RegisterEventHandler(ended), node]

    def watched(self) -> RegisterEventHandler:
        """Return what follows its lifecycle, through all of its lives."""
        key = self.item.machine, self.spec.name
        told = OpaqueFunction(function=self._told)
        return RegisterEventHandler(
            EventHandler(
                matcher=lambda event: isinstance(event, Told) and event.node == key,
                entities=[told],
            )
        )

    def _told(self, context: LaunchContext) -> list:
        """Note what a restart has to bring back: a manual deactivation is not undone."""
        active = context.locals.event.state == 'active'
        if not active:
            # A node that is configured becomes inactive, too: that is no deactivation.
            self.resume = self.resume and not self.was_active
            return []
        self.resume = self.was_active = True
        waiting, self.on_active = self.on_active, []
        return waiting

    def _ended(self, event: ProcessExited, context: LaunchContext) -> list:
        """Start the node anew, end the run, or give the node up."""
        if context.is_shutdown:
            return []
        code = event.returncode
        refused = code == REFUSED and not self.restarts and self.spec.name != PAGE
        if self.spec.name in TIME_SOURCES or refused:
            if code:
                raise GraphError(f'{self.title} ended with code {code}')
            return [Shutdown(reason=f'{self.title} is over')]
        now = time.monotonic()
        delay = None if code == REFUSED else self.policy.delay_after(self.begun, now)
        if delay is None:
            return [LogInfo(msg=f'{self.title} ended with code {code}; given up')]
        self.begun.append(now + delay)
        self.restarts += 1
        self.was_active = False
        self.spec = again(self.spec, self.restarts, resume=self.resume)
        text = f'{self.title} ended with code {code}; starts again in {delay:g} s'
        return [LogInfo(msg=text), TimerAction(period=delay, actions=self.actions())]


def bring_up(context: LaunchContext) -> list:
    """Return all nodes; what is wrong with the arguments ends the launch with an error."""
    given = {name: LaunchConfiguration(name).perform(context) for name in LAUNCH_ARGUMENTS}
    share = Path(get_package_share_directory(PACKAGE))
    items = launched(given, share / 'params', Path(launch_config.log_dir))
    if given['takeover'] != 'true':
        PRESENCE.claim_graph([(item.machine, item.spec.name) for item in items])
    for machine in dict.fromkeys(item.machine for item in items if item.machine):
        listen(context, machine)
    processes = [Process(item) for item in items]
    watches = [item.watched() for item in processes]
    first = [item for item in processes if not item.resume and not _makes_time(item)]
    managed = [item for item in processes if item.resume]
    last = [item for item in processes if _makes_time(item)]
    # Each managed node is waited for, and what makes time waits for all of them.
    following = [action for item in last for action in item.actions()]
    for item in reversed(managed):
        started = _Once(following)
        item.on_active = [started]
        late = TimerAction(period=ACTIVE_TIMEOUT, actions=[started])
        following = [*item.actions(), late]
    folder = given['params_dir']
    said = unread_by(items, Path(folder)) if folder else []
    notes = [LogInfo(msg=f'params_dir: {text}') for text in said]
    return [*notes, *watches, *(action for item in first for action in item.actions()), *following]


class _Once(OpaqueFunction):
    """Actions that are carried out by whoever comes first."""

    def __init__(self, actions: list) -> None:
        super().__init__(function=self._take)
        self._actions = actions

    def _take(self, context: LaunchContext) -> list:
        actions, self._actions = self._actions, []
        return actions


def _makes_time(process: Process) -> bool:
    return process.spec.name in TIME_SOURCES


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument(
            name,
            default_value=item.default,
            description=item.text,
            **({'choices': ['true', 'false']} if item.switch or name in ADDED else {}),
        )
        for name, item in LAUNCH_ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, LogInfo(msg=BANNER), OpaqueFunction(function=bring_up)])
