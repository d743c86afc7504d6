# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Speed of the bag machinery on one hour of 76 sensors at 10 Hz, beside rosbags in one run.

Run with `python benchmarks/bench_bags.py`; it needs rosbags, mcap and zstandard.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rosbags.rosbag2

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.recorder import RecordingThread
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.bags.typestore import message_type, serialize, typestore
from fuzzycnc_ros.bags.writer import BagWriter

SENSORS, RATE, DURATION = 76, 10, 3600
TEMPERATURES = 'fuzzycnc_msgs/msg/Temperatures'
DISPLACEMENT = 'fuzzycnc_msgs/msg/Displacement'
TOPIC, OTHER = '/mill/temperatures', '/mill/displacement'


def messages() -> list[tuple[str, bytes, int]]:
    """Return one hour of serialised messages."""
    random = np.random.default_rng(0)
    header = message_type('std_msgs/msg/Header')
    stamp_type = message_type('builtin_interfaces/msg/Time')
    names = [f'sensor_{k}' for k in range(SENSORS)]
    result = []
    for k in range(RATE * DURATION):
        stamp = 10**9 + k * 10**9 // RATE
        time_stamp = stamp_type(sec=stamp // 10**9, nanosec=stamp % 10**9)
        sample = message_type(TEMPERATURES)(
            header=header(stamp=time_stamp, frame_id='mill/machine'),
            sensor=names,
            temperature=20.0 + k * 1e-4 + random.normal(0.0, 0.05, SENSORS),
            status=np.zeros(SENSORS, dtype=np.uint8),
            readings=5,
        )
        moved = message_type(DISPLACEMENT)(
            header=header(stamp=time_stamp, frame_id='mill/workpiece'),
            axis=['Y', 'Z'],
            channel=['Y', 'Z'],
            displacement=np.array([1e-9, 2e-9]) * k,
            standard_deviation=np.full(2, 1e-7),
            includes_compensation=False,
        )
        result.append((TOPIC, serialize(sample), stamp))
        result.append((OTHER, serialize(moved), stamp))
    return result


def timed(task: Callable[[], object]) -> float:
    """Return the wall time of a task [s]."""
    start = time.perf_counter()
    task()
    return time.perf_counter() - start


def write(bag: Path, content: list[tuple[str, bytes, int]]) -> None:
    """Write all messages with this package."""
    with BagWriter(bag) as writer:
        writer.add_topic(TOPIC, TEMPERATURES)
        writer.add_topic(OTHER, DISPLACEMENT)
        for topic, payload, stamp in content:
            writer.write(topic, stamp, stamp, payload)


def write_rosbags(bag: Path, content: list[tuple[str, bytes, int]]) -> None:
    """Write all messages with rosbags."""
    with rosbags.rosbag2.Writer(
        bag, version=9, storage_plugin=rosbags.rosbag2.StoragePlugin.MCAP
    ) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=typestore())
            for topic, kind in ((TOPIC, TEMPERATURES), (OTHER, DISPLACEMENT))
        }
        for topic, payload, stamp in content:
            writer.write(connections[topic], stamp, payload)


def read(bag: Path, *, raw: bool = False) -> None:
    """Read the temperatures with this package."""
    with BagReader(bag) as reader:
        count = sum(1 for _ in reader.messages([TOPIC], raw=raw))
    if count != RATE * DURATION:
        raise RuntimeError(f'expected {RATE * DURATION} messages but found {count}')


def read_rosbags(bag: Path) -> None:
    """Read and decode the temperatures with rosbags."""
    store = typestore()
    with rosbags.rosbag2.Reader(bag) as reader:
        wanted = [c for c in reader.connections if c.topic == TOPIC]
        for connection, _, payload in reader.messages(wanted):
            store.deserialize_cdr(payload, connection.msgtype)


def put(bag: Path, content: list[tuple[str, bytes, int]]) -> float:
    """Return what a recording callback costs [s per message]."""
    thread = RecordingThread(BagWriter(bag))
    thread.add_topic(TOPIC, TEMPERATURES)
    thread.add_topic(OTHER, DISPLACEMENT)
    seconds = timed(
        lambda: [thread.put(t, p, s, s, k) for k, (t, p, s) in enumerate(content[:20000])]
    )
    progress = thread.close()
    if progress.written != 20000:
        raise RuntimeError(f'expected 20000 messages in the bag but found {progress.written}')
    return seconds / 20000


def main() -> None:
    """Print the figures."""
    content = messages()
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = Path(folder) / 'ours', Path(folder) / 'theirs'
        seconds, reference = (
            timed(lambda: write(ours, content)),
            timed(lambda: write_rosbags(theirs, content)),
        )
        print(f'write {len(content)} messages: {seconds:.2f} s, rosbags {reference:.2f} s')
        print(f'undecoded temperatures: {timed(lambda: read(ours, raw=True)):.2f} s')
        seconds, reference = timed(lambda: read(ours)), timed(lambda: read_rosbags(theirs))
        print(
            f'decoded temperatures: {seconds:.2f} s ({seconds / RATE / DURATION * 1e6:.0f} us a '
            f'message, {DURATION / seconds:.0f} x real time), rosbags {reference:.2f} s, '
            f'ratio {reference / seconds:.2f}'
        )
        seconds = timed(lambda: read_run(ours))
        print(f'thermal run: {seconds:.2f} s ({DURATION / seconds:.0f} x real time)')
        print(f'canonical hash: {timed(lambda: topic_hashes(ours)):.2f} s')
        print(f'recording callback: {put(Path(folder) / "put", content) * 1e6:.1f} us')


if __name__ == '__main__':
    main()
