# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the live page costs: processor, memory, and the time from a topic to a page.

A machine with 76 sensors is played at 1 Hz.  Measured are, one after the other:

- *bare node*: rclpy alone, in a process of its own;
- *page closed*: `dashboard` beside the graph, with no page open;
- *ten pages*: ten clients that take every frame;
- *history*: what 24 hours of 76 sensors at 1 Hz take in memory;
- *latency*: from the publication of temperatures to the frame that shows them, and to what is
  written on the page;
- *NiceGUI*: its empty page, closed and in ten windows, if the Python of an environment that has
  it is named (it is not in the lock).

The windows are those of a headless Chromium, which needs its driver.

Processor time is that of the process, from /proc, as a part of one core; memory is resident, and
the share of the process, in which a page that several map counts once in all (PSS).
Run with `python benchmarks/bench_dashboard.py [SECONDS [PYTHON WITH NICEGUI]]`.
"""

import json
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from selenium import webdriver
from selenium.webdriver.support.wait import WebDriverWait
from websockets.sync.client import connect

from fuzzycnc_ros.cli.live.free_domain import own_domain
from fuzzycnc_ros.components.dashboard.history import History
from fuzzycnc_ros.ros.processes import prepare_environment, processor_time
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.host import NodeConfiguration
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    MachineState,
    Temperatures,
    ThermalError,
)

SENSORS, PAGES = 76, 10
PORT = 18642
SETTLING = 5.0
BARE = 'import rclpy; rclpy.init(); rclpy.spin(rclpy.create_node("bare"))'
NICEGUI = f"""
from nicegui import ui
@ui.page('/')
def page():
    ui.label('empty')
ui.run(port={PORT + 1}, show=False, reload=False)
"""
OFFSET_SHOWN = 'return document.querySelector(`[data-field="Y offset"]`)'
WATCH_OFFSET = """
const place = document.querySelector(`[data-field="Y offset"]`);
let shown = place.textContent;
window.seen = [];
new MutationObserver(() => {
  if (place.textContent === shown) return;
  shown = place.textContent;
  requestAnimationFrame(() => window.seen.push(Date.now()));
}).observe(place, {childList: true, characterData: true, subtree: true});
"""


class Memory(NamedTuple):
    """Memory of a process [MiB]."""

    resident: float
    """Its pages that are in memory."""
    share: float
    """The same, each page divided by the processes that share it: what its end would free."""

    def __str__(self) -> str:
        return f'{self.resident:.0f} MiB resident ({self.share:.0f} MiB its share)'


def memory(pid: int) -> Memory:
    """Return the memory of a process."""
    lines = Path(f'/proc/{pid}/smaps_rollup').read_text().splitlines()[1:]
    sizes = {line.split(':')[0]: int(line.split()[1]) / 1024 for line in lines}
    return Memory(sizes['Rss'], sizes['Pss'])


@contextmanager
def running(*command: str) -> Iterator[int]:
    """Run a command; give its process id."""
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield process.pid
        finally:
            process.terminate()


def cost(pid: int, seconds: float) -> tuple[float, Memory]:
    """Return part of a core and memory of a process over some time."""
    before, began = processor_time(pid), time.monotonic()
    time.sleep(seconds)
    return (processor_time(pid) - before) / (time.monotonic() - began), memory(pid)


class Machine:
    """A machine of 76 sensors at 1 Hz, without components behind it."""

    def __init__(self) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.sent: dict[float, float] = {}
        """When the sample of each stamp was published [s]."""
        node = Node('temperature_acquisition', namespace='/mill')
        kinds: dict[str, type[Any]] = {
            'temperatures': Temperatures,
            'thermal_error': ThermalError,
            'compensation': Compensation,
            'compensation_applied': CompensationApplied,
            'machine_state': MachineState,
        }
        stream = publisher_qos(Durability.STREAM)
        self._out = {
            name: node.create_publisher(message_class(kind.TYPE), name, stream)
            for name, kind in kinds.items()
        }
        self._out['node_configuration'] = node.create_publisher(
            message_class(NodeConfiguration.TYPE),
            'node_configuration',
            publisher_qos(Durability.LATCHED),
        )
        told = NodeConfiguration(
            stamp=0,
            node='temperature_acquisition',
            version='',
            message_set=1,
            lifecycle_state='active',
            parameters='{}',
            model='',
            model_hash='',
        )
        self._out['node_configuration'].publish(encode(told, RCLPY))
        node.create_timer(1.0, self._tick)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        threading.Thread(target=self._executor.spin, daemon=True).start()

    def _tick(self) -> None:
        stamp = time.time_ns()
        axes, warm = ('Y', 'Z'), np.array([3e-6, 5e-6]) + 1e-7 * (stamp // SECOND % 100)
        no, none = np.zeros(2, bool), np.zeros(2)
        records = {
            'machine_state': MachineState(
                stamp=stamp,
                state=3,
                homed=True,
                offsets_allowed=True,
                cold_since=0,
                spindle_speed=100.0,
                axis=(),
                position=np.zeros(0),
            ),
            'temperatures': Temperatures(
                stamp=stamp,
                sensor=tuple(f't{number:02d}' for number in range(SENSORS)),
                temperature=20.0 + np.random.default_rng(stamp % 1000).random(SENSORS),
                status=np.zeros(SENSORS, np.uint8),
                readings=5,
            ),
            'thermal_error': ThermalError(
                stamp=stamp,
                axis=axes,
                channel=axes,
                error=warm,
                standard_deviation=0.1 * warm,
                valid=True,
                reason=0,
                in_domain=True,
                model='m',
                substituted=(),
                substitute=(),
            ),
            'compensation': Compensation(
                stamp=stamp,
                epoch=1,
                state=1,
                axis=axes,
                offset=-warm,
                slope=none,
                reference_position=none,
                at_limit=no,
                slewing=no,
                valid_until=stamp + 180 * SECOND,
                source=('thermal_error',),
            ),
            'compensation_applied': CompensationApplied(
                stamp=stamp, epoch=1, status=1, reason='', axis=axes, offset=-warm, at_limit=no
            ),
        }
        self.sent[stamp / SECOND] = time.monotonic()
        for name, record in records.items():
            self._out[name].publish(encode(record, RCLPY))


def read(latencies: list[float], sent: dict[float, float], over: threading.Event) -> None:
    """Take the frames of a page, and note how old new samples are when they come."""
    seen = None
    with connect(f'ws://127.0.0.1:{PORT}/live', max_size=None) as client:
        while not over.is_set():
            try:
                frame = json.loads(client.recv(timeout=0.2))
            except TimeoutError:
                continue
            stamp = frame.get('view', {}).get('stamp')
            if stamp is not None and stamp != seen:
                latencies.append(time.monotonic() - sent[stamp])
            seen = stamp


@contextmanager
def pages(machine: Machine) -> Iterator[list[float]]:
    """Open ten pages; give the latencies of one of them [s]."""
    over = threading.Event()
    latencies: list[float] = []
    readers = [
        threading.Thread(target=read, args=(latencies if not number else [], machine.sent, over))
        for number in range(PAGES)
    ]
    for reader in readers:
        reader.start()
    try:
        yield latencies
    finally:
        over.set()
        for reader in readers:
            reader.join()


def history_memory() -> float:
    """Return what 24 hours of 76 sensors at 1 Hz take [MiB]."""
    history = History()
    names = [f't{number:02d}' for number in range(SENSORS)]
    values = dict(zip(names, np.random.default_rng(0).random(SENSORS).tolist(), strict=True))
    for second in range(86400):
        history['temperatures'].add(second * SECOND, values)
    return history.nbytes / 2**20


@contextmanager
def browser() -> Iterator[webdriver.Chrome]:
    """Start a headless browser."""
    options = webdriver.ChromeOptions()
    for flag in ('--headless', '--no-sandbox', '--disable-gpu', '--disable-dev-shm-usage'):
        options.add_argument(flag)
    service = webdriver.ChromeService(shutil.which('chromedriver'))
    with webdriver.Chrome(options=options, service=service) as driver:
        yield driver


def on_screen(sent: dict[float, float], seconds: float) -> list[float]:
    """Return the times from the publication of offsets to what stands on a page [s].

    An observer in the page notes when the offset changes: the clock of the page and ours are one
    host's.
    """
    with browser() as driver:
        driver.get(f'http://127.0.0.1:{PORT}/')
        WebDriverWait(driver, 30).until(lambda page: page.execute_script(OFFSET_SHOWN))
        driver.execute_script(WATCH_OFFSET)
        time.sleep(seconds)
        seen = driver.execute_script('return window.seen')
    offset = time.time() - time.monotonic()
    begun = sorted(monotonic + offset for monotonic in sent.values())
    ages = []
    for moment in (1e-3 * number for number in seen):
        before = [value for value in begun if value <= moment]
        ages.append(moment - before[-1])
    return ages


def nicegui(python: str, seconds: float) -> None:
    """Measure NiceGUI's empty page, closed and in ten windows."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        script = Path(folder) / 'empty.py'
        script.write_text(NICEGUI)
        pid = stack.enter_context(running(python, str(script)))
        time.sleep(2 * SETTLING)
        share, used = cost(pid, seconds)
        print(f'NiceGUI, empty page closed: {100 * share:.2f} % of a core, {used}')
        driver = stack.enter_context(browser())
        for _ in range(PAGES):
            driver.switch_to.new_window('window')
            driver.get(f'http://127.0.0.1:{PORT + 1}/')
        time.sleep(SETTLING)
        share, used = cost(pid, seconds)
        print(f'NiceGUI, {PAGES} windows: {100 * share:.2f} % of a core, {used}')


def main(seconds: float, python: str) -> None:
    """Measure and print."""
    prepare_environment()
    own_domain()
    machine = Machine()
    with running(sys.executable, '-c', BARE) as pid:
        time.sleep(SETTLING)
        share, bare = cost(pid, seconds)
        print(f'bare node: {100 * share:.2f} % of a core, {bare}')
    dashboard = (sys.executable, '-m', 'fuzzycnc_ros.nodes.dashboard', '--ros-args')
    with running(*dashboard, '-p', f'port:={PORT}') as pid:
        time.sleep(2 * SETTLING)
        share, used = cost(pid, seconds)
        print(
            f'page closed: {100 * share:.2f} % of a core, {used}, '
            f'{used.resident - bare.resident:.0f} MiB more than the bare node'
        )
        with pages(machine) as latencies:
            time.sleep(SETTLING)
            latencies.clear()
            share, used = cost(pid, seconds)
            age = f'{1e3 * median(latencies):.0f} ms, at most {1e3 * max(latencies):.0f} ms'
        shown = on_screen(machine.sent, seconds)
        print(f'{PAGES} pages at 1 Hz: {100 * share:.2f} % of a core, {used}')
        print(f'from the topic to the frame: median {age}, of {len(latencies)}')
        age = f'{1e3 * median(shown):.0f} ms, at most {1e3 * max(shown):.0f} ms'
        print(f'from the topic to the screen: median {age}, of {len(shown)}')
    print(f'history of 24 h, {SENSORS} sensors at 1 Hz: {history_memory():.1f} MiB')
    if python:
        nicegui(python, seconds)


if __name__ == '__main__':
    given = sys.argv[1:]
    main(float(given[0]) if given else 30.0, given[1] if len(given) > 1 else '')
