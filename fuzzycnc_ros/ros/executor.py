# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A single-threaded executor that keeps its wait set while the entities of its nodes stay.

rclpy's own asks every entity of every node, and builds a wait set and a coroutine, for each
message: in a lock-step run that was more than half of what a node did.
"""

import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from inspect import iscoroutinefunction
from math import inf
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.waitable import NumberOfEntities

_KINDS = {
    'timers': 'timer',
    'subscriptions': 'subscription',
    'guards': 'guard_condition',
    'clients': 'client',
    'services': 'service',
}
"""Entities of a node, in the order in which they are served, with their names in a wait set."""


PATROL = 0.02
"""Wall time [s] after which clients, services and waitables are looked at, while messages come."""


class _Entities:
    """A wait set and what is waited for with it.

    Parameters
    ----------
    context : Context
        The context of all of it.
    added : list of (str, handle)
        Kind and handle of each entity.
    waitables : list of (Waitable, callable)
        Waitables, and what is done when one is ready.
    """

    def __init__(
        self,
        context: Context,
        added: list[tuple[str, Any]],
        waitables: list[tuple[Any, Callable[[], object]]],
    ) -> None:
        counts = NumberOfEntities()
        for waitable, _ in waitables:
            counts += waitable.get_num_entities()
        number = Counter(kind for kind, _ in added)
        self._set = _rclpy.WaitSet(
            number['subscription'] + counts.num_subscriptions,
            number['guard_condition'] + counts.num_guard_conditions,
            number['timer'] + counts.num_timers,
            number['client'] + counts.num_clients,
            number['service'] + counts.num_services,
            counts.num_events,
            context.handle,
        )
        self._kinds = [kind for kind in _KINDS.values() if number[kind]]
        self._added = [(getattr(self._set, f'add_{kind}'), handle) for kind, handle in added]
        self._waitables = waitables

    def wait(self, timeout: int) -> tuple[set[int], list[Callable[[], object]]]:
        """Wait [ns]; return the pointers of ready entities, and what is to be done for waitables.

        A timeout below 0 is none.
        """
        self._set.clear_entities()
        for add, handle in self._added:
            add(handle)
        for waitable, _ in self._waitables:
            waitable.add_to_wait_set(self._set)
        self._set.wait(timeout)
        found: set[int] = set()
        for kind in self._kinds:
            found.update(self._set.get_ready_entities(kind))
        return found, [work for waitable, work in self._waitables if waitable.is_ready(self._set)]


class LeanExecutor(SingleThreadedExecutor):
    """Do what rclpy's `SingleThreadedExecutor` does, in less time.

    Callbacks run one at a time: all that was ready after a wait, before the next wait; of that,
    node by node, timers before subscriptions before clients and services.  Coroutines, actions
    and guard conditions are left to the base class, and so is everything while a coroutine
    waits.

    Parameters
    ----------
    context : Context, optional
        The default one if absent.
    """

    _tasks: list[Any]

    def __init__(self, *, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._stale = True
        self._held = ExitStack()
        self._sets: tuple[_Entities, _Entities] | None = None
        self._served: list[tuple[int, bool, Callable[[], object]]] = []
        self._ready: deque[Callable[[], object]] = deque()
        self._waiting = False
        self._busy = False
        """True if a message came in the last wait: others are likely to follow soon."""
        self._round_at = 0.0
        """Time of the next look at everything, while messages follow one another [s]."""

    def add_node(self, node: Node) -> bool:
        """Add a node whose callbacks are executed here; False if it was there already."""
        self._stale = True
        return bool(super().add_node(node))

    def remove_node(self, node: Node) -> None:
        """Execute the callbacks of a node no more."""
        self._stale = True
        super().remove_node(node)

    def wake(self) -> None:
        """End a wait: an entity was made or destroyed, or a future is done."""
        self._stale = True
        super().wake()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Execute nothing more."""
        ended = bool(super().shutdown(timeout_sec))
        self._ready.clear()
        if not self._waiting:  # else the thread that waits lets go
            self._let_go()
        return ended

    def _spin_once_impl(
        self,
        timeout_sec: Any = None,
        wait_condition: Callable[[], bool] = lambda: False,
    ) -> None:
        if self._coroutines_wait():
            if not self._stale:
                self._let_go()
            super()._spin_once_impl(timeout_sec, wait_condition)
            return
        if not self._ready:
            # A `TimeoutObject` where it waits for a future.
            self._wait(getattr(timeout_sec, 'timeout', timeout_sec), wait_condition)
        if self._ready:
            self._ready.popleft()()

    def _coroutines_wait(self) -> bool:
        if not self._tasks:
            return False
        with self._tasks_lock:
            self._tasks = [item for item in self._tasks if not item[0].done()]
        return bool(self._tasks)

    def _wait(self, timeout: float | None, condition: Callable[[], bool]) -> None:
        """Wait until something is ready, the timeout [s] is over or the condition holds."""
        now = time.monotonic()
        end = inf if timeout is None or timeout < 0.0 else now + timeout
        while not (self._ready or self._is_shutdown or condition()):
            every, often = self._gather() if self._sets is None or self._stale else self._sets
            if self._busy and now < self._round_at:
                self._busy = self._look(often, min(end, now + PATROL))
            else:
                heard = self._look(every, now if self._busy else end)
                self._busy = self._busy or heard
                self._round_at = time.monotonic() + PATROL
            now = time.monotonic()
            if now >= end:
                return

    def _look(self, entities: '_Entities', end: float) -> bool:
        """Wait for some entities until a time [s]; return whether a message has come.

        Raises
        ------
        ExternalShutdownException
            If the context was shut down.
        """
        left = -1 if end == inf else max(0, int(1e9 * (end - time.monotonic())))
        self._waiting = True
        try:
            found, waitables = entities.wait(left)
        finally:
            self._waiting = False
        if self._is_shutdown:
            self._let_go()
            return False
        if not self._context.ok():
            raise ExternalShutdownException
        self._ready.extend(waitables)
        heard = False
        for pointer, often, work in self._served:
            if pointer in found:
                self._ready.append(work)
                heard = heard or often
        return heard

    def _gather(self) -> tuple[_Entities, _Entities]:
        """Build the wait sets of all that the nodes have now, and of what is looked at often."""
        self._let_go()
        self._stale = False
        self._cb_iter = None  # what the base class found ready, and left, is found again
        hold = self._held.enter_context
        hold(self._context.handle)
        added: list[tuple[str, Any]] = []
        waitables: list[tuple[Any, Callable[[], object]]] = []
        for node in self.get_nodes():
            for kind, name in _KINDS.items():
                for entity in list(getattr(node, kind)):
                    if kind == 'guards' and entity._executor_triggered:
                        entity.trigger()
                    try:
                        hold(entity.handle)
                    except InvalidHandle:
                        continue  # destroyed meanwhile
                    added.append((name, entity.handle))
                    work = self._work(name, entity, node)
                    self._served.append((entity.handle.pointer, name == 'subscription', work))
            for waitable in node.waitables:
                try:
                    hold(waitable)
                except InvalidHandle:
                    continue
                work = partial(self._execute, self._take_waitable, waitable, node)
                waitables.append((waitable, work))
        for guard in (self._guard, self._sigint_gc):
            hold(guard.handle)
            added.append(('guard_condition', guard.handle))
        often = [item for item in added if item[0] not in ('client', 'service')]
        self._sets = (
            _Entities(self._context, added, waitables),
            _Entities(self._context, often, []),
        )
        return self._sets

    def _let_go(self) -> None:
        """Let go of the entities, so that those that were destroyed meanwhile end."""
        self._stale = True
        self._sets = None
        self._served = []
        self._held.close()

    def _work(self, name: str, entity: Any, node: Node) -> Callable[[], object]:
        """Return what is done when an entity is ready."""
        if name == 'guard_condition':
            return partial(self._execute, self._take_guard_condition, entity, node)
        if name == 'client':
            return partial(self._execute, self._take_client, entity, node)
        if name == 'service':
            return partial(self._execute, self._take_service, entity, node)
        take = self._take_timer if name == 'timer' else self._take_subscription
        if iscoroutinefunction(entity.callback):
            return partial(self._execute, take, entity, node)
        return partial(_call_timer if name == 'timer' else _call_subscription, entity)

    def _execute(self, take: Callable[[Any], Any], entity: Any, node: Node) -> None:
        """Serve an entity as the base class does; what it raises comes through."""
        task = self._make_handler(entity, node, take)
        task()
        if task.done():
            task.result()


def _call_timer(timer: Any) -> None:
    try:
        with timer.handle:
            if not timer.handle.is_timer_ready():
                return  # cancelled, or put off, since the wait
            timer.handle.call_timer()
    except InvalidHandle:
        return
    timer.callback()


def _call_subscription(subscription: Any) -> bool:
    """Hand over the next message of a subscription; return whether there was one."""
    try:
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    except InvalidHandle:
        return False
    if taken is None:
        return False
    if subscription._callback_type is Subscription.CallbackType.MessageOnly:
        subscription.callback(taken[0])
    else:
        subscription.callback(*taken)
    return True


def hand_over(subscription: Any, most: int) -> None:
    """Hand over what a subscription already holds; the context may have ended.

    Parameters
    ----------
    subscription : rclpy.subscription.Subscription
        Of a node that no executor calls any more.
    most : int
        Messages that are handed over at most, so that those who publish on do not hold up the end.
    """
    for _ in range(most):
        if not _call_subscription(subscription):
            return
