# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest
from processes import HANG, start, wait_for

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.cli import console
from fuzzycnc_ros.ros.recording import recorder_command


def test_arguments_keep_names_that_look_like_numbers(tmp_path):
    parameters = {'topics': '/(a|b)$', 'lockstep': True}
    arguments = recorder_command(tmp_path / '2024', 'mill_1', parameters)
    assert arguments[3:6] == ['--ros-args', '-r', '__ns:=/mill_1']
    assert f'output:="{tmp_path / "2024"}"' in arguments
    assert 'topics:="/(a|b)$"' in arguments
    assert 'lockstep:=true' in arguments


def test_recording_without_ros_names_the_remedy(refused, monkeypatch):
    monkeypatch.setattr(console, 'find_spec', lambda name: None)
    refused('record', '--out', 'b', naming=['rclpy', 'Jazzy'])


def test_a_secret_starts_no_process(refused, monkeypatch):
    """It would stand in the list of processes."""
    monkeypatch.setattr('fuzzycnc_ros.cli.bags.record.subprocess.Popen', None)
    text = refused(
        *('record', '--out', 'b', '--ship', 'sftp://mill:s3same@host/a'),
        naming=['expected a URL without a password'],
    )
    assert 's3same' not in str(text)


@pytest.fixture
def environment(root, domain):
    """A graph of its own on this host, and this source tree for processes in other folders."""
    return {
        **os.environ,
        'PYTHONPATH': os.pathsep.join([str(root), os.environ.get('PYTHONPATH', '')]),
        'ROS_DOMAIN_ID': str(domain),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    }


@pytest.fixture
def machine(environment):
    """A simulated machine that ticks fast."""
    command = [sys.executable, '-m', 'fuzzycnc_ros.nodes.simulated_machine', '--ros-args']
    command += ['-r', '__ns:=/mill', '-p', 'rate:=600.0', '-p', "duties:=['T2', 'T2', 'T2', 'T2']"]
    process = start(command, env=environment)
    yield process
    process.kill()
    process.wait()


@contextmanager
def recording(arguments, folder, environment, **options):
    """Run `fuzzycnc record` in a folder."""
    command = [sys.executable, '-m', 'fuzzycnc_ros.cli.main', 'record', '--out', 'bag', *arguments]
    pipes = {'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE, 'text': True}
    with start(command, cwd=folder, env=environment, **pipes, **options) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.ros
@pytest.mark.parametrize(
    ('wish', 'interrupts'),
    [
        (signal.SIGTERM, 'ignored'),
        pytest.param(signal.SIGINT, 'default', marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, 'ignored', marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, 'default', marks=pytest.mark.slow),
    ],
)
def test_record_until_asked_to_end(tmp_path, environment, machine, wish, interrupts):
    pytest.importorskip('rclpy')
    file = tmp_path / 'bag' / 'bag_0.mcap'
    arguments = ['--json', 'figures.json']
    with recording(arguments, tmp_path, environment, interrupts=interrupts) as process:

        def recorded():
            return file.exists() and file.stat().st_size > 20_000

        wait_for(lambda: recorded() or process.poll() is not None, 'something is recorded')
        process.send_signal(wish)
        out, err = process.communicate(timeout=HANG)
    assert process.returncode == 0, err
    with BagReader(tmp_path / 'bag') as reader:
        counts = {topic: item.message_count for topic, item in reader.connections.items()}
    assert counts['/mill/sensor_readings'] > 0
    figures = json.loads((tmp_path / 'figures.json').read_text())
    assert figures['topics'] == counts
    assert figures['messages'] == sum(counts.values())
    assert 'messages on' in out


@pytest.mark.ros
def test_record_for_a_time(tmp_path, environment):
    pytest.importorskip('rclpy')
    with recording(['--duration', '0.5'], tmp_path, environment) as process:
        _, err = process.communicate(timeout=HANG)
    assert process.returncode == 0, err
    with BagReader(tmp_path / 'bag'):
        pass


@pytest.mark.ros
def test_what_the_recorder_refuses_is_passed_on(tmp_path, environment):
    pytest.importorskip('rclpy')
    with recording(['--topics', '('], tmp_path, environment) as process:
        _, err = process.communicate(timeout=HANG)
    assert process.returncode == 2
    assert [line for line in err.splitlines() if line.startswith('error: ')] == err.splitlines()
    assert 'topics' in err
