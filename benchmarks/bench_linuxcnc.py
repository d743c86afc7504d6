# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""From a compensation on its topic to the read-back on another, through a real LinuxCNC.

LinuxCNC runs a program of G2 circles without a screen, `linuxcnc_bridge` is a node of its own, and
this process commands offsets of Z at 50 Hz, a triangle wave in steps of 1 um.  A command counts as
applied when `compensation_applied` has arrived here with it, within 0.2 um.  Run with
`python benchmarks/bench_linuxcnc.py [SECONDS]`, as a user who may start LinuxCNC.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
RATE = 50.0
STEP, PEAK = 1e-6, 20e-6
CLOSE = 0.2e-6
SLEW = 1e-3
PROGRAM = """G21 G90 G94 G64 P0.01
F3000
G0 X50 Y0
o1 repeat [200]
G2 X50 Y0 I-50 J0
o1 endrepeat
M2
"""


class Listener:
    """Commands offsets, and hears what is applied."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        from fuzzycnc_ros.ros.topics import message_class, publisher_qos, subscription_qos
        from fuzzycnc_ros.runtime.component import Durability
        from fuzzycnc_ros.runtime.records import Compensation, CompensationApplied, MachineState

        rclpy.init()
        self.node = rclpy.create_node('bench', namespace='/mill')
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        stream = Durability.STREAM
        self.publisher = self.node.create_publisher(
            message_class(Compensation.TYPE), 'compensation', publisher_qos(stream)
        )
        self.heard: list[tuple[float, float]] = []
        self.allowed = False

        def on_applied(message: object) -> None:
            self.heard.append((time.monotonic(), message.offset[2]))  # type: ignore[attr-defined]

        def on_state(message: object) -> None:
            self.allowed = message.offsets_allowed  # type: ignore[attr-defined]

        for name, kind, handler in (
            ('compensation_applied', CompensationApplied, on_applied),
            ('machine_state', MachineState, on_state),
        ):
            self.node.create_subscription(
                message_class(kind.TYPE), name, handler, subscription_qos(stream)
            )

    def command(self, offset: float) -> None:
        """Command an offset of Z [m]."""
        from fuzzycnc_ros.ros.topics import RCLPY
        from fuzzycnc_ros.runtime.convert import encode
        from fuzzycnc_ros.runtime.records import SECOND, Compensation

        now = time.time_ns()
        record = Compensation(
            stamp=now,
            frame_id='mill/machine',
            epoch=1,
            state=1,
            axis=('Z',),
            offset=np.array([offset]),
            slope=np.zeros(1),
            reference_position=np.zeros(1),
            at_limit=np.zeros(1, bool),
            slewing=np.zeros(1, bool),
            valid_until=now + 60 * SECOND,
            source=('bench',),
        )
        self.publisher.publish(encode(record, RCLPY))

    def until(self, moment: float) -> None:
        """Hear until a point of monotonic time [s]."""
        while (left := moment - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=left)


def triangle(count: int) -> np.ndarray:
    """Return offsets [m] that go up and down in steps."""
    phase = STEP * np.arange(count) % (4 * PEAK)
    return np.minimum(phase, 4 * PEAK - phase) - PEAK


def measure(listener: Listener, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the latency of each command [s], and what is left when the next one goes out [m].

    The wave goes on while a command is on its way: it is applied when the read-back has reached or
    passed it, and late if that is after the next one.
    """
    wanted = triangle(int(seconds * RATE))
    listener.command(wanted[0])
    listener.until(time.monotonic() + 1.0)
    due, sent = time.monotonic(), []
    listener.heard.clear()
    for offset in wanted:
        sent.append(time.monotonic())
        listener.command(offset)
        due += 1.0 / RATE
        listener.until(due)
    listener.until(due + 1.0)
    at, applied = np.array(listener.heard).T
    before = np.concatenate([applied[:1], applied[:-1]])
    low, high = np.minimum(before, applied) - CLOSE, np.maximum(before, applied) + CLOSE
    latencies, errors = [], []
    for number in range(1, len(wanted)):
        there = (
            (at > sent[number])
            & (at < sent[number] + 1.0)
            & (low <= wanted[number])
            & (wanted[number] <= high)
        )
        latencies.append(at[there][0] - sent[number] if there.any() else np.inf)
        if number + 1 < len(wanted) and latencies[-1] < sent[number + 1] - sent[number]:
            errors.append(applied[at < sent[number + 1]][-1] - wanted[number])
    return np.array(latencies), np.array(errors)


def main() -> None:
    """Measure once and print a table."""
    from fuzzycnc_ros.adapters.linuxcnc.simulation import LinuxcncSimulation
    from fuzzycnc_ros.ros.processes import prepare_environment

    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    prepare_environment()
    folder = Path(tempfile.mkdtemp(prefix='fuzzycnc-linuxcnc-'))
    machine = LinuxcncSimulation(folder, COUNTS_PER_SECOND=200000)
    bridge = None
    try:
        machine.start()
        machine.ready()
        program = machine.write_program('circles', PROGRAM)
        command = [sys.executable, '-m', 'fuzzycnc_ros.nodes.linuxcnc_bridge', '--ros-args']
        command += ['-r', '__ns:=/mill', '-p', 'autostart:=true', '-p', f'slew_max:={SLEW}']
        environment = {**os.environ, 'PYTHONPATH': str(ROOT), 'OMP_NUM_THREADS': '1'}
        bridge = subprocess.Popen(command, env=environment)
        listener = Listener()
        end = time.monotonic() + 20.0
        while not (listener.allowed and listener.publisher.get_subscription_count()):
            if time.monotonic() > end:
                raise SystemExit('expected a bridge that allows offsets but it does not')
            listener.until(time.monotonic() + 0.05)
        machine.run(program)
        before = Path(f'/proc/{bridge.pid}/stat').read_text().split()[13:17]
        latencies, errors = measure(listener, seconds)
        after = Path(f'/proc/{bridge.pid}/stat').read_text().split()[13:17]
        running = machine.state()['running']
        used = sum(int(b) - int(a) for a, b in zip(before, after, strict=True)) / 100.0
        median, most = 1e3 * np.percentile(latencies, (50, 99), method='higher')
        print(f'load of the host {os.getloadavg()[0]:.1f}, program runs to the end: {running}')
        late = np.count_nonzero(latencies > 1.0 / RATE)
        print(f'commands {len(latencies)}, of which later than the next one {late}')
        print(f'latency median {median:.1f}, p99 {most:.1f}, max {1e3 * latencies.max():.1f} ms')
        rms = 1e6 * np.sqrt(np.mean(errors**2))
        print(f'applied - requested: max {1e6 * np.abs(errors).max():.3f} um, rms {rms:.3f} um')
        print(f'the node takes {100.0 * used / (seconds + 1.0):.0f} % of a core')
    finally:
        if bridge is not None:
            bridge.send_signal(signal.SIGINT)
            bridge.wait(10.0)
        machine.end()
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == '__main__':
    main()
