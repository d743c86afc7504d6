# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The generic host: turns a component's declaration into a node.

Publishers, subscriptions, parameters, diagnostics, provenance, deadlines and lock-step turns all
follow from the declaration.  What is peculiar to one node (services, actions, drivers) stands in
that node's own file, as a subclass of `ComponentNode`.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from fuzzycnc_ros.ros.clocks import SteadyClock, stamp_ahead_max, wall_timer
from fuzzycnc_ros.ros.command_watch import CommandWatch
from fuzzycnc_ros.ros.health import Activity, diagnostic_array, input_health
from fuzzycnc_ros.ros.node_config import HostConfig
from fuzzycnc_ros.ros.parameters import ParameterError, changed, declare, refusal
from fuzzycnc_ros.ros.presence import check_alone
from fuzzycnc_ros.ros.state_file import StateDirectory, StateFileError
from fuzzycnc_ros.ros.topics import (
    RCLPY,
    create_publisher,
    create_subscription,
    routes_matched,
    subscription_qos,
    unmatched,
)
from fuzzycnc_ros.ros.turn_taker import TurnTaker
from fuzzycnc_ros.runtime.component import (
    HISTORY,
    LATCHED,
    REQUEST,
    Answer,
    Component,
    Durability,
    Emission,
    Health,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.runtime.host import DeadlineFired, NodeConfiguration, NodeEvent
from fuzzycnc_ros.runtime.merge import Merger
from fuzzycnc_ros.runtime.provenance import (
    CLOCK_STEP,
    REFUSED,
    configuration_record,
    event_record,
)
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Record,
)

NOTICED = 3600.0
"""Wall time [s] for which the diagnostics tell of what has happened once."""
DEADLINE_POLL = 0.1
"""Wall time [s] between two looks at a component's deadline in real time."""


class ComponentNode:
    """Serve one component on a ROS node.

    Parameters
    ----------
    node : Node
        The node; a plain or a managed one.
    component_type : type
        The component's class.

    Raises
    ------
    ParameterError
        If a parameter is unknown, of the wrong type or out of bounds.
    """

    def __init__(self, node: Node, component_type: type[Component[Any]]) -> None:
        self.node = node
        check_alone(node.get_namespace(), component_type.NAME)
        host, config = declare(node, HostConfig, component_type.CONFIG)
        self.settings = host
        self.executor = host.executor
        try:
            self.component = component_type(config)
        except ValueError as error:
            raise ParameterError(str(error)) from error
        self.component.machine = host.machine or node.get_namespace().strip('/') or 'machine'
        self.merger = Merger(self.component)
        # Simulated time goes at any speed, stands and jumps: that is no fault of a clock.
        simulated = bool(node.get_parameter('use_sim_time').value)
        self._steady = None if simulated or self.makes_time else SteadyClock(self._clock_now)
        self._ahead_max = stamp_ahead_max(node)
        self.troubles: dict[str, str] = {}
        """Faults of the host itself, reported on /diagnostics until they are over."""
        self._publishers: dict[str, Any] = {}
        self._subscriptions: dict[str, Any] = {}
        self._published: dict[str, int] = {}
        self._deaf: set[str] = set()
        self._routes: list[Health] = []
        self._strangers: dict[str, tuple[int, str]] = {}
        self._notices: dict[str, tuple[float, str]] = {}
        self._lifecycle_state = 'active'
        self._activity = Activity()
        self._sent_at = 0  # wall time of the newest driving message that is not worked yet [ns]
        for item in component_type.OUTPUTS:
            self._advertise(item)
        self._configuration = self._advertise(
            Output('node_configuration', NodeConfiguration, LATCHED), private=True
        )
        self._events = self._advertise(Output('node_event', NodeEvent, HISTORY), private=True)
        self._state = self._open_state(host.state_directory)
        self.turns: TurnTaker | None = None
        if host.lockstep and self.takes_turns:
            self.turns = TurnTaker(
                node,
                self.work,
                lambda: self.component.next_deadline,
                reads=lambda: self.reads,
                writes=tuple(self._published),
                matched=self.matched,
            )
        for source in component_type.INPUTS:
            self._subscribe(source.name, source.record, source.durability)
        self._commands = CommandWatch(
            node,
            {node.resolve_topic_name(i.name): i.name for i in component_type.INPUTS if i.sole},
            self._on_sources,
            lockstep=host.lockstep,
            often=component_type.MACHINE_SIDE,
        )
        if not host.lockstep:
            self._deadlines = self._advertise(
                Output('deadline_fired', DeadlineFired), private=True
            )
            # Waking up for nothing would be half of what an idle machine costs.
            if component_type.next_deadline is not Component.next_deadline:
                wall_timer(node, DEADLINE_POLL, self.on_poll)
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        wall_timer(node, 1.0, self.report)
        node.add_on_set_parameters_callback(self.on_parameters)
        self._restore()

    makes_time = False
    """True if machine time is made here, so that the clock of the node does not matter."""

    takes_turns = True
    """True if the node works in turns in lock-step; the machine itself gives them."""

    keeps_newest = False
    """True if in real time only the newest driving message counts: an older one is of no use."""

    exit_code = 0
    """Exit code of the process."""

    @property
    def done(self) -> bool:
        """True if the node has nothing left to do and its process may end."""
        return False

    def start(self) -> None:
        """Announce the configuration, once the node is complete."""
        self.announce()

    def stop(self) -> None:
        """Release what the node holds beside its part of the middleware, at the process' end."""

    def publish(self, emissions: Iterable[Emission]) -> None:
        """Publish what the component emitted and keep what must survive a restart."""
        for emission in emissions:
            self._send(emission.output, emission.record)
            item = self.component.output(emission.output)
            if item.persistent:
                self._save(item, emission.record)

    def request(self, name: str, arguments: Mapping[str, Any]) -> Answer:
        """Carry out a request and write it down for replay."""
        if any(item.level >= Level.ERROR for item in self.component.health()):
            self._tell_health()  # the request may end it before the second is over
        answer = self.component.on_request(name, arguments, self.merger.time)
        if answer.success:
            event = event_record(self.component, self.merger.time, name, arguments)
            self._send('node_event', event)
            self.publish(answer.emissions)
            self.announce()
        return answer

    def announce(self, lifecycle_state: str | None = None) -> None:
        """Publish what the node runs with."""
        if lifecycle_state is not None:
            self._lifecycle_state = lifecycle_state
        record = configuration_record(self.component, self.merger.time, self._lifecycle_state)
        self._configuration.publish(encode(record, RCLPY))

    def report(self) -> None:
        """Publish the health of the component and its inputs on /diagnostics."""
        self.follow_clock()
        if not self.component.MACHINE_SIDE:
            self._commands.look()
        self._routes = self._route_health()
        self._tell_health()

    def _tell_health(self) -> None:
        now = self.merger.time if self.settings.lockstep else self.now()
        health = [
            *self.component.health(),
            *self._host_health(),
            *input_health(self.merger, now),
            *self._routes,
            *self.own_health(),
            self._activity.health(),
        ]
        self._diagnostics.publish(
            diagnostic_array(
                self.node.get_fully_qualified_name(),
                self.component.machine,
                health,
                self.troubles,
                self.node.get_clock().now().to_msg(),
            )
        )

    def _host_health(self) -> list[Health]:
        """Report inputs that several nodes publish, and a clock that was set."""
        found = [
            Health(f'sources of {name}', Level.ERROR, text)
            for name, text in self.component.sources.refusals.items()
        ]
        now = time.monotonic()
        for name, (since, text) in self._notices.items():
            if now - since < NOTICED:
                found.append(Health(name, Level.WARN, text))
        return found

    def own_health(self) -> list[Health]:
        """Report on what is peculiar to this node."""
        return []

    def _route_health(self) -> list[Health]:
        """Report publishers that stay unheard: another QoS, or another type of the same name."""
        deaf = {topic: unmatched(self.node, item) for topic, item in self._subscriptions.items()}
        # Discovery shows a publisher shortly before its route stands.
        lasting = [topic for topic, count in deaf.items() if count and topic in self._deaf]
        self._deaf = {topic for topic, count in deaf.items() if count}
        return [
            Health(
                topic,
                Level.WARN,
                f'{deaf[topic]} publisher(s) of {topic} cannot be heard; compare their QoS and '
                'message type with `ros2 topic info -v`',
            )
            for topic in lasting
        ]

    def matched(self, readers: Mapping[str, int]) -> bool:
        """Return True if both ends of all routes of this node are matched.

        Parameters
        ----------
        readers : mapping of str to int
            Topics of the run, absolute names, and how many of its nodes read each.
        """
        return routes_matched(
            self.node, self._subscriptions.values(), self._publishers.values(), readers
        )

    @property
    def reads(self) -> tuple[str, ...]:
        """Absolute topics that the node reads."""
        return tuple(self._subscriptions)

    @property
    def published(self) -> dict[str, int]:
        """Messages published on each of the component's outputs so far, by absolute topic."""
        return self._published

    def _advertise(self, item: Output, *, private: bool = False) -> Any:
        """Create a publisher; private ones are left out of lock-step announcements."""
        publisher = create_publisher(self.node, item.record.TYPE, item.name, item.durability)
        self._publishers[item.name] = publisher
        if not private:
            self._published[publisher.topic_name] = 0
        return publisher

    def _send(self, name: str, record: Record) -> None:
        publisher = self._publishers[name]
        publisher.publish(encode(record, RCLPY))
        self._activity.published()
        topic = publisher.topic_name
        if topic in self._published:
            self._published[topic] += 1
            if self.turns is not None:
                self.turns.published(topic)

    def _subscribe(self, name: str, record_type: type[Record], durability: Durability) -> None:
        topic = self.node.resolve_topic_name(name)
        handler = self._input_handler(name, topic, record_type)
        lockstep = self.settings.lockstep
        qos = subscription_qos(durability, lockstep=lockstep)
        if self.keeps_newest and not lockstep and self.component.input(name).driving:
            qos.depth = 1
        self._subscriptions[topic] = create_subscription(
            self.node, record_type.TYPE, name, handler, qos
        )

    def _input_handler(
        self, name: str, topic: str, record_type: type[Record]
    ) -> Callable[[Any, Any], None]:
        drives = self.component.input(name).driving

        def on_message(message: Any, info: Any) -> None:
            self.follow_clock()
            number = info['publication_sequence_number']
            record = decode(record_type, message)
            doubt = self._doubt_of(name, topic, number)
            accepted = (
                not (doubt and self._refuse(name, record, doubt))
                and not self._from_the_future(name, record)
                and self.merger.push(name, record)
            )
            self.on_heard(topic, number)
            if drives:
                self._sent_at = info['source_timestamp']
            if not self.settings.lockstep and drives and accepted:
                self.work(record.stamp)

        return on_message

    def _from_the_future(self, name: str, record: Record) -> bool:
        """Refuse, in real time, a record whose stamp is far ahead of the node's clock.

        Taken, it would have the node work up to that time and drop all that comes until then.
        Where machine time has not begun nothing is known to be ahead of it.
        """
        now, most = self.now(), self._ahead_max
        if self.settings.lockstep or not (now and most) or record.stamp <= now + most:
            return False
        return self._refuse(
            name,
            record,
            f'stamp: expected at most {most / SECOND:g} s ahead of the clock but found '
            f'{(record.stamp - now) / SECOND:.9g} s; compare the clocks, and stamp_ahead_max',
        )

    def _refuse(self, name: str, record: Record, why: str) -> bool:
        """Leave a record out, and write that down for replay."""
        self.merger.refuse(name, why)
        told = {'input': name, 'stamp': record.stamp}
        self._send('node_event', event_record(self.component, self.merger.time, REFUSED, told))
        return True

    def _doubt_of(self, name: str, topic: str, number: int) -> str:
        """Say why a message is not from the one source of its topic; empty if it may be."""
        doubt = self._commands.heard(topic, number)
        if doubt:
            count, before = self._strangers.get(name, (0, ''))
            if doubt != before:
                self.node.get_logger().error(f'{name} {doubt}; refused')
            self._strangers[name] = count + 1, doubt
            self._notice(
                f'strangers on {name}', f'{count + 1} messages refused; the newest {doubt}'
            )
        return doubt

    def _notice(self, name: str, text: str) -> None:
        """Have the operator see what has happened, though it is over."""
        self._notices[name] = time.monotonic(), text

    def on_heard(self, topic: str, sequence_number: int) -> None:
        """Note in lock-step that a message has come in."""
        if self.turns is not None:
            self.turns.received(topic, sequence_number)

    def work(self, stamp: int) -> None:
        """Have the component work up to a stamp [ns], and publish what it emits."""
        self.publish(self.merger.advance(stamp))
        if self._sent_at:
            self._activity.worked(self._sent_at)
            self._sent_at = 0

    def _on_sources(self, name: str, nodes: tuple[str, ...]) -> None:
        """Tell the component who commands it at once, so that it refuses all of them."""
        answer = self.request(REQUEST, {'input': name, 'node': list(nodes)})
        # Two calls: rclpy refuses another severity from the same line.
        if nodes:
            self.node.get_logger().error(answer.message)
        else:
            self.node.get_logger().info(answer.message)

    def now(self) -> int:
        """Return the present machine time [ns]."""
        return self._clock_now() if self._steady is None else self._steady.now()

    def _clock_now(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def follow_clock(self) -> None:
        """Begin a new series of stamps where the clock has been set."""
        step = 0 if self.settings.lockstep or self._steady is None else self._steady.step()
        if not step:
            return
        text = f'the clock stepped by {step / SECOND:.9g} s'
        event = event_record(self.component, self.merger.time, CLOCK_STEP, {'step': step})
        self._send('node_event', event)
        self.node.get_logger().error(f'{text}; a new series of stamps begins')
        self._notice('clock', f'{text}; what was known by stamps from before is forgotten')
        before = self.component
        self.component, emissions = before.renewed(step)
        self.merger = Merger(self.component, time=self.now())
        self.publish(emissions)
        anew = self.component is not before and self.component.MANAGED
        if anew and self._lifecycle_state == 'active':
            self.request('activate', {})
        self.announce()

    def on_poll(self) -> None:
        """Real time, from time to time: fire a deadline that no input has fired."""
        self.follow_clock()
        deadline = self.component.next_deadline
        if deadline is None or deadline > self.now():
            return
        self.work(deadline)
        self.note_deadline(deadline)

    def note_deadline(self, stamp: int) -> None:
        """Write down for replay that the component worked up to a stamp [ns] without an input."""
        record = DeadlineFired(
            stamp=stamp,
            frame_id=self.component.frame('machine'),
            node=self.node.get_name(),
        )
        self._deadlines.publish(encode(record, RCLPY))

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Take live parameters; what it refuses stays as it was."""
        try:
            config = changed(self.component.configuration, parameters)
            self.component.reconfigure(config)
        except ValueError as error:
            return refusal(str(error))
        self.announce()
        return SetParametersResult(successful=True)

    def _open_state(self, path: str) -> StateDirectory:
        try:
            return StateDirectory(path, self.node.get_fully_qualified_name())
        except StateFileError as error:
            raise ParameterError(str(error)) from error

    def _restore(self) -> None:
        """Hand persistent records of an earlier life to the component and publish them again."""
        for item in self.component.OUTPUTS:
            if not item.persistent:
                continue
            try:
                record = self._state.load(item)
            except StateFileError as error:
                self.troubles['state'] = str(error)
                self.node.get_logger().error(str(error))
                continue
            if record is not None:
                self.component.restore(item.name, record)
                self._send(item.name, record)

    def _save(self, item: Output, record: Record) -> None:
        try:
            self._state.save(item, record)
        except StateFileError as error:
            if 'state' not in self.troubles:
                self.node.get_logger().error(str(error))
            self.troubles['state'] = str(error)
        else:
            self.troubles.pop('state', None)
