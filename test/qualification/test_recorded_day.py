# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A day of 76 sensors at 10 Hz: recorded in parts, its recorders killed, their disks filled."""

import json
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import recorded_day as day
from processes import start

from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.bags.metadata import storage_files
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.ros.topics import message_class, subscription_qos
from fuzzycnc_ros.runtime.component import Durability

SEED = 24
KILLS, FULL = 20, 5
NODE_KILLS = 5
PART = 600.0
"""Length of a part [s]: most recorders come to several of them."""
PART_MESSAGES = round(PART * day.RATE)
LENGTH_MAX = 60_000
"""Most messages until a kill."""
DISKS = (1.0, 8.0)
"""Sizes of the disks that are filled [MB]."""
WAY_MAX = 600.0
"""Wall time [s] after which a recorder hangs."""


@dataclass(frozen=True)
class Recorder:
    """One that recorded from a message of the day on.

    Parameters
    ----------
    bag : Path
        What it left.
    first, given : int
        Message that it began with, and messages of the day up to the last that it was given.
    code : int
        What it ended with.
    said : str
        Its standard error.
    """

    bag: Path
    first: int
    given: int
    code: int
    said: str


class Recorders:
    """Start recorders of the day in a folder."""

    def __init__(self, folder: Path, root: Path) -> None:
        self._folder = folder
        self._script = root / 'test' / 'qualification' / 'recorded_day.py'
        self._count = 0

    def run(
        self,
        first: int,
        *,
        last: int = day.MESSAGES,
        split: float = PART,
        kill_at: int | None = None,
        disk: float | None = None,
    ) -> Recorder:
        """Record until a message is given and the recorder killed, a disk [MB] is full, or all."""
        self._count += 1
        bag = self._folder / f'bag{self._count}'
        file = self._folder / f'given{self._count}'
        given = np.memmap(file, dtype=np.int64, mode='w+', shape=(1,))
        script = [sys.executable, str(self._script)]
        words = [str(file), str(first), str(last), str(split)]
        line = [*script, str(bag), *words]
        if disk is not None:
            # In a name space of its own, which ends with the process.
            place = self._folder / f'disk{self._count}'
            place.mkdir()
            mount = f'mount -t tmpfs -o size={round(disk * 1e6)} none {place} && exec "$@"'
            line = ['unshare', '-Urm', 'sh', '-c', mount, 'sh']
            line += [*script, str(place / 'bag'), *words, str(bag)]
        with start(line, stderr=subprocess.PIPE, text=True) as process:
            try:
                until = time.monotonic() + WAY_MAX
                while kill_at is not None and given[0] < kill_at and process.poll() is None:
                    assert time.monotonic() < until, 'the recorder hangs'
                    time.sleep(0.0002)
                if kill_at is not None:
                    process.kill()
                _, said = process.communicate(timeout=WAY_MAX)
            finally:
                process.kill()
        return Recorder(bag, first, int(given[0]), process.returncode, said)


@pytest.fixture
def recorders(tmp_path, root):
    """Recorders of the day."""
    return Recorders(tmp_path, root)


def check_kept(recorder, messages, one):
    """Check all that a bag holds, byte by byte; hand it on to one bag; return up to where it goes.

    The recorder may have been killed before it had begun its bag.
    """
    number = recorder.first
    try:
        repaired = repair(recorder.bag)
    except BagError:
        assert recorder.given - recorder.first <= day.RATE
        return number
    with BagReader(repaired.path) as reader:
        counts = {name: item.message_count for name, item in reader.connections.items()}
        for item in reader.messages([day.TOPIC], raw=True):
            assert item.log_time == day.stamp(number)
            assert item.message == messages[number]
            one.write(day.TOPIC, item.log_time, item.log_time, item.message)
            number += 1
    if number > recorder.first:
        assert counts[day.SETTING] == 1, 'what the parts repeat is there once'
    assert 0 <= recorder.given - number <= day.RATE, 'more than the last second is lost'
    for part in storage_files(recorder.bag)[:-1]:
        with BagReader(part) as reader:
            assert reader.problems == []
            assert reader.attachments()[day.MODEL].text == 'steel'
    return number


def incidents(random_state):
    """Return what ends the recorders: messages to a kill, or sizes of a disk [MB], shuffled."""
    kills = [random_state.randrange(1, LENGTH_MAX) for _ in range(KILLS)]
    for place in range(0, KILLS, 4):  # some around a change of parts
        change = PART_MESSAGES * (1 + kills[place] // PART_MESSAGES)
        kills[place] = change + random_state.randrange(-3, 6)
    found = [{'kill': number} for number in kills]
    found += [{'disk': random_state.uniform(*DISKS)} for _ in range(FULL)]
    random_state.shuffle(found)
    return found


def test_messages_of_the_day_are_those_that_are_serialised():
    messages = day.Messages()
    for number in (0, 1, 996, 997, 500_000, day.MESSAGES - 1):
        assert messages[number] == day.message(number)


@pytest.mark.qualify
def test_killed_at_twenty_points_of_a_day_and_the_disk_full_at_five(recorders, tmp_path):
    """Each recorder is followed by one that goes on with the next message, until the day is over.

    A disk is full in a mount of its own: needs user name spaces (`unshare -Urm`).
    """
    messages = day.Messages()
    one = BagWriter(tmp_path / 'one', flush_interval=None)
    one.add_topic(day.TOPIC, day.Temperatures.TYPE)
    reached, lost, parts = 0, [], 0
    for incident in incidents(random.Random(SEED)):
        if 'kill' in incident:
            done = recorders.run(reached, kill_at=reached + incident['kill'])
            assert done.code == -signal.SIGKILL, done.said
        else:
            done = recorders.run(reached, disk=incident['disk'])
            assert done.code == 1, done.said
            assert 'the disk is full' in done.said
        lost.append(done.given - check_kept(done, messages, one))
        parts += len(storage_files(done.bag))
        reached = done.given
    assert reached < day.MESSAGES, 'the day was too short for all that happened'
    done = recorders.run(reached)
    assert (done.code, done.given) == (0, day.MESSAGES), done.said
    assert check_kept(done, messages, one) == day.MESSAGES
    one.close()
    print(f'lost: {lost}, in all {sum(lost)} of {day.MESSAGES}; {parts} parts')
    assert one.message_count == day.MESSAGES - sum(lost)


@pytest.mark.ros
@pytest.mark.realtime
@pytest.mark.qualify
def test_node_killed_while_messages_come(graph, observer, tmp_path):
    """The recorder itself, at 10 Hz of wall time: what came a second before the kill is there."""
    random_state = random.Random(SEED)
    sender = observer.node.create_publisher(
        message_class(day.Temperatures.TYPE), day.TOPIC, subscription_qos(Durability.STREAM)
    )
    for life in range(NODE_KILLS):
        bag = tmp_path / f'bag{life}'
        recorder = graph.start(
            'recorder', {'output': str(bag), 'topics': f'^{day.TOPIC}$', 'split_duration': 1.5}
        )
        observer.until(lambda: sender.get_subscription_count() == 1, 'a recorder that listens')
        sent = []
        length = random_state.uniform(3.0, 8.0)
        begun = time.monotonic()
        while time.monotonic() < begun + length:
            if time.monotonic() >= begun + len(sent) / day.RATE:
                sender.publish(day.message(len(sent)))
                sent.append(time.monotonic())
            observer.spin()
        killed = time.monotonic()
        graph.kill(recorder)
        observer.until(lambda: sender.get_subscription_count() == 0, 'nobody listens any more')
        assert len(storage_files(bag)) > 1
        with BagReader(repair(bag).path) as reader:
            # The middleware fills a message up to a multiple of four bytes.
            size = len(day.message(0))
            kept = [item.message[:size] for item in reader.messages([day.TOPIC], raw=True)]
        assert kept == [day.message(number) for number in range(len(kept))]
        lost = sent[len(kept) :]
        assert not lost or killed - lost[0] <= 1.0


@pytest.mark.qualify
def test_parts_of_a_day_are_one_bag(recorders, fuzzycnc, tmp_path):
    """24 parts of an hour; `fuzzycnc replay --hash` says of them what it says of one file."""
    said = {}
    for name, split in (('parts', 3600.0), ('one', 0.0)):
        done = recorders.run(0, split=split)
        assert (done.code, done.given) == (0, day.MESSAGES), done.said
        assert len(storage_files(done.bag)) == (24 if split else 1)
        file = tmp_path / f'{name}.json'
        assert fuzzycnc('replay', done.bag, '--hash', '--json', file).code == 0
        said[name] = json.loads(file.read_text())
    assert set(said['one']['topics']) == {day.SETTING, day.TOPIC}
    assert said['parts'] == said['one']
