# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Many machines on one host: what each costs, and whether all keep their deadlines.

Each machine is a namespace with all thermal nodes composed in one process: acquisition, selector,
predictor and compensator in real time.  One more process plays all the machines: 76 readings, the
state and the offsets in force, once a second each, and takes every compensation as it comes.

The model is one of 1 s, so that all nodes work every second.  A deadline is kept if the
compensation of a second's readings has come before the next ones go out; all of them have to be.
Printed are, per machine, processor time as a share of one core, resident memory and the part of it
that is the machine's alone, and threads; and how late compensations come.

Latencies mean something on an idle host only; the load is printed.  Run with
`python benchmarks/bench_machines.py [MACHINES] [SECONDS]`.
"""

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor

sys.path.insert(0, str(Path(__file__).parents[1] / 'test' / 'qualification'))

from soak.growth import held_by

from fuzzycnc_ros.cli.live.free_domain import own_domain
from fuzzycnc_ros.cli.live.graph_processes import COMPOSED, GraphProcesses
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.graph.bring_up import THERMAL, NodeSpec
from fuzzycnc_ros.ros.processes import prepare_environment, processor_time
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos, subscription_qos
from fuzzycnc_ros.runtime.component import STREAM
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    MachineState,
    Record,
    Temperatures,
)
from fuzzycnc_ros.simulation.thermal.duties import DUTIES, simulate_duty

MACHINES, SECONDS = 20, 60
PERIOD = 1.0
"""Time between two readings of a machine [s]."""
WARM_UP = 10
"""Seconds that are not counted: connections and caches settle."""
START_TIMEOUT = 120.0
AXES = ('Y', 'Z')


class Machine:
    """The machine side of one namespace."""

    def __init__(self, node: Any, name: str, sensors: tuple[str, ...]) -> None:
        self.name, self._sensors = name, sensors
        self._publishers = {
            topic: node.create_publisher(
                message_class(record.TYPE), f'/{name}/{topic}', publisher_qos(STREAM)
            )
            for topic, record in (
                ('sensor_readings', Temperatures),
                ('machine_state', MachineState),
                ('compensation_applied', CompensationApplied),
            )
        }
        self._subscription = node.create_subscription(
            message_class(Compensation.TYPE),
            f'/{name}/compensation',
            self._on_compensation,
            subscription_qos(STREAM),
        )
        self._cold_since = self._stamp = 0
        self._rng = np.random.default_rng(len(name))
        self._sent: tuple[int, float] | None = None
        self._epoch, self._offset = 0, np.zeros(len(AXES))
        self.latencies: list[float] = []
        self.missed = 0

    @property
    def connected(self) -> bool:
        """Whether its nodes hear it, and it hears them."""
        readers = [item.get_subscription_count() for item in self._publishers.values()]
        return all(readers) and self._subscription.get_publisher_count() > 0

    @property
    def waiting(self) -> bool:
        """Whether the newest readings have not been answered."""
        return self._sent is not None

    def send(self) -> None:
        """Send a second's readings; those before without an answer are missed."""
        self.missed += self.waiting
        if self._stamp == 0:
            self._cold_since = self._stamp = time.time_ns()
        # As sampled by the machine's clock, however late this process comes to it.
        self._stamp = stamp = self._stamp + round(PERIOD * SECOND)
        self._publish(
            'machine_state',
            MachineState(
                stamp=stamp,
                state=int(MachineMode.RUNNING),
                homed=True,
                offsets_allowed=True,
                cold_since=self._cold_since,
                spindle_speed=100.0,
                axis=AXES,
                position=np.zeros(len(AXES)),
            ),
        )
        self._publish(
            'compensation_applied',
            CompensationApplied(
                stamp=stamp,
                epoch=self._epoch,
                status=int(OffsetStatus.FOLLOWING if self._epoch else OffsetStatus.IDLE),
                reason='',
                axis=AXES,
                offset=self._offset,
                at_limit=np.zeros(len(AXES), bool),
            ),
        )
        count = len(self._sensors)
        self._sent = stamp, time.perf_counter()
        self._publish(
            'sensor_readings',
            Temperatures(
                stamp=stamp,
                sensor=self._sensors,
                temperature=20.0 + 0.05 * self._rng.standard_normal(count),
                status=np.zeros(count, np.uint8),
                readings=1,
            ),
        )

    def _publish(self, topic: str, record: Record) -> None:
        self._publishers[topic].publish(encode(record, RCLPY))

    def _on_compensation(self, message: Any) -> None:
        now = time.perf_counter()
        self._epoch, self._offset = message.epoch, np.array(message.offset)
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        if self._sent is not None and stamp >= self._sent[0]:
            self.latencies.append(now - self._sent[1])
            self._sent = None


def own_memory(process: int) -> float:
    """Return the memory that no other process shares [MiB]."""
    lines = Path(f'/proc/{process}/smaps_rollup').read_text().splitlines()
    parts = [int(line.split()[1]) for line in lines if line.startswith('Private_')]
    return sum(parts) / 1024.0


def spin(executor: SingleThreadedExecutor, until: float) -> None:
    """Handle messages up to a time."""
    while (left := until - time.monotonic()) > 0.0:
        executor.spin_once(timeout_sec=left)


def measure(
    model: Path, sensors: tuple[str, ...], folder: Path, machines: int, seconds: int
) -> int:
    """Run all machines; print what they cost; return how many deadlines were missed."""
    rclpy.init()
    node = rclpy.create_node('machines')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    names = [f'mill_{number}' for number in range(machines)]
    shop = [Machine(node, name, sensors) for name in names]
    parameters = {
        'temperature_acquisition': {'interval': PERIOD},
        'thermal_predictor': {'model': str(model)},
        'compensator': {'autostart': True, 'axes': list(AXES)},
    }
    graphs = [GraphProcesses(name, folder=folder / name) for name in names]
    begun = time.monotonic()
    try:
        for graph in graphs:
            graph.start(*(NodeSpec(name, parameters.get(name, {})) for name in THERMAL))
        while not all(machine.connected for machine in shop):
            if time.monotonic() - begun > START_TIMEOUT:
                raise RuntimeError('the nodes did not come up')
            for graph in graphs:
                graph.check()
            spin(executor, time.monotonic() + 0.2)
        print(f'{machines} machines up in {time.monotonic() - begun:.1f} s')
        pids = [graph.pid(COMPOSED) for graph in graphs]
        taken: list[float] = []
        start = time.monotonic()
        for second in range(WARM_UP + seconds):
            if second == WARM_UP:
                begun, taken = time.monotonic(), [processor_time(pid) for pid in pids]
                load = os.getloadavg()[0]
                own = time.process_time()
            for number, machine in enumerate(shop):
                # A shop's machines are not in step.
                spin(executor, start + PERIOD * (second + number / machines))
                machine.send()
                if second == WARM_UP:
                    machine.latencies.clear()
                    machine.missed = 0
        spin(executor, start + PERIOD * (WARM_UP + seconds + 1))
        lasted = time.monotonic() - begun
        cost = [processor_time(pid) - before for pid, before in zip(pids, taken, strict=True)]
        share = 100.0 * np.array(cost) / lasted
        held = [held_by(pid) for pid in pids]
        alone = [own_memory(pid) for pid in pids]
        print(f'load of this host {load:.1f}, {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores')
        print(f'the machine side of all: {100.0 * (time.process_time() - own) / lasted:.0f} %')
    finally:
        for graph in graphs:
            graph.interrupt()
        for graph in graphs:
            graph.stop()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
    missed = sum(machine.missed + machine.waiting for machine in shop)
    print(
        f'{"machine":10} {"core %":>7} {"MiB":>6} {"own MiB":>8} {"threads":>8} {"p50 ms":>7} '
        f'{"max ms":>7}'
    )
    for number, machine in enumerate(shop):
        times = 1e3 * np.array(machine.latencies)
        print(
            f'{machine.name:10} {share[number]:7.1f} {held[number].memory / 2**20:6.0f} '
            f'{alone[number]:8.0f} {held[number].threads:8} {np.median(times):7.1f} '
            f'{times.max():7.1f}'
        )
    every = 1e3 * np.concatenate([machine.latencies for machine in shop])
    print(
        f'{"median":10} {np.median(share):7.1f} '
        f'{np.median([item.memory for item in held]) / 2**20:6.0f} {np.median(alone):8.0f} '
        f'{np.median([item.threads for item in held]):8.0f} {np.median(every):7.1f} '
        f'{every.max():7.1f}'
    )
    print(
        f'all: {share.sum():.0f} % of one core, {sum(alone):.0f} MiB of their own; p99 '
        f'{np.quantile(every, 0.99):.1f} ms; {missed} of {missed + len(every)} deadlines missed'
    )
    return missed


def main() -> int:
    """Print costs; fail if a deadline was missed."""
    machines = int(sys.argv[1]) if len(sys.argv) > 1 else MACHINES
    seconds = int(sys.argv[2]) if len(sys.argv) > 2 else SECONDS
    own_domain()
    prepare_environment()
    runs = [simulate_duty(DUTIES[name], PERIOD) for name in ('D0', 'T1')]
    trained = train_model(runs, interval=PERIOD, sensors='clusters', candidates=('lag_ridge',))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = folder / 'model.json'
        model.write_text(trained.to_json(), encoding='utf-8')
        return int(measure(model, runs[0].sensor, folder, machines, seconds) > 0)


if __name__ == '__main__':
    sys.exit(main())
