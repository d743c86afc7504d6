# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Start nodes, spin them, end cleanly; what they say, with control characters spelt out."""

import faulthandler
import resource
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

import rclpy
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.rcutils_logger import RcutilsLogger, _internal_callers
from rclpy.node import Node

from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.files.uninterrupted import Interrupted, uninterrupted
from fuzzycnc_ros.ros.arguments import initialise
from fuzzycnc_ros.ros.executor import LeanExecutor
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.ros.presence import GraphError, Presence
from fuzzycnc_ros.ros.processes import (
    REFUSED,
    StopRequest,
    end,
    ending_within,
    interruptible,
    memory_limit,
    prepare_environment,
)
from fuzzycnc_ros.ros.service_manager import ServiceManager
from fuzzycnc_ros.ros.streams import steady_streams

DELIVERING = 0.5
"""Wall time [s] in all that readers have to acknowledge what the nodes published last."""
LETTING_GO = 6
"""Wall time [s] that the middleware has for its part of the end; it takes 0.1 s, or forever.

Less than `NODE_STOP`: who is killed by then has not told how it ended."""
NO_MEMORY = 1
"""Exit code of a node that gets no more memory: started again it begins with little."""

UNCONVERTED = 'Unable to convert call argument'
"""Words of pybind11 where rclpy got no memory for a message: the MemoryError itself is lost."""


def tell_error(error: object) -> None:
    """Write a line on standard error."""
    print(f'error: {visible(" ".join(str(error).split()))}', file=sys.stderr, flush=True)


def spell_out_logs() -> None:
    """Have all loggers of this process spell control characters out.

    rclpy has no formatter of its own to set, and a logger is made inside every node.
    """
    if RcutilsLogger.log is not _log:
        # It tells callers apart by their place, and leaves the files of this list out.
        _internal_callers.append(__file__)
        RcutilsLogger.log = _log


_plain_log = RcutilsLogger.log


def _log(self: Any, message: Any, severity: Any, **settings: Any) -> Any:
    return _plain_log(self, visible(str(message)), severity, **settings)


class Served(Protocol):
    """Object that serves a node, as `run` needs it."""

    node: Node
    exit_code: int
    executor: str
    """Name of the executor that is to call the node, see `ExecutorConfig`."""

    @property
    def done(self) -> bool:
        """True if the node has nothing left to do and its process may end."""

    def start(self) -> None:
        """Begin; all nodes of the process exist by now."""

    def stop(self) -> None:
        """Release what the node holds beside its part of the middleware."""


HostFactory = Callable[[], Served]


def main(make: HostFactory, arguments: Sequence[str] | None = None) -> None:
    """Run one node until it is interrupted, asked to end, or done.

    The process ends with 0 on SIGINT, SIGTERM and at the end of a programme, with 2 and one line
    on standard error if a parameter or argument is wrong, and with 1 and a line if it gets no more
    memory.
    """
    steady_streams(output_matters=False)
    end(run([make], arguments))


def run(makers: Sequence[HostFactory], arguments: Sequence[str] | None = None) -> int:
    """Run several nodes in one process; return the exit code."""
    spell_out_logs()
    if not faulthandler.is_enabled():
        with suppress(OSError, ValueError):  # standard error is no file
            faulthandler.enable()  # a crash of the middleware leaves a stack in the log
    try:
        prepare_environment()
    except ValueError as error:
        tell_error(error)
        return REFUSED
    try:
        with interruptible() as wish:
            return _spin(makers, arguments, wish)
    except KeyboardInterrupt:  # before there were nodes, or while they were ended
        return 0


def _spin(
    makers: Sequence[HostFactory], arguments: Sequence[str] | None, wish: StopRequest
) -> int:
    """Run nodes until a wish to end is heard or one is done; return the exit code."""
    hosts: list[Served] = []
    executor: SingleThreadedExecutor | None = None
    waking = ExitStack()
    failed = 0
    presence = Presence()
    manager = ServiceManager()
    try:
        with uninterrupted():  # what is half made could not be stopped
            initialise(arguments)
            for make in makers:
                host = make()
                hosts.append(host)
                presence.hold(host.node.get_namespace(), host.node.get_name())
            # The multi-threaded and the events executor stalled or hung in trials on Jazzy.
            lean = all(host.executor == 'lean' for host in hosts)
            executor = LeanExecutor() if lean else SingleThreadedExecutor()
            for host in hosts:
                executor.add_node(host.node)
                host.start()
            waking.enter_context(_woken_by_signals(executor))
        with wish.put_off():
            while rclpy.ok() and not (wish.number or any(host.done for host in hosts)):
                executor.spin_once()
                # Every node has work to do each second, if only to say how it is.
                manager.ready()
                manager.pulse()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # the wish is carried out below
    except (ParameterError, GraphError) as error:
        tell_error(error)
        failed = REFUSED
    except MemoryError:
        tell_error(_no_memory())
        failed = NO_MEMORY
    except Exception as error:
        if UNCONVERTED in str(error):
            tell_error(_no_memory())
            failed = NO_MEMORY
        # What became of a wish that was raised in a callback that hung.
        elif not wish.number:
            raise
    finally:
        manager.stopping()
        for host in reversed(hosts):
            host.stop()
        # What a node holds may fail to be written to its end: the code is known only now.
        code = max([failed, *(host.exit_code for host in hosts)])
        sys.stdout.flush()
        with ending_within(LETTING_GO, code):
            with suppress(Interrupted), uninterrupted():
                _deliver([host.node for host in hosts])
            # Ends the thread that wakes the executor: late on a busy computer, it would touch what
            # is destroyed here.
            waking.close()
            if executor is not None:
                executor.shutdown()
            for host in reversed(hosts):
                host.node.destroy_node()
            rclpy.try_shutdown()
            presence.leave()
    return code


@contextmanager
def _woken_by_signals(executor: SingleThreadedExecutor) -> Iterator[None]:
    """Have signals end the wait of an executor, so that their handlers in Python are called.

    The handlers of rclpy would end the context, too, and nothing could be delivered any more.
    """
    there, here = socket.socketpair()
    here.setblocking(False)

    def wake() -> None:
        while there.recv(64):
            executor.wake()

    thread = threading.Thread(target=wake, name='signals', daemon=True)
    thread.start()
    before = signal.set_wakeup_fd(here.fileno(), warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        here.close()
        thread.join()
        there.close()


def _deliver(nodes: Sequence[Node]) -> None:
    """Wait for what was published last to arrive, but not for long: it ends with the process."""
    end = time.monotonic() + DELIVERING
    for publisher in [item for node in nodes for item in node.publishers if rclpy.ok()]:
        publisher.wait_for_all_acked(Duration(seconds=max(0.0, end - time.monotonic())))


def _no_memory() -> str:
    """Say that this process got no more memory, how much it has, and what helps."""
    pages = int(Path('/proc/self/statm').read_text(encoding='ascii').split()[0])
    size = pages * resource.getpagesize() / 1e6
    most = memory_limit()
    if most is None:
        return f'there is not enough memory; this process has {size:.0f} MB; end other programs'
    return (
        f'there is not enough memory: this process may have {most:.0f} MB and has '
        f'{size:.0f} MB; allow more, see `ulimit -v`'
    )
