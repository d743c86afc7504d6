# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Actions of the live page at a machine, by the services that nodes offer anyway.

None of it moves an axis or raises a limit.  Callers are coroutines of another thread: what touches
ROS is done in the thread of the node, and nobody waits for it there.
"""

import asyncio
import os
import re
import subprocess
import time
from collections import deque
from collections.abc import Callable, Coroutine, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from itertools import chain, count
from math import nan
from pathlib import Path
from typing import Any, TypeVar

from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.duration import Duration
from rclpy.node import Node

from fuzzycnc_msgs.srv import ForgetThermalPosterior, SetThermalReference
from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.bags.recording_loss import loss
from fuzzycnc_ros.components.dashboard.machine_view import MachineView
from fuzzycnc_ros.core.names import file_word, visible
from fuzzycnc_ros.graph.bring_up import RECORDER_STOP
from fuzzycnc_ros.ros.lifecycle import REACHED
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.ros.probing import check_unprobed, probe_record
from fuzzycnc_ros.ros.processes import child_set_up
from fuzzycnc_ros.ros.recording import is_recorded, recorder_command
from fuzzycnc_ros.ros.topics import RCLPY, create_publisher
from fuzzycnc_ros.runtime.component import HISTORY, STREAM
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.enums import ForgetMode
from fuzzycnc_ros.runtime.host import FINALIZED, WAS_FINALIZED, NodeEvent
from fuzzycnc_ros.runtime.provenance import machine_event

T = TypeVar('T')

Carry = Callable[[MachineView, Mapping[str, Any], str], Coroutine[Any, Any, str]]
"""Carries out an action at a machine, told what was sent and by whom; returns what was done."""

PATIENCE = 6.0
"""Wall time [s] until a node must be found."""
ANSWERED = 10.0
"""Wall time [s] until it must have answered."""
TAKEN_UP = 10.0
"""The same for what the thread of the page's own node is to do."""
CARRIED_OUT = 90.0
"""The same for an action as a whole: longer than all of its waits together."""
ASKED = 3
"""Attempts in that time of a question that may be asked twice: a busy node drops the answer to a
caller that it has not found yet."""
BEGUN = 30.0
"""Wall time [s] until a recorder must listen, also on a busy computer."""
SETTLED = 0.5
"""Wall time [s] in which the readers of a new topic are found."""
POLL = 0.02
ACTIVATED = ('compensator',)
"""Nodes that the page may activate: others move axes."""
NAME_MAX = 80
"""Longest name of a person [characters]."""
WHY_MAX = 200
"""Longest reason [characters]."""
LENGTH_MAX = 1e-2
"""Largest displacement that a probe may tell [m]."""
_AXES = re.compile('[XYZABCUVW]')


async def _in_time(work: 'Future[T]', trouble: str) -> T:
    """Wait for what another thread does, but for no longer than `TAKEN_UP`.

    Raises
    ------
    GraphError
        If it is not done in time; it is left out if it has not begun by then.
    """
    try:
        return await asyncio.wait_for(asyncio.wrap_future(work), TAKEN_UP)
    except asyncio.TimeoutError:
        raise GraphError(trouble) from None


class NodeThread:
    """Have things done in the thread of a node."""

    def __init__(self, node: Node) -> None:
        self._jobs: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._guard = node.create_guard_condition(self._work)

    def ask(self, job: Callable[[], T]) -> 'Future[T]':
        """Have a job done; return what it will return."""
        future: Future[T] = Future()
        self._jobs.append((job, future))
        self._guard.trigger()
        return future

    async def do(self, job: Callable[[], T]) -> T:
        """Have a job done, and wait for it.

        Raises
        ------
        GraphError
            If it is not done in time; it is left out if it has not begun by then.
        """
        return await _in_time(
            self.ask(job),
            f'dashboard itself did not get to it within {TAKEN_UP:g} s; try again, or use '
            'fuzzycnc operate, and start the page anew if that goes on',
        )

    def _work(self) -> None:
        while self._jobs:
            job, future = self._jobs.popleft()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(job())
            except Exception as error:  # it is raised where the result is waited for
                future.set_exception(error)


class Actions:
    """Carry out what is asked for on the page.

    Parameters
    ----------
    node : Node
        The node that acts.
    bags : Path, optional
        Folder of new bags.
    """

    def __init__(self, node: Node, bags: Path | None) -> None:
        self._node, self._bags = node, bags
        self.thread = NodeThread(node)
        self._events: dict[str, Any] = {}
        self._recorders: dict[str, tuple[subprocess.Popen[bytes], Path]] = {}
        self._busy: dict[str, tuple[str, asyncio.Event]] = {}
        """Machines at which an action is under way, which one, and what tells its end."""
        self._off: set[str] = set()
        """Machines that are being deactivated while an activation is under way."""
        # Forking took forever once in hundreds of times: that must not hold up the node.  The
        # kernel ends a process when the thread that started it is gone, so it is always this one.
        self._starter = ThreadPoolExecutor(1, thread_name_prefix='recorders')
        self._carry: dict[str, Carry] = {
            'reference': self._reference,
            'activate': self._activate,
            'deactivate': self._deactivate,
            'probe': self._probe,
            'forget': self._forget,
            'record': self._record,
        }

    def join(self, machine: str) -> None:
        """Get ready to write down what is done at a machine, so that its recorder hears of it."""
        self._events[machine] = create_publisher(
            self._node, NodeEvent.TYPE, f'/{machine}/node_event', HISTORY
        )

    def leave(self, machine: str) -> None:
        """Let go of a machine."""
        self._node.destroy_publisher(self._events.pop(machine))

    def recording(self, machine: str) -> str | None:
        """Return the bag that is recorded of a machine from here, None if none is."""
        process, bag = self._recorders.get(machine, (None, Path()))
        if process is not None and process.poll() is not None:
            del self._recorders[machine]
            return None
        return None if process is None else bag.name

    def close(self) -> list[str]:
        """Ask all recorders to end, and wait until their bags are whole, but not for long.

        A recorder that takes longer goes on without its page, and ends when its bag is whole:
        killed, it would lose what it had yet to write.

        Returns
        -------
        list of str
            Which recorders go on, which failed, and what is missing in bags.
        """
        for process, _ in self._recorders.values():
            process.terminate()
        until = time.monotonic() + RECORDER_STOP
        told = []
        for process, bag in self._recorders.values():
            try:
                process.wait(max(0.0, until - time.monotonic()))
                told.append(_trouble(process, bag))
            except subprocess.TimeoutExpired:
                told.append(
                    f'{bag.name} is not closed after {RECORDER_STOP:g} s; its recorder, process '
                    f'{process.pid}, goes on and ends when it has written all'
                )
        self._recorders.clear()
        return [text for text in told if text]

    async def act(self, view: MachineView, action: str, body: Mapping[str, Any]) -> str:
        """Carry an action out and write it down; return what was done.

        Raises
        ------
        GraphError
            If it is not carried out; the text says why and what to do.
        """
        by = body.get('by') or 'page'
        if not isinstance(by, str) or len(by) > NAME_MAX:
            raise GraphError(f'by: expected a name of at most {NAME_MAX} characters')
        work = self._carry[action](view, body, by)
        if action == 'deactivate':
            says = await self._within(work, view.machine, action)
        else:
            says = await self._alone(work, view.machine, action)
        request = {**body, 'by': by, 'says': says}
        await self.thread.do(lambda: self._write_down(view, action, request))
        return says

    async def _alone(self, work: Coroutine[Any, Any, str], machine: str, action: str) -> str:
        """Carry out an action while no other is under way at its machine.

        Raises
        ------
        GraphError
            If one is, or the action is not carried out.
        """
        if machine in self._busy:
            work.close()
            raise GraphError(f'{machine}: another action is under way; wait for its end')
        ended = asyncio.Event()
        self._busy[machine] = action, ended
        try:
            return await self._within(work, machine, action)
        finally:
            del self._busy[machine]
            self._off.discard(machine)
            ended.set()

    async def _within(self, work: Coroutine[Any, Any, str], machine: str, action: str) -> str:
        """Carry out an action, but for no longer than `CARRIED_OUT`.

        Raises
        ------
        GraphError
            If it is not carried out.
        """
        try:
            return await asyncio.wait_for(work, CARRIED_OUT)
        except asyncio.TimeoutError:
            raise GraphError(
                f'{machine}: {action} did not end within {CARRIED_OUT:g} s; look at the log of '
                'dashboard, and at the state of the machine before you try again'
            ) from None

    def _write_down(self, view: MachineView, action: str, request: Mapping[str, Any]) -> None:
        """Publish what was done, by whom: so it is in the bag."""
        node = self._node.get_name()
        event = machine_event(view.machine, node, view.stamp or 0, action, request)
        self._events[view.machine].publish(encode(event, RCLPY))

    async def _reference(self, view: MachineView, body: Mapping[str, Any], by: str) -> str:
        force = body.get('force', False)
        if not isinstance(force, bool):
            raise GraphError(f'force: expected true or false but found {force!r}')
        request = SetThermalReference.Request(set_by=by, force=force)
        name = f'/{view.machine}/set_thermal_reference'
        answer = await self._call(SetThermalReference, name, request, times=ASKED)
        if answer.success:
            return str(answer.message)
        told = (view.newest('compensation_applied'), view.newest('compensation'))
        if not force and any(record is not None and record.offset.any() for record in told):
            raise NeedsForceError(str(answer.message))
        raise GraphError(str(answer.message))

    async def _activate(self, view: MachineView, body: Mapping[str, Any], by: str) -> str:
        node = body.get('node', ACTIVATED[0])
        if node not in ACTIVATED:
            raise GraphError(
                f'node: expected {", ".join(ACTIVATED)}: what moves axes is activated beside the '
                'machine, with fuzzycnc operate activate'
            )
        state = await self._lifecycle(view, node)
        if state == 'active':
            return f'{node} is active already'
        if state == FINALIZED:
            raise GraphError(f'{node} {WAS_FINALIZED}')
        if state == 'unconfigured':
            await self._transition(view, node, 'configure')
        if view.machine in self._off:
            raise GraphError(f'{node} is being deactivated; activate it again after that')
        await self._transition(view, node, 'activate')
        return f'{node} is active'

    async def _deactivate(self, view: MachineView, body: Mapping[str, Any], by: str) -> str:
        node = body.get('node', ACTIVATED[0])
        if not isinstance(node, str) or node not in view.nodes:
            raise GraphError(f'node: expected one of {", ".join(sorted(view.nodes))}')
        action, ended = self._busy.get(view.machine, ('', asyncio.Event()))
        if action == 'activate':
            # It is refused for nothing; but an activation that comes behind it would undo it.
            self._off.add(view.machine)
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(ended.wait(), ANSWERED)
        activating = action == 'activate' and not ended.is_set()
        if not activating and await self._lifecycle(view, node) != 'active':
            return f'{node} is not active'
        await self._transition(view, node, 'deactivate')
        return f'{node} is inactive and goes on until it is at rest'

    async def _lifecycle(self, view: MachineView, node: str) -> str:
        name = f'/{view.machine}/{node}/get_state'
        answer = await self._call(GetState, name, GetState.Request(), times=ASKED)
        return str(answer.current_state.label)

    async def _transition(self, view: MachineView, node: str, label: str) -> None:
        request = ChangeState.Request()
        request.transition.label = label
        try:
            answer = await self._call(ChangeState, f'/{view.machine}/{node}/change_state', request)
            if not answer.success:
                raise GraphError(
                    f'{node} refuses to {label}; its alarms and its log say why; mend that, then '
                    'try again'
                )
        except GraphError:
            # Perhaps only the answer is lost, and to ask twice would not do; or somebody else has
            # asked for the same a moment before.
            if await self._lifecycle(view, node) != REACHED[label]:
                raise

    async def _forget(self, view: MachineView, body: Mapping[str, Any], by: str) -> str:
        why, mode = body.get('why'), body.get('mode')
        if not isinstance(why, str) or not why.strip() or len(why) > WHY_MAX:
            raise GraphError(f'why: expected a reason of at most {WHY_MAX} characters')
        known = {item.name.lower(): item for item in ForgetMode}
        if not isinstance(mode, str) or mode not in known:
            raise GraphError(f'mode: expected one of {", ".join(known)} but found {mode!r}')
        request = ForgetThermalPosterior.Request(
            mode=int(known[mode]), why=visible(why), by=visible(by)
        )
        # Not asked twice: to go back before a probe twice would not do.
        name = f'/{view.machine}/forget_thermal_posterior'
        answer = await self._call(ForgetThermalPosterior, name, request)
        if not answer.success:
            raise GraphError(str(answer.message))
        return str(answer.message)

    async def _probe(self, view: MachineView, body: Mapping[str, Any], by: str) -> str:
        machine = view.machine
        values = _displacements(body.get('values'))
        deviation = body.get('deviation')
        if deviation is None:
            spread = nan
        elif _is_length(deviation) and deviation > 0.0:
            spread = float(deviation)
        else:
            raise GraphError(f'deviation: expected metres above 0 but found {deviation!r}')
        await self.thread.do(
            lambda: check_unprobed(
                machine,
                lambda topic: (
                    self._node.count_publishers(
                        topic if topic.startswith('/') else f'/{machine}/{topic}'
                    )
                    > 0
                ),
            )
        )
        applied = view.newest('compensation_applied')
        compensated = applied is not None and bool(applied.offset.any())
        record = probe_record(machine, values, spread, compensated=compensated)
        publisher = await self.thread.do(
            lambda: create_publisher(self._node, record.TYPE, f'/{machine}/displacement', STREAM)
        )
        try:
            # The page itself reads it too, which is no reason to say that somebody does.
            await self._until(
                lambda: publisher.get_subscription_count() > 1,
                f'{machine}: no node takes a probe; start a recorder or the predictor',
            )
            await asyncio.sleep(SETTLED)
            readers = publisher.get_subscription_count() - 1
            await self.thread.do(lambda: publisher.publish(encode(record, RCLPY)))
            await self._until(
                lambda: bool(publisher.wait_for_all_acked(Duration())),
                f'{machine}: not all nodes that use probes have confirmed this one; look whether '
                'one hangs, and in the recording whether it is there',
            )
        finally:
            await self.thread.do(lambda: self._node.destroy_publisher(publisher))
        named = ', '.join(f'{axis} {1e6 * value:+.2f} µm' for axis, value in values.items())
        force = 'with' if compensated else 'without'
        return f'{named} told to {readers} nodes, {force} compensation in force'

    async def _record(self, view: MachineView, body: Mapping[str, Any], by: str) -> str:
        start = body.get('start')
        if not isinstance(start, bool):
            raise GraphError(f'start: expected true or false but found {start!r}')
        machine = view.machine
        if not start:
            return await self._stop_recorder(machine)
        if self._bags is None:
            raise GraphError('expected a folder for bags; set the parameter bags of dashboard')
        recorded = f'{machine} is recorded already; stop that recording first'
        if self.recording(machine) is not None:
            raise GraphError(recorded)
        # A recorder that has just ended is told of for a moment longer.
        await self._until(lambda: 'recorder' not in view.living_nodes, recorded, PATIENCE)
        bag = _new_bag(self._bags, machine, time.time())
        process = await _in_time(
            self._starter.submit(self._start_recorder, machine, bag),
            f'no recorder was started within {TAKEN_UP:g} s; look at the log of dashboard',
        )
        # It records once it listens: what is done before that would be missing in the bag.
        await self._until(
            lambda: is_recorded(self._node, machine) or process.poll() is not None,
            f'the recorder did not begin {bag.name}; look at the log of dashboard',
            BEGUN,
        )
        if process.poll() is not None:
            raise GraphError(f'the recorder ended with code {process.returncode}; see its log')
        return f'recording to {bag.name}'

    def _start_recorder(self, machine: str, bag: Path) -> subprocess.Popen[bytes]:
        bag.parent.mkdir(parents=True, exist_ok=True)
        process = subprocess.Popen(
            recorder_command(bag.absolute(), machine),
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=child_set_up(),
            env={**os.environ},
        )
        self._recorders[machine] = process, bag
        return process

    async def _stop_recorder(self, machine: str) -> str:
        process, bag = self._recorders.get(machine, (None, Path()))
        if process is None or process.poll() is not None:
            raise GraphError(
                f'{machine}: no recording was started here; end others where they were started'
            )
        process.terminate()
        await self._until(
            lambda: process.poll() is not None,
            f'{bag.name} is not closed yet; it is, when the recorder has written all',
            RECORDER_STOP,
        )
        self._recorders.pop(machine, None)  # whoever has asked meanwhile has noticed its end
        if trouble := await asyncio.to_thread(_trouble, process, bag):
            raise GraphError(trouble)
        return f'{bag.name} is closed'

    async def _call(self, kind: Any, name: str, request: Any, *, times: int = 1) -> Any:
        """Call a service, up to so many times, and return its answer.

        Raises
        ------
        GraphError
            If nobody offers it, or answers in time.
        """
        client = await self.thread.do(lambda: self._node.create_client(kind, name))
        calls: list[asyncio.Future[Any]] = []
        try:
            await self._until(
                client.service_is_ready, f'{name} is not offered; start the node that offers it'
            )
            for _ in range(times):
                calls.append(asyncio.wrap_future(await self._begin(client, request)))
                done, _ = await asyncio.wait(
                    calls, timeout=ANSWERED / times, return_when=asyncio.FIRST_COMPLETED
                )
                if done:
                    return done.pop().result()
            raise GraphError(
                f'{name} did not answer within {ANSWERED:g} s; look whether its node hangs'
            )
        finally:
            for call in calls:
                call.cancel()
            await self.thread.do(lambda: self._node.destroy_client(client))

    async def _begin(self, client: Any, request: Any) -> 'Future[Any]':
        """Begin a call; return what will be its answer."""
        answer: Future[Any] = Future()

        def done(future: Any) -> None:
            # Else the one who waits, in another thread, has given it up.
            if answer.set_running_or_notify_cancel():
                answer.set_result(future.result())

        await self.thread.do(lambda: client.call_async(request).add_done_callback(done))
        return answer

    async def _until(
        self, condition: Callable[[], bool], trouble: str, patience: float = PATIENCE
    ) -> None:
        """Wait for a condition, which is looked at in the thread of the node.

        Raises
        ------
        GraphError
            If it does not come true in time.
        """
        until = time.monotonic() + patience
        while not await self.thread.do(condition):
            if time.monotonic() > until:
                raise GraphError(trouble)
            await asyncio.sleep(POLL)


class NeedsForceError(GraphError):
    """It would be done if it were forced; the text says what that would do."""


def _new_bag(folder: Path, machine: str, now: float) -> Path:
    """Return a bag named after machine and time [s] to the millisecond that is not there yet."""
    second = time.strftime('%Y%m%d_%H%M%S', time.gmtime(now))
    name = f'{file_word(machine)}_{second}_{int(1e3 * (now % 1.0)):03d}'
    numbers = (f'{name}_{number}' for number in count(2))
    return next(folder / n for n in chain([name], numbers) if not (folder / n).exists())


def _trouble(process: 'subprocess.Popen[bytes]', bag: Path) -> str:
    """Return in words that a recorder has failed, or what its bag lacks; empty if all is well."""
    if process.returncode:
        return (
            f'the recorder of {bag.name} ended with code {process.returncode}; make the bag whole '
            'with fuzzycnc info --repair'
        )
    try:
        return loss(bag)
    except BagError as error:
        return str(error)


def _is_length(value: Any) -> bool:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and abs(value) <= LENGTH_MAX  # what is not finite is not below it


def _displacements(values: Any) -> dict[str, float]:
    """Return what a probe tells [m] by axis.

    Raises
    ------
    GraphError
        If it is nothing, or of no use.
    """
    if not isinstance(values, dict) or not values:
        raise GraphError('values: expected displacements in metres by axis, such as {"Y": 3e-6}')
    for axis, value in values.items():
        if not _AXES.fullmatch(axis):
            raise GraphError(f'values: expected axes X to Z, A to C or U to W but found {axis!r}')
        if not _is_length(value):
            raise GraphError(
                f'values: expected at most {1e3 * LENGTH_MAX:g} mm for {axis}, given in metres, '
                f'but found {value!r}'
            )
    return {axis: float(value) for axis, value in values.items()}
