# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The lean executor does what rclpy's does: each test runs on both."""

import linecache
import sys
import threading
import time

import pytest

pytest.importorskip('rclpy')

import rclpy
from processes import wait_for
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_msgs.msg import Int64
from std_srvs.srv import Trigger

from fuzzycnc_ros.cli.live.free_domain import own_domain
from fuzzycnc_ros.ros.executor import PATROL, LeanExecutor

pytestmark = pytest.mark.ros
PATIENCE = 60.0


class Bench:
    """A node with its executor in a context of its own."""

    def __init__(self, kind):
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node('bench', context=self.context)
        self.executor = kind(context=self.context)
        self.executor.add_node(self.node)
        self.heard = []

    def talk(self, topic='topic', depth=100, callback=None):
        """Return a publisher that a subscription of the same node hears."""
        qos = QoSProfile(depth=depth)
        publisher = self.node.create_publisher(Int64, topic, qos)
        hear = callback or (lambda message: self.heard.append(message.data))
        subscription = self.node.create_subscription(Int64, topic, hear, qos)
        self.until(lambda: publisher.get_subscription_count() == 1)
        return publisher, subscription

    def until(self, condition, patience=PATIENCE):
        end = time.monotonic() + patience
        while not condition():
            self.executor.spin_once(0.05)
            assert time.monotonic() < end

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture(params=[SingleThreadedExecutor, LeanExecutor], ids=['rclpy', 'lean'])
def bench(request):
    own_domain()
    bench = Bench(request.param)
    yield bench
    bench.close()


def sent(publisher, *values):
    for value in values:
        publisher.publish(Int64(data=value))


def test_messages_come_in_order(bench):
    publisher, _ = bench.talk()
    sent(publisher, *range(100))
    bench.until(lambda: len(bench.heard) == 100)
    assert bench.heard == list(range(100))


def test_one_callback_a_spin(bench):
    publisher, _ = bench.talk()
    other, _ = bench.talk('other')
    sent(publisher, 1, 2)
    sent(other, 3, 4)
    time.sleep(0.2)  # all of them are there
    counts = []
    while len(bench.heard) < 4:
        before = len(bench.heard)
        bench.executor.spin_once(1.0)
        counts.append(len(bench.heard) - before)
    assert max(counts) == 1
    assert [v for v in bench.heard if v < 3] == [1, 2]


def test_timers_come_before_messages(bench):
    publisher, _ = bench.talk()
    order = []
    bench.node.create_timer(0.01, lambda: order.append('timer'))
    bench.node.create_subscription(Int64, 'topic', lambda message: order.append('message'), 10)
    bench.until(lambda: publisher.get_subscription_count() == 2)
    sent(publisher, 1)
    time.sleep(0.2)  # both are ready
    order.clear()
    bench.until(lambda: 'message' in order)
    assert order[0] == 'timer'


def test_a_timeout_is_kept(bench):
    for timeout in (0.0, 0.1):
        began = time.monotonic()
        bench.executor.spin_once(timeout)
        bench.executor.spin_once(timeout)
        assert time.monotonic() - began >= timeout
    began = time.monotonic()
    for _ in range(20):
        bench.executor.spin_once(0.0)
    assert time.monotonic() - began < PATIENCE


def test_a_timer_that_is_cancelled_or_reset(bench):
    told = []
    timer = bench.node.create_timer(0.01, lambda: told.append(len(told)))
    bench.until(lambda: len(told) >= 3)
    timer.cancel()
    count = len(told)
    for _ in range(5):
        bench.executor.spin_once(0.02)
    assert len(told) == count
    timer.reset()
    bench.until(lambda: len(told) > count)


def test_services_are_served_while_messages_follow_one_another(bench):
    """Each message sends the next, so that there is always one."""
    publisher = None

    def again(message):
        bench.heard.append(message.data)
        publisher.publish(message)

    publisher, _ = bench.talk(callback=again)
    bench.node.create_service(Trigger, 'trigger', lambda request, answer: answered(answer))
    client = bench.node.create_client(Trigger, 'trigger')
    bench.until(client.service_is_ready)
    sent(publisher, 7)
    bench.until(lambda: len(bench.heard) > 20)
    for _ in range(3):
        future = client.call_async(Trigger.Request())
        bench.until(future.done)
        assert future.result().message == 'heard'
    count = len(bench.heard)
    bench.until(lambda: len(bench.heard) > count)


def answered(answer):
    answer.success, answer.message = True, 'heard'
    return answer


def test_entities_come_and_go(bench):
    for number in range(5):
        publisher, subscription = bench.talk(f'topic_{number}')
        sent(publisher, number)
        bench.until(lambda number=number: bench.heard[-1:] == [number])
        assert bench.node.destroy_subscription(subscription)
        bench.until(lambda publisher=publisher: publisher.get_subscription_count() == 0)
        sent(publisher, -1)
        bench.executor.spin_once(0.05)
    assert bench.heard == list(range(5))


def test_what_a_callback_destroys_is_not_called(bench):
    publisher, _ = bench.talk()

    def first(message):
        bench.heard.append('first')
        for item in others:
            bench.node.destroy_subscription(item)
        others.clear()

    bench.node.create_subscription(Int64, 'topic', first, 10)
    others = [
        bench.node.create_subscription(
            Int64, 'topic', lambda message: bench.heard.append('other'), 10
        )
    ]
    bench.until(lambda: publisher.get_subscription_count() == 3)
    sent(publisher, 1)
    bench.until(lambda: 'first' in bench.heard)
    for _ in range(5):
        bench.executor.spin_once(0.02)
    sent(publisher, 2)
    bench.until(lambda: bench.heard.count('first') == 2)
    assert bench.heard.count('other') == 0


def test_what_a_callback_raises_comes_through_once(bench):
    def fails(message):
        bench.heard.append(message.data)
        raise ValueError(f'message {message.data}')

    publisher, _ = bench.talk(callback=fails)
    sent(publisher, 1, 2)
    for number in (1, 2):
        with pytest.raises(ValueError, match=f'message {number}'):
            bench.until(lambda: False)
    timer = bench.node.create_timer(0.01, lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        bench.until(lambda: False)
    timer.cancel()
    assert bench.heard == [1, 2]


def test_coroutines_wait_without_stopping_the_rest(bench):
    future = Future(executor=bench.executor)
    done = []

    async def waits(message):
        done.append(await future)

    publisher, _ = bench.talk('slow', callback=waits)
    other, _ = bench.talk()
    # A coroutine keeps its callback group busy, so the other topic is in a group of its own.
    group = rclpy.callback_groups.ReentrantCallbackGroup()
    bench.node.create_subscription(
        Int64, 'topic', lambda message: bench.heard.append('free'), 10, callback_group=group
    )
    bench.until(lambda: other.get_subscription_count() == 2)
    sent(publisher, 1)
    for _ in range(5):
        bench.executor.spin_once(0.02)
    sent(other, 2)
    bench.until(lambda: 'free' in bench.heard)
    assert not done
    threading.Timer(0.05, lambda: future.set_result('result')).start()
    bench.until(lambda: bool(done))
    assert done == ['result']
    bench.until(lambda: 2 in bench.heard)
    sent(other, 3)
    bench.until(lambda: 3 in bench.heard)


def test_a_future_ends_a_spin(bench):
    future = Future(executor=bench.executor)
    threading.Timer(0.1, lambda: future.set_result(None)).start()
    bench.executor.spin_until_future_complete(future, PATIENCE)
    assert future.done()


def test_tasks_are_done(bench):
    task = bench.executor.create_task(lambda: 'done')
    bench.until(task.done)
    assert task.result() == 'done'


def test_nothing_is_called_after_a_shutdown(bench):
    publisher, _ = bench.talk()
    other, _ = bench.talk('other')
    sent(publisher, 1)
    sent(other, 2)
    time.sleep(0.2)  # both are ready at once
    bench.until(lambda: bool(bench.heard))
    count = len(bench.heard)
    bench.executor.shutdown()
    bench.executor.spin_once(0.05)
    assert len(bench.heard) == count


def as_it_waits(job):
    """Do something in another thread once this one waits for the middleware."""
    this = threading.get_ident()

    def waits():
        frame = sys._current_frames()[this]
        return '_set.wait(' in linecache.getline(frame.f_code.co_filename, frame.f_lineno)

    def run():
        wait_for(waits, 'a wait')
        job()

    threading.Thread(target=run).start()


def test_another_thread_ends_a_wait(bench):
    as_it_waits(bench.executor.shutdown)
    bench.executor.spin()
    bench.executor = type(bench.executor)(context=bench.context)
    bench.executor.add_node(bench.node)
    as_it_waits(lambda: rclpy.shutdown(context=bench.context))
    with pytest.raises(ExternalShutdownException):
        bench.executor.spin_once(PATIENCE)


def test_an_idle_spin_rests(bench):
    """A wait that nothing ends takes no processor time."""
    publisher, _ = bench.talk()
    sent(publisher, *range(10))
    bench.until(lambda: len(bench.heard) == 10)
    bench.executor.spin_once(2.0 * PATROL)  # what was triggered before
    before = time.process_time()
    bench.executor.spin_once(1.0)
    assert time.process_time() - before < 0.5
