# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The package's executor beside rclpy's: an empty loop, and the whole thermal graph in lock-step.

- *ping-pong*: two processes answer each other's `std_msgs/Float64`, nothing else.
- *thermal graph*: the demo's five nodes and a recorder over DDS, each a process, one day of the
  simulated mill.  The two bags of a run are compared by their canonical hash.

Everything is run in turn, several times, with both executors; rates are of wall time, so they mean
something on an idle host only, and so the processor time of all processes is printed as well.
Run with `python benchmarks/bench_executor.py [ROUNDS]`.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Float64

from fuzzycnc_ros.cli.live.free_domain import own_domain
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.graph.bring_up import node_specs
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.ros.executor import LeanExecutor
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration

ROUNDS, TRIPS = 3, 3000
DUTIES = ('T2', 'T3')
KINDS = {'lean': LeanExecutor, 'rclpy': SingleThreadedExecutor}
TIMEOUT = 300.0


def answer(kind: str) -> None:
    """Send each ping back as a pong, until killed."""
    rclpy.init()
    node, executor = Node('answering'), KINDS[kind]()
    executor.add_node(node)
    pong = node.create_publisher(Float64, 'pong', 10)
    node.create_subscription(Float64, 'ping', pong.publish, 10)
    while rclpy.ok():
        executor.spin_once()


def ask(kind: str) -> None:
    """Print the round trips per second."""
    rclpy.init()
    node, executor = Node('asking'), KINDS[kind]()
    executor.add_node(node)
    ping = node.create_publisher(Float64, 'ping', 10)
    heard = 0

    def on_pong(message: Float64) -> None:
        nonlocal heard
        heard += 1
        if heard < TRIPS:
            ping.publish(message)

    node.create_subscription(Float64, 'pong', on_pong, 10)
    while not (ping.get_subscription_count() and node.count_publishers('pong')):
        executor.spin_once(0.05)
    time.sleep(0.5)
    began = time.monotonic()
    ping.publish(Float64())
    while heard < TRIPS:
        executor.spin_once(1.0)
    print(TRIPS / (time.monotonic() - began))


def ping_pong(kind: str) -> float:
    """Return the round trips per second between two processes."""
    own = [sys.executable, __file__]
    with subprocess.Popen([*own, 'answer', kind], stderr=subprocess.DEVNULL) as other:
        try:
            done = subprocess.run(
                [*own, 'ask', kind], stdout=subprocess.PIPE, text=True, check=True, timeout=TIMEOUT
            )
        finally:
            other.kill()
    return float(done.stdout)


def graph_run(kind: str, model: Path, folder: Path) -> tuple[float, float, str]:
    """Return ticks per second, processor time a tick [ms] and the hash of a lock-step run."""
    specs = node_specs(
        duties=DUTIES, model=model, record=folder / 'bag', lockstep=True, autostart=True
    )
    for spec in specs:
        spec.parameters['executor'] = kind
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    with GraphProcesses('mill', folder=folder / 'log') as graph:
        for spec in specs:
            graph.start(spec)
        while not (folder / 'bag').exists():
            graph.check()
            time.sleep(0.01)
        began = time.monotonic()
        graph.wait('simulated_machine', TIMEOUT)
        wall = time.monotonic() - began
        outcome = graph.outcome('simulated_machine')
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    if outcome.get('degraded') is not False:
        raise RuntimeError(f'the run is worth nothing: {outcome}')
    ticks = outcome['ticks']
    busy = now.ru_utime + now.ru_stime - spent.ru_utime - spent.ru_stime
    return ticks / wall, 1e3 * busy / ticks, replay(folder / 'bag').hash


def main(rounds: int) -> None:
    """Print rates and ratios."""
    own_domain()
    print(f'load of this host: {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores')
    trips: dict[str, list[float]] = {kind: [] for kind in KINDS}
    runs: dict[str, list[tuple[float, float, str]]] = {kind: [] for kind in KINDS}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = folder / 'model.json'
        model.write_text(train_model(record_calibration(('D0', 'T1')).runs).to_json())
        for number in range(rounds):
            for kind in KINDS:
                trips[kind].append(ping_pong(kind))
                runs[kind].append(graph_run(kind, model, folder / f'{kind}{number}'))
    ticks = {kind: [run[0] for run in runs[kind]] for kind in KINDS}
    busy = {kind: [run[1] for run in runs[kind]] for kind in KINDS}
    print(f'{"":34} {"lean":>8} {"rclpy":>8} {"ratio":>7}')
    for what, found in (
        ('ping-pong [round trips/s]', trips),
        ('thermal graph [ticks/s]', ticks),
        ('thermal graph [ms of CPU a tick]', busy),
    ):
        lean, plain = median(found['lean']), median(found['rclpy'])
        print(f'{what:34} {lean:8.4g} {plain:8.4g} {lean / plain:7.2f}')
    hashes = {run[2] for kind in KINDS for run in runs[kind]}
    print(f'hashes of all runs: {"one" if len(hashes) == 1 else "DIFFERENT"}')


if __name__ == '__main__':
    match sys.argv[1:]:
        case ['answer', kind]:
            answer(kind)
        case ['ask', kind]:
            ask(kind)
        case [rounds]:
            main(int(rounds))
        case _:
            main(ROUNDS)
