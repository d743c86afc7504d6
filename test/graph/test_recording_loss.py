# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings that lack something end with code 1 and say what it is."""

import json
import os
import resource
import signal
import subprocess
import sys
from functools import partial

import pytest
from processes import HANG, children, said, start, wait_for
from std_msgs.msg import Header

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.runtime.host import RecorderProgress
from fuzzycnc_ros.runtime.records import SECOND, MachineState, Temperatures

pytestmark = pytest.mark.ros

NODES = 'temperature_acquisition'
ROOM = 100_000
"""What a disk takes before it is full [bytes]."""


def recorder_of(running):
    """Return the process id of the recorder of a command, which begins its bag by then."""
    wait_for(lambda: children(running.process.pid, 'nodes.recorder'), 'the recorder is started')
    (pid,) = children(running.process.pid, 'nodes.recorder')
    return pid


def fill_disk(pid, size):
    """Let the files of a process grow to some size only, as on a full disk."""
    hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)[1]
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, hard))


def up(command, bag, folder, rate=600):
    return command(
        *('up', '--simulate', 'T2', '--rate', rate, '--nodes', NODES),
        *('--record', bag, '--json', folder / 'outcome.json'),
    )


def errors(running):
    return [line for line in running.output.splitlines() if line.startswith('error: ')]


def test_recorder_whose_disk_is_full_at_the_end(domain, root, tmp_path):
    """All was well until the bag is to be closed."""
    bag = tmp_path / 'bag'
    line = [sys.executable, '-m', 'fuzzycnc_ros.nodes.recorder', '--ros-args']
    line += ['-p', f'output:={bag}', '-p', 'topics:=^/nothing$']
    environment = {
        **os.environ,
        'PYTHONPATH': os.pathsep.join([str(root), os.environ.get('PYTHONPATH', '')]),
        'ROS_DOMAIN_ID': str(domain),
    }
    with start(line, env=environment, stderr=subprocess.PIPE, text=True) as process:
        assert 'recording to' in process.stderr.readline()
        fill_disk(process.pid, (bag / 'bag_0.mcap').stat().st_size)
        process.send_signal(signal.SIGTERM)
        _, complaints = process.communicate(timeout=HANG)
    assert process.returncode == 1, complaints
    assert complaints.startswith('error: ')
    assert 'the file would be larger than allowed' in complaints


SLOW_TO_CLOSE = """
import os, time
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.nodes import recorder
from fuzzycnc_ros.ros import processes
close, interrupt = BagWriter.close, processes.interrupt
def slow(writer):
    os.write(1, b'closing\\n')
    while not os.path.exists(os.environ['ROOM']):
        time.sleep(0.01)
    close(writer)
def hear():
    os.write(1, b'wished\\n')  # a handler of signals must not print
    interrupt()
BagWriter.close, processes.interrupt = slow, hear
processes.ONE_WISH = 0.0  # each signal is a wish of its own
recorder.main()
"""
"""A recorder that has closed its bag when there is room for it, and tells each wish to end."""


def test_who_asks_again_does_not_tear_what_is_being_closed(domain, root, tmp_path):
    bag, room = tmp_path / 'bag', tmp_path / 'room'
    line = [sys.executable, '-c', SLOW_TO_CLOSE, '--ros-args', '-p', f'output:={bag}']
    environment = {
        **os.environ,
        'PYTHONPATH': os.pathsep.join([str(root), os.environ.get('PYTHONPATH', '')]),
        'ROS_DOMAIN_ID': str(domain),
        'ROOM': str(room),
    }
    pipes = {'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE}
    with start(line, env=environment, text=True, **pipes) as process:
        try:
            assert 'recording to' in process.stderr.readline()
            process.send_signal(signal.SIGTERM)
            # The first wish may come before `hear` stands for it, which tells nothing then.
            assert 'closing\n' in iter(partial(said, process), '')
            for number in (signal.SIGINT, signal.SIGTERM):
                process.send_signal(number)
                assert said(process) == 'wished\n'
        finally:
            room.touch()
        told, complaints = process.communicate(timeout=HANG)
    assert process.returncode == 0, complaints
    assert f'{bag}: ' in told
    with BagReader(bag) as reader:
        assert reader.problems == []


def test_publishers_that_end_before_their_recorder_are_told(graph, observer, tmp_path):
    """What they sent last may be missing, and no number shows it."""
    bag = tmp_path / 'bag'
    topics = ('/mill/ended', '/mill/stayed')
    publishers = [
        observer.node.create_publisher(Header, name, 10) for name in (*topics, topics[0])
    ]
    recorder = graph.start('recorder', {'output': str(bag), 'topics': '^/mill/(ended|stayed)$'})
    observer.until(lambda: all(item.get_subscription_count() for item in publishers), 'a recorder')
    told = observer.records('recorder/progress', RecorderProgress)
    for item in publishers:
        item.publish(Header())
    observer.until(lambda: told and told[-1].received == 3, 'all is received')
    observer.node.destroy_publisher(publishers[-1])
    # A recorder hears of publishers in order: who takes from a later one knows of this end.
    later = observer.node.create_publisher(Header, topics[1], 10)
    observer.until(later.get_subscription_count, 'the recorder')
    later.publish(Header())
    observer.until(lambda: told[-1].received == 4, 'the later publisher is heard')
    graph.stop()
    assert '4 messages on 2 topics, 0 lost; 1 publishers ended meanwhile, on /mill/ended' in (
        recorder.output
    )
    with BagReader(bag) as reader:
        recording = json.loads(reader.attachments()['recording.json'].data)
    assert recording['publishers_left'] == {'/mill/ended': 1}
    name = observer.node.get_fully_qualified_name()
    assert recording['publishers'] == {topic: [name] for topic in topics}


@pytest.mark.slow
def test_full_disk_ends_a_recording(command, observer, graph, tmp_path):
    graph.start('simulated_machine', {'rate': 600.0, 'duties': ['T2']})
    states = observer.records('machine_state', MachineState)
    observer.until(lambda: states, 'the machine runs')
    running = command('record', '--out', tmp_path / 'bag')
    fill_disk(recorder_of(running), ROOM)
    assert running.wait() == 1, running.output
    (line,) = errors(running)
    assert 'the file would be larger than allowed' in line


@pytest.mark.slow
def test_full_disk_is_no_success_of_a_supervised_run(command, observer, tmp_path):
    states = observer.records('machine_state', MachineState)
    running = up(command, tmp_path / 'bag', tmp_path)
    fill_disk(recorder_of(running), ROOM)
    observer.until(lambda: states, 'the machine runs')
    wait_for(lambda: 'mill/recorder ended with code 1' in running.output, 'the disk is full')
    assert running.interrupt(signal.SIGTERM) == 1, running.output
    (line,) = errors(running)
    assert 'the file would be larger than allowed' in line
    outcome = json.loads((tmp_path / 'outcome.json').read_text())
    assert outcome['exit_code'] == 1
    assert [f'error: {text}' for text in outcome['lacking']] == [line]


@pytest.mark.slow
def test_samples_that_are_lost(command, observer, tmp_path):
    """A node stands still while the machine goes on; in the other bag nothing is missing."""
    states = observer.records('machine_state', MachineState)
    samples = observer.records('temperatures', Temperatures)
    running = up(command, tmp_path / 'bag', tmp_path)
    observer.until(lambda: len(samples) > 20, 'temperatures come')
    (node,) = children(running.process.pid, f'nodes.{NODES}')
    graph_time = states[-1].stamp
    os.kill(node, signal.SIGSTOP)
    observer.until(lambda: states[-1].stamp > graph_time + 600 * SECOND, 'the machine goes on')
    os.kill(node, signal.SIGCONT)
    count = len(samples)
    observer.until(lambda: len(samples) > count + 3, 'it goes on, too')
    assert running.interrupt(signal.SIGTERM) == 1, running.output
    (line,) = errors(running)
    assert '/mill/temperatures has ' in line
    assert 'hole' in line
    with BagReader(tmp_path / 'bag') as reader:
        holes = json.loads(reader.attachments()['recording.json'].data)['holes']
    assert holes['/mill/temperatures']['longest_s'] > 300.0


@pytest.mark.slow
def test_a_whole_recording_is_a_success(command, observer, tmp_path):
    """So slow that a busy computer loses nothing either."""
    samples = observer.records('temperatures', Temperatures)
    running = up(command, tmp_path / 'bag', tmp_path, rate=60)
    observer.until(lambda: len(samples) > 4, 'temperatures come')
    assert running.interrupt(signal.SIGTERM) == 0, running.output
    assert json.loads((tmp_path / 'outcome.json').read_text())['lacking'] == []
