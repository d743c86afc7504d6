# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bags in several parts: split, read as one and alone, deleted beyond a budget, killed."""

import json
import random
import shutil
import subprocess
import sys
import threading
from itertools import pairwise
from pathlib import Path

import pytest
import yaml

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.bags.errors import BagCountError, BagTruncatedError, BagWriteError
from fuzzycnc_ros.bags.metadata import Qos, read_metadata, storage_files
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.recorder import DISK_FULL, REPORT_NAME, TOO_SLOW, RecordingThread
from fuzzycnc_ros.bags.recording_loss import gaps, loss
from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.bags.typestore import serialize
from fuzzycnc_ros.bags.writer import LATCHED_MAX, BagWriter

NUMBER = 'std_msgs/msg/UInt64'
LATCHED = Qos(depth=1, durability='transient_local')
STEP = 20_000_000
"""Time between two messages [ns]."""
HANG = 120.0
"""Wall time [s] after which something hangs."""


def payload(number):
    return b'\x00\x01\x00\x00' + number.to_bytes(8, 'little')


def record(path, count=500, *, keep=None, thread=None, **options):
    """Record numbers, and two publishers' settings, one of which changes in the middle."""
    thread = RecordingThread(BagWriter(path, **options), **(keep or {}))
    thread.add_topic('/numbers', NUMBER)
    thread.add_topic('/settings', NUMBER, LATCHED)
    thread.put('/settings', payload(1), 0, sequence=1, publisher='x')
    thread.put('/settings', payload(2), 0, sequence=1, publisher='y')
    thread.attach('model', 'steel')
    for k in range(count):
        if k == count // 2:
            thread.put('/settings', payload(3), k * STEP, sequence=2, publisher='x')
        thread.put('/numbers', payload(k), k * STEP, sequence=k + 1)
    return thread, thread.close()


def numbers(path, topic='/numbers'):
    with BagReader(path) as reader:
        return [m.message.data for m in reader.messages([topic])]


# Splitting


@pytest.mark.parametrize(
    'options', [{'split_duration': 1.0}, {'split_size': 4096, 'chunk_size': 512}]
)
def test_parts_read_as_one_bag(tmp_path, options):
    _, one = record(tmp_path / 'one')
    _, many = record(tmp_path / 'many', **options)
    parts = storage_files(tmp_path / 'many')
    assert len(parts) == many.parts > 3
    assert one.parts == 1
    assert [part.name for part in parts] == [f'many_{k}.mcap' for k in range(len(parts))]
    assert numbers(tmp_path / 'many') == list(range(500))
    assert numbers(tmp_path / 'many', '/settings') == [1, 2, 3]
    assert topic_hashes(tmp_path / 'many') == topic_hashes(tmp_path / 'one')
    with BagReader(tmp_path / 'many') as reader:
        assert (reader.message_count, reader.problems, reader.missing_parts) == (503, [], 0)


def test_repair_counts_what_each_part_repeats_once(tmp_path):
    """Nothing of a sound bag is lost, though its parts hold more messages than it has."""
    record(tmp_path / 'bag', split_duration=1.0)
    topics = repair(tmp_path / 'bag').topics
    found = {name: (topic.kept, topic.lost) for name, topic in topics.items()}
    assert found == {'/numbers': (500, 0), '/settings': (3, 0)}


def test_a_part_is_read_alone(tmp_path):
    """What is latched stands at the beginning of each, of each publisher the newest."""
    record(tmp_path / 'bag', split_duration=1.0)
    for place, part in enumerate(storage_files(tmp_path / 'bag')):
        with BagReader(part) as reader:
            messages = list(reader.messages())
            assert reader.missing_parts == place
            assert reader.attachments()['model'].text == 'steel'
        settings = [m.message.data for m in messages if m.topic == '/settings']
        # The order is that in which they were sent.
        assert settings == ([1, 2] if place < 5 else [1, 2, 3] if place == 5 else [2, 3])
        own = [m.message.data for m in messages if m.topic == '/numbers']
        assert own == list(range(50 * place, 50 * place + 50))
        assert [m.log_time for m in messages] == sorted(m.log_time for m in messages)
        assert messages[0].log_time == own[0] * STEP


def test_metadata_names_all_parts_as_rosbag2_does(tmp_path):
    record(tmp_path / 'bag', split_duration=1.0)
    content = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())
    said = content['rosbag2_bagfile_information']
    assert said['version'] == 9
    assert said['relative_file_paths'] == [f'bag_{k}.mcap' for k in range(10)]
    assert [entry['path'] for entry in said['files']] == said['relative_file_paths']
    for k, entry in enumerate(said['files']):
        assert entry['starting_time'] == {'nanoseconds_since_epoch': k * 10**9}
        assert entry['duration'] == {'nanoseconds': 49 * STEP}
        with BagReader(tmp_path / 'bag' / entry['path']) as reader:
            assert entry['message_count'] == reader.message_count
    # rosbag2 counts what lies in the files.
    assert said['message_count'] == sum(entry['message_count'] for entry in said['files'])
    assert said['starting_time'] == {'nanoseconds_since_epoch': 0}
    assert said['duration'] == {'nanoseconds': 499 * STEP}
    read = read_metadata(tmp_path / 'bag')
    assert [part.path for part in read.parts] == said['relative_file_paths']
    assert read.parts[3].start == 3 * 10**9
    assert read.parts[3].stop == 3 * 10**9 + 49 * STEP


def test_without_split_a_bag_is_one_file(tmp_path):
    _, progress = record(tmp_path / 'bag')
    assert progress.parts == 1
    assert [path.name for path in storage_files(tmp_path / 'bag')] == ['bag_0.mcap']


def test_publishers_whose_settings_are_repeated_are_bounded(tmp_path):
    writer = BagWriter(tmp_path / 'bag', split_duration=1.0)
    writer.add_topic('/settings', NUMBER, LATCHED)
    for k in range(LATCHED_MAX + 10):
        writer.write('/settings', 0, 0, payload(k), 1, k)
    writer.split(10**9)
    writer.close()
    found = numbers(storage_files(tmp_path / 'bag')[1], '/settings')
    assert found == list(range(10, LATCHED_MAX + 10))


@pytest.mark.slow
def test_more_parts_than_a_process_may_open(tmp_path):
    record(tmp_path / 'bag', 300, split_duration=STEP / 1e9)
    parts = storage_files(tmp_path / 'bag')
    assert len(parts) == 300
    script = """
import resource, sys
from fuzzycnc_ros.bags.reader import BagReader
with BagReader(sys.argv[1]) as reader:
    print(sum(1 for _ in reader.messages()), len(reader.attachments()))
"""
    line = f'ulimit -n 128 && exec {sys.executable} -c "$0" "$1"'
    done = subprocess.run(
        ['sh', '-c', line, script, str(tmp_path / 'bag')], capture_output=True, text=True
    )
    assert done.stdout.split() == ['303', '2'], done.stderr


def test_replay_of_parts_is_that_of_one_bag(tmp_path, small_bag):
    """The recorded messages of a run, written anew in parts."""
    with BagReader(small_bag) as reader:
        writer = BagWriter(tmp_path / 'parts', split_size=2000, chunk_size=512)
        for topic, item in reader.connections.items():
            writer.add_topic(topic, item.type, item.profiles)
        for topic, _, log_time, message in reader.messages(raw=True):
            if writer.is_full(log_time):
                writer.split(log_time)
            writer.write(topic, log_time, log_time, message)
        writer.close()
    assert len(storage_files(tmp_path / 'parts')) > 3
    assert topic_hashes(tmp_path / 'parts') == topic_hashes(small_bag)


def test_disk_that_is_full_at_a_split(tmp_path, monkeypatch):
    writer = BagWriter(tmp_path / 'bag', split_duration=1.0)
    writer.add_topic('/numbers', NUMBER)
    writer.write('/numbers', 0, 0, payload(0))

    def refuse(path, text):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr('fuzzycnc_ros.bags.metadata.write_text', refuse)
    with pytest.raises(BagWriteError, match='the disk is full'):
        writer.split(10**9)
    monkeypatch.undo()
    with pytest.raises(BagWriteError, match='the disk is full'):
        writer.write('/numbers', 10**9, 10**9, payload(1))
    writer.close()
    assert repair(tmp_path / 'bag').topics['/numbers'].kept == 1


# Budget


def test_oldest_parts_are_deleted_beyond_the_budget(tmp_path):
    record(tmp_path / 'whole', split_duration=1.0)
    size = sum(part.stat().st_size for part in storage_files(tmp_path / 'whole'))
    budget = size // 2
    thread, progress = record(tmp_path / 'bag', split_duration=1.0, keep={'budget': budget})
    parts = storage_files(tmp_path / 'bag')
    assert 0 < len(parts) < 10
    assert progress.parts == len(parts)
    last = max(part.stat().st_size for part in parts)
    assert sum(part.stat().st_size for part in parts) <= budget + last
    first = 10 - len(parts)
    assert progress.deleted.startswith(f'{first} parts, all before ')
    texts = [text for _, text in thread.notices()]
    assert [text.split(',')[0] for text in texts] == [
        f'deleted bag_{k}.mcap' for k in range(first)
    ]
    assert numbers(tmp_path / 'bag') == list(range(50 * first, 500))
    with BagReader(tmp_path / 'bag') as reader:
        assert reader.problems == []
        assert reader.missing_parts == first
        # The beginning is gone, what was latched then is not.
        assert [m.message.data for m in reader.messages(['/settings'])][:2] in ([1, 2], [2, 3])
    assert loss(tmp_path / 'bag') == ''


def test_the_open_part_and_the_one_before_are_never_deleted(tmp_path):
    _, progress = record(tmp_path / 'bag', split_duration=1.0, keep={'budget': 1})
    assert progress.parts == 2
    assert numbers(tmp_path / 'bag') == list(range(400, 500))


def test_a_part_that_cannot_be_deleted_is_named(tmp_path, monkeypatch):
    def refuse(path, missing_ok=False):
        raise PermissionError(13, 'Permission denied')

    monkeypatch.setattr(Path, 'unlink', refuse)
    thread, progress = record(tmp_path / 'bag', 150, split_duration=1.0, keep={'budget': 1})
    monkeypatch.undo()
    assert (progress.lost, progress.error) == (0, '')
    urgent = [text for important, text in thread.notices() if important]
    assert len(urgent) == 1
    assert 'bag_0.mcap: cannot be deleted: Permission denied; delete it yourself' in urgent[0]


# A disk without room


class Disk:
    """Free space that a test sets."""

    def __init__(self, free):
        self.free = free

    def __call__(self, path):
        return self.free


def recording(tmp_path, disk, **options):
    thread = RecordingThread(
        BagWriter(tmp_path / 'bag', flush_interval=0.0), free_min=1000, free=disk, **options
    )
    thread.add_topic('/numbers', NUMBER)
    return thread


def until(condition):
    """Wait for a condition."""
    deadline = threading.Event()
    timer = threading.Timer(HANG, deadline.set)
    timer.start()
    try:
        while not condition():
            assert not deadline.wait(0.01)
    finally:
        timer.cancel()


def test_short_pause_costs_nothing(tmp_path):
    disk = Disk(5000)
    thread = recording(tmp_path, disk)
    thread.put('/numbers', payload(0), 0)
    until(lambda: thread.progress().written == 1)
    disk.free = 999
    until(lambda: thread.progress().paused)
    paused = thread.progress().paused
    assert 'less than free_min, 0.001 MB' in paused
    assert 'make room, it then goes on by itself' in paused
    for k in range(1, 10):
        assert thread.put('/numbers', payload(k), k)
    disk.free = 1050  # too little more
    assert thread.progress().written == 1
    disk.free = 1100
    until(lambda: thread.progress().written == 10)
    progress = thread.close()
    assert (progress.lost, progress.paused) == (0, '')
    assert [urgent for urgent, _ in thread.notices()] == [True, False]
    assert numbers(tmp_path / 'bag') == list(range(10))
    assert loss(tmp_path / 'bag') == ''


def test_hole_of_a_long_pause_is_noted(tmp_path):
    disk = Disk(0)
    thread = recording(tmp_path, disk, pending_max=3 * len(payload(0)))
    until(lambda: thread.progress().paused)
    taken = [thread.put('/numbers', payload(k), k * 10**9) for k in range(10)]
    assert taken == [True] * 3 + [False] * 7
    disk.free = 5000
    until(lambda: thread.progress().written == 3)
    assert thread.put('/numbers', payload(10), 10 * 10**9)
    until(lambda: thread.progress().written == 4)
    thread.close()
    with BagReader(tmp_path / 'bag') as reader:
        attachments = reader.attachments()
    assert json.loads(attachments[REPORT_NAME].data)['gaps'] == [
        {'from_s': 3.0, 'to_s': 10.0, 'messages': 7, 'cause': DISK_FULL}
    ]
    text = loss(tmp_path / 'bag')
    assert '7 messages of /numbers are lost' in text
    assert '7 messages from 3 to 10 s, since the disk was full' in text
    assert 'too busy' not in text


def test_hole_is_in_the_bag_as_soon_as_it_is_over(tmp_path):
    """A kill after it does not hide it."""
    disk = Disk(0)
    thread = recording(tmp_path, disk, pending_max=len(payload(0)))
    until(lambda: thread.progress().paused)
    assert thread.put('/numbers', payload(0), 0)
    assert not thread.put('/numbers', payload(1), 10**9)
    disk.free = 5000
    until(lambda: thread.progress().written == 1)
    assert thread.put('/numbers', payload(2), 2 * 10**9)

    def noted():
        shutil.rmtree(tmp_path / 'copy', ignore_errors=True)
        shutil.copytree(tmp_path / 'bag', tmp_path / 'copy')
        repair(tmp_path / 'copy', tmp_path / 'copy' / 'whole')
        with BagReader(tmp_path / 'copy' / 'whole') as reader:
            attachments = reader.attachments()
        return gaps(attachments) == ['1 messages from 1 to 2 s, since the disk was full']

    until(noted)
    thread.close()


def test_end_while_the_disk_is_full(tmp_path):
    """What waits is lost, and said to be; the bag is whole."""
    thread = recording(tmp_path, Disk(0))
    until(lambda: thread.progress().paused)
    for k in range(5):
        thread.put('/numbers', payload(k), k * 10**9)
    progress = thread.close()
    assert (progress.written, progress.lost) == (0, 5)
    assert '5 messages from 0 to 4 s, since the disk was full' in loss(tmp_path / 'bag')


def test_disk_that_is_too_slow_is_told_apart(tmp_path):
    thread = RecordingThread(BagWriter(tmp_path / 'bag'), pending_max=1)
    thread.add_topic('/numbers', NUMBER)
    thread.put('/numbers', payload(0), 0)
    thread.close()
    assert f'since {TOO_SLOW}' in loss(tmp_path / 'bag')


def test_disk_is_looked_at_within_large_messages(tmp_path):
    """Pictures of a megabyte fill a disk between two looks at a batch."""
    disk = Disk(5 * 2**20)
    kind = 'std_msgs/msg/UInt8MultiArray'
    thread = RecordingThread(
        BagWriter(tmp_path / 'bag', compression='none'), free_min=2 * 2**20, free=disk
    )
    thread.add_topic('/pictures', kind)
    written = threading.Event()
    write = thread._writer.write

    def fill(*arguments):
        write(*arguments)
        disk.free -= 2**20
        written.set()

    thread._writer.write = fill
    for k in range(10):
        thread.put('/pictures', bytes(2**20), k)
    assert written.wait(HANG)
    until(lambda: thread.progress().paused)
    assert thread.progress().written <= 4
    assert disk.free >= 2**20
    thread.close()


ON_A_SMALL_DISK = """
import shutil, sys, time
from pathlib import Path
from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.bags.recorder import RecordingThread
from fuzzycnc_ros.bags.writer import BagWriter

disk, out = Path(sys.argv[1]), Path(sys.argv[2])
ballast, free_min, pending_max = map(int, sys.argv[3:])
(disk / 'ballast').write_bytes(bytes(ballast))
writer = BagWriter(
    disk / 'bag', split_size=200_000, compression='none', flush_interval=0.0
)
thread = RecordingThread(writer, free_min=free_min, pending_max=pending_max)
thread.add_topic('/numbers', 'std_msgs/msg/UInt64')
sent = 0

def beat():
    global sent
    payload = b'\\0\\1\\0\\0' + sent.to_bytes(8, 'little') + bytes(2000)
    thread.put('/numbers', payload, sent * 10**7, sequence=sent + 1)
    sent += 1

def wait(over):
    deadline = time.monotonic() + 100.0
    while not over():
        assert time.monotonic() < deadline
        time.sleep(0.001)

def idle():
    progress = thread.progress()
    return not progress.pending_bytes or progress.paused or progress.error

while not (thread.progress().paused or thread.failed):
    beat()
    wait(idle)
for _ in range(40):
    beat()
if free_min:
    (disk / 'ballast').unlink()
    wait(lambda: not thread.progress().pending_bytes and not thread.progress().paused)
    for _ in range(20):
        beat()
        wait(idle)
code = 0
try:
    thread.close()
except BagError as error:
    print(error, file=sys.stderr)
    code = 1
progress = thread.progress()
print(sent, progress.written, progress.lost)
shutil.copytree(disk / 'bag', out)
sys.exit(code)
"""


def on_a_small_disk(tmp_path, ballast, free_min, pending_max):
    """Record on a disk of 4 MB, in a name space of its own; return how it ended."""
    disk = tmp_path / 'disk'
    disk.mkdir()
    mount = f'mount -t tmpfs -o size=4m none {disk} && exec "$@"'
    line = ['unshare', '-Urm', 'sh', '-c', mount, 'sh', sys.executable, '-c', ON_A_SMALL_DISK]
    numbers = [disk, tmp_path / 'bag', ballast, free_min, pending_max]
    return subprocess.run(
        [*line, *map(str, numbers)], capture_output=True, text=True, timeout=HANG
    )


@pytest.mark.parametrize('ballast', [500_000, 1_500_000, 2_500_000])
def test_recording_pauses_before_a_real_disk_is_full(tmp_path, ballast):
    done = on_a_small_disk(tmp_path, ballast, 400_000, 20_000)
    assert done.returncode == 0, done.stderr
    sent, written, lost = map(int, done.stdout.split())
    assert lost > 0
    assert written + lost == sent
    found = [int.from_bytes(data[4:12], 'little') for data in payloads(tmp_path / 'bag')]
    assert len(found) == written
    # One hole, in which as many are missing as the bag says, and 20 after it.
    (hole,) = [k for k, (a, b) in enumerate(pairwise(found)) if b != a + 1]
    assert found[hole + 1] - found[hole] - 1 == lost
    assert found[-1] == sent - 1
    assert f'{lost} messages from {(found[hole] + 1) / 100:.9g} to' in loss(tmp_path / 'bag')


@pytest.mark.parametrize('ballast', [800_000, 3_000_000])
def test_disk_that_is_full_all_the_same_is_no_success(tmp_path, ballast):
    done = on_a_small_disk(tmp_path, ballast, 0, 20_000)
    assert done.returncode == 1
    assert 'the disk is full' in done.stderr
    sent, written, lost = map(int, done.stdout.split())
    assert written + lost == sent
    found = payloads(repair(tmp_path / 'bag', tmp_path / 'repaired').path)
    numbers = [int.from_bytes(data[4:12], 'little') for data in found]
    assert numbers == list(range(len(numbers)))
    assert written - len(numbers) <= 16384 // 2000 + 2, 'only the last chunk may be lost'


def payloads(path):
    with BagReader(path) as reader:
        return [m.message for m in reader.messages(['/numbers'], raw=True)]


# Kill


WRITE_UNTIL_KILLED = """
import sys, time
from fuzzycnc_ros.bags.metadata import Qos
from fuzzycnc_ros.bags.recorder import RecordingThread
from fuzzycnc_ros.bags.writer import BagWriter

k = 0
# Time passes with the messages, however fast they are written.
writer = BagWriter(sys.argv[1], split_duration=0.5, clock=lambda: k / 50)
thread = RecordingThread(writer, budget=int(sys.argv[2]))
thread.add_topic('/settings', 'std_msgs/msg/UInt64', Qos(depth=1, durability='transient_local'))
thread.put('/settings', bytes([0, 1]) + bytes(10), 0, sequence=1, publisher='x')
thread.add_topic('/numbers', 'std_msgs/msg/UInt64')
while True:
    payload = b'\\0\\1\\0\\0' + k.to_bytes(8, 'little')
    thread.put('/numbers', payload, k * 20_000_000, sequence=k + 1)
    k += 1
    while thread.progress().written < k:
        time.sleep(0.0002)
    print(k, flush=True)
"""


def killed(tmp_path, at, budget=0):
    """Kill a recorder after so many messages and a random moment; return how many it wrote."""
    bag = tmp_path / 'bag'
    line = [sys.executable, '-c', WRITE_UNTIL_KILLED, str(bag), str(budget)]
    last = 0
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as process:
        for text in process.stdout:
            if text.endswith('\n'):
                last = int(text)
            if text == f'{at}\n':
                process.kill()
    assert process.returncode == -9
    assert last >= at
    return last


def check_killed(tmp_path, sent):
    bag = tmp_path / 'bag'
    trouble = []
    try:
        with BagReader(bag) as reader:  # killed after the end of a part, before the next one
            trouble = reader.problems
    # Or between the new list of parts and the end of the one that left it.
    except (BagTruncatedError, BagCountError) as error:
        trouble = [str(error)]
    assert any('info --repair' in text or 'did not finish' in text for text in trouble), trouble
    *whole, _ = storage_files(bag)
    for part in whole:
        with BagReader(part) as reader:
            assert reader.problems == []
    report = repair(bag, tmp_path / 'repaired')
    found = numbers(report.path)
    assert found == list(range(found[0], found[0] + len(found))), 'gap, disorder or repetition'
    assert sent - found[-1] <= 50, 'more than the last second'
    assert numbers(report.path, '/settings') == [0]
    return found


def test_killed_recorder_leaves_whole_parts(tmp_path):
    """Around a change of parts, which is every 25 messages."""
    sent = killed(tmp_path, 100)
    found = check_killed(tmp_path, sent)
    assert found[0] == 0
    assert len(storage_files(tmp_path / 'bag')) >= 4


def test_killed_recorder_with_a_budget(tmp_path):
    sent = killed(tmp_path, 201, budget=6000)
    assert check_killed(tmp_path, sent)[0] > 0


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(20))
def test_killed_at_a_random_point(tmp_path, seed):
    at = random.Random(seed).randrange(10, 400)
    sent = killed(tmp_path, at, budget=8000 if seed % 2 else 0)
    check_killed(tmp_path, sent)


@pytest.mark.slow
def test_a_scaled_day_in_parts(tmp_path, new):
    """76 sensors at 10 Hz, parts of an hour of 24: of each hour 90 s, so 21,600 messages."""
    names = [f'sensor{k}' for k in range(76)]
    kind = 'fuzzycnc_msgs/msg/Temperatures'
    hour, beats = 3600 * 10**9, 900
    for bag, options in (('one', {}), ('day', {'split_duration': 3600.0})):
        thread = RecordingThread(BagWriter(tmp_path / bag, **options))
        thread.add_topic('/mill/temperatures', kind)
        for k in range(24 * beats):
            stamp = 10**9 + (k // beats) * hour + (k % beats) * 10**8
            values = [20.0 + 1e-3 * (k % 977) + 0.1 * i for i in range(76)]
            message = serialize(new.temperatures(stamp, values, names))
            thread.put('/mill/temperatures', message, stamp, sequence=k + 1)
        assert thread.close().lost == 0
    assert len(storage_files(tmp_path / 'day')) == 24
    assert topic_hashes(tmp_path / 'day') == topic_hashes(tmp_path / 'one')
    for part in storage_files(tmp_path / 'day'):
        with BagReader(part) as reader:
            assert reader.message_count == beats
