# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc record`: the topics of a live graph into a bag."""

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from fuzzycnc_ros.bags.recording_loss import LACKING, loss
from fuzzycnc_ros.cli.bags.keeping import (
    Budget,
    FreeMin,
    Ship,
    SplitDuration,
    SplitSize,
    keeping_parameters,
)
from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_at_least,
    check_folder,
    check_new_folder,
    check_ros,
    complain,
    write_json,
)
from fuzzycnc_ros.cli.options import OptionalNumber, given
from fuzzycnc_ros.cli.quantities import number_in
from fuzzycnc_ros.core.units import TIMES
from fuzzycnc_ros.graph.bring_up import RECORDER_STOP, machine_name
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.ros.processes import child_set_up, prepare_environment
from fuzzycnc_ros.ros.recording import recorder_command


def record(
    out: Annotated[Path, typer.Option(metavar='BAG', help='Directory of the new bag.')],
    machine: Annotated[
        str, typer.Option(help='Machine to record: the namespace of its topics.')
    ] = 'mill',
    topics: Annotated[
        str,
        typer.Option(
            metavar='REGEX',
            help='Topics to record, absolute names; all of the machine without it.',
        ),
    ] = '',
    lockstep: Annotated[
        bool,
        typer.Option(
            '--lockstep', help='Take part in a lock-step run, so that no message is lost.'
        ),
    ] = False,
    duration: Annotated[
        OptionalNumber,
        given(
            'Stop after this time, in s unless it has a unit, such as 8h; else Ctrl-C stops.',
            metavar='TIME',
            read=number_in(TIMES, 'a time'),
        ),
    ] = None,
    split_size: SplitSize = None,
    split_duration: SplitDuration = None,
    budget: Budget = None,
    free_min: FreeMin = None,
    ship: Ship = None,
    json_file: JsonFile = None,
) -> None:
    """Record the topics of a live machine, undecoded, until Ctrl-C.

    `ros2 bag info` and `ros2 bag play` read the bag. Topics are recorded from when they appear.
    Lost messages and holes in samples are counted, written into the bag, and end the
    command with code 1; if this process is killed, at most the last second is lost, and
    `fuzzycnc info BAG --repair` makes the bag whole.

        fuzzycnc record --machine mill_1 --out monday
        fuzzycnc record --out axes --topics '/(joint_states|tf)$' --duration 60s

    For years: a part each hour, the newest 50 GB here, all of them on another disk:

        fuzzycnc record --out mill --split-duration 1h --budget 50GB --ship /mnt/archive
    """
    check_at_least('--duration', duration, 0.0)
    machine = machine_name(machine) if machine.strip('/') else ''
    keeping = keeping_parameters(split_size, split_duration, budget, free_min, ship)
    check_new_folder(out)
    check_folder(json_file)
    check_ros('recording')
    prepare_environment()
    parameters = {'topics': topics, 'lockstep': lockstep, **keeping}
    code = _run_recorder(recorder_command(out, machine, parameters), out, duration)
    if code == 0 and json_file is not None:
        write_json(json_file, _figures(out))
    if code == 0:
        lacking = loss(out)
        if lacking:
            complain(lacking)
            code = LACKING
    if code:
        raise typer.Exit(code)


def _run_recorder(command: list[str], bag: Path, duration: float | None) -> int:
    """Run the node as a process of its own, and hand it every wish to end."""
    # Its own session: a Ctrl-C at the terminal must reach it once, from here.
    process = subprocess.Popen(command, start_new_session=True, preexec_fn=child_set_up())
    wished = False
    try:
        # Time counts from the bag's beginning: a node takes a while to start.
        _wait(process, bag.exists)
        began = time.monotonic()
        _wait(process, lambda: duration is not None and time.monotonic() - began >= duration)
    except KeyboardInterrupt:
        wished = True  # to end, which is carried out below
    finally:
        if process.poll() is None:
            process.terminate()
    try:
        code = process.wait(RECORDER_STOP)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        raise GraphError(
            f'the recorder did not close {bag} within {RECORDER_STOP:g} s and was killed; make '
            f'the bag whole with `fuzzycnc info {bag} --repair`'
        ) from None
    if wished and code < 0:
        raise KeyboardInterrupt  # before the recorder had begun
    return code


def _wait(process: subprocess.Popen[bytes], done: Callable[[], bool]) -> None:
    while process.poll() is None and not done():
        time.sleep(0.05)


def _figures(bag: Path) -> dict[str, Any]:
    from fuzzycnc_ros.bags.reader import BagReader

    with BagReader(bag) as reader:
        recording = reader.attachments().get('recording.json')
        return {
            'bag': str(bag),
            'messages': reader.message_count,
            'duration_s': 1e-9 * (reader.stop - reader.start),
            'topics': {
                topic: item.message_count for topic, item in sorted(reader.connections.items())
            },
            'recording': None if recording is None else json.loads(recording.data),
        }
