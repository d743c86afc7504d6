# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Whole bags with content that no machine records."""

import random
from dataclasses import replace
from pathlib import Path

import numpy as np
from benches import predictor_bench
from fuzzing.motion_targets import SchedulerTarget
from fuzzing.record_mutations import ROSBAGS

from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.components.motion.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.host import MachineTick
from fuzzycnc_ros.runtime.provenance import configuration_record, event_record
from fuzzycnc_ros.runtime.records import SECOND


def run_of(path: Path, change, rows: int = 60) -> Path:
    """Write a run whose samples are changed."""
    run = predictor_bench.recordings()['T1']
    with BagWriter(path, flush_interval=None) as writer:
        for row in range(rows):
            for topic, record in (
                ('/mill/displacement', predictor_bench.probe_of(run, row)),
                ('/mill/temperatures', predictor_bench.sample_of(run, row)),
            ):
                changed = change(record, row)
                writer.add_topic(topic, changed.TYPE)
                writer.write_message(topic, encode(changed, ROSBAGS), row)
    return path


def numbers_of(record) -> str:
    """Return the field of a record that holds its numbers."""
    return 'temperature' if hasattr(record, 'temperature') else 'displacement'


def filled(value: float):
    """Return a change that puts one number everywhere."""

    def change(record, row):
        name = numbers_of(record)
        return replace(record, **{name: np.full(len(getattr(record, name)), value)})

    return change


def run_of_nothing(path):
    return run_of(path, filled(np.nan))


def run_of_infinities(path):
    return run_of(path, filled(np.inf))


def run_of_the_largest_numbers(path):
    return run_of(path, filled(1.7e308))


def run_of_changing_huge_numbers(path):
    def change(record, row):
        name = numbers_of(record)
        return replace(record, **{name: 1e300 * (-1.0) ** row * getattr(record, name)})

    return run_of(path, change)


def run_over_centuries(path):
    return run_of(path, lambda record, row: replace(record, stamp=row**4 * 100 * SECOND))


def run_out_of_order(path):
    return run_of(path, lambda record, row: replace(record, stamp=(row * 17 % 40) * 60 * SECOND))


def run_of_very_many_sensors(path):
    count = 20_000
    names = tuple(f'n{k}' for k in range(count))

    def change(record, row):
        if not hasattr(record, 'sensor'):
            return record
        rise = np.linspace(20.0, 30.0, count) * (1.0 + 0.01 * row)
        return replace(record, sensor=names, temperature=rise, status=np.zeros(count, np.uint8))

    return run_of(path, change)


def run_of_one_name(path):
    def change(record, row):
        if not hasattr(record, 'sensor'):
            return record
        return replace(record, sensor=('n',) * len(record.sensor))

    return run_of(path, change)


def run_whose_stamps_jump(path):
    """A path of a year at the feed that it asks for, and a turn in the far future."""
    target, stamp = SchedulerTarget(), 1000 * SECOND
    scheduler = FeedrateScheduler()
    slow = replace(
        target.good('tool_path', stamp, random.Random(0)),
        stamp=stamp + SECOND,
        feedrate=np.array([1e-9, 1e-9, np.nan]),
    )
    rest = [
        (name, target.good(name, at, random.Random(0)))
        for name in target.inputs[:3]
        for at in (stamp, stamp + SECOND)
    ]
    turn = MachineTick(
        stamp=10**9 * SECOND,
        tick=1,
        node='feedrate_scheduler',
        probe=False,
        topic=(),
        published=np.zeros(0, np.uint64),
        readers=np.zeros(0, np.uint32),
    )
    records = [
        ('node_configuration', configuration_record(scheduler, 0, 'inactive')),
        ('node_event', event_record(scheduler, SECOND, 'activate', {})),
        *rest,
        ('tool_path', slow),
        ('machine_tick/feedrate_scheduler', turn),
    ]
    with BagWriter(path, flush_interval=None) as writer:
        for number, (topic, record) in enumerate(records):
            writer.add_topic(f'/mill/{topic}', record.TYPE)
            writer.write_message(f'/mill/{topic}', encode(record, ROSBAGS), number)
    return path


CASES = (
    run_of_nothing,
    run_of_infinities,
    run_of_the_largest_numbers,
    run_of_changing_huge_numbers,
    run_over_centuries,
    run_out_of_order,
    run_of_very_many_sensors,
    run_of_one_name,
    run_whose_stamps_jump,
)
"""Each writes a bag to a path."""
