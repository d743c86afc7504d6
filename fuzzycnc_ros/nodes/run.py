# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Start nodes, spin them, end cleanly."""

import sys
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from fuzzycnc_ros.nodes.environment import prepare_environment
from fuzzycnc_ros.nodes.host import ComponentNode
from fuzzycnc_ros.nodes.parameters import ParameterError

HostFactory = Callable[[], ComponentNode]


def main(make: HostFactory, arguments: Sequence[str] | None = None) -> None:
    """Run one node until it is interrupted, asked to end, or done.

    The process ends with 0 on SIGINT, SIGTERM and at the end of a programme, and with 2 and one
    line on standard error if a parameter or argument is wrong.
    """
    sys.exit(run([make], arguments))


def run(makers: Sequence[HostFactory], arguments: Sequence[str] | None = None) -> int:
    """Run several nodes in one process; return the exit code."""
    prepare_environment()
    rclpy.init(args=arguments)
    hosts: list[ComponentNode] = []
    # The multi-threaded and the events executor stalled or hung in trials on Jazzy.
    executor = SingleThreadedExecutor()
    try:
        for make in makers:
            host = make()
            hosts.append(host)
            executor.add_node(host.node)
            host.start()
        while rclpy.ok() and not any(host.done for host in hosts):
            executor.spin_once()
        return max((host.exit_code for host in hosts), default=0)
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except ParameterError as error:
        print(f'error: {error}', file=sys.stderr)
        return 2
    finally:
        for host in reversed(hosts):
            host.stop()
        executor.shutdown()
        rclpy.try_shutdown()

