# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bags made to do harm go through everything that reads bags.

Each is read or refused, within the bounds of `campaign`.
"""

import shutil
import struct
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from benches import predictor_bench
from fuzzing import campaign, hostile_files, hostile_runs
from fuzzing import raw_bags as raw
from fuzzing.campaign import refusal

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.bags.finding import NamedBag
from fuzzycnc_ros.bags.playback import messages, played_topics
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.bags.typestore import message_definition
from fuzzycnc_ros.cli.models.evaluate import judge_bag
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.replay.replay import ReplayError, replay

pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning')


@cache
def model_text() -> str:
    """Return a model of the machine that the runs are of."""
    return predictor_bench.model_text()


def read_all(bag: Path, strict: bool) -> None:
    """Read a bag with all that it holds."""
    with BagReader(bag, strict=strict) as reader:
        reader.attachments()
        for _ in reader.messages():
            pass


def play(bag: Path) -> None:
    """Take a bag as the player does."""
    with BagReader(bag) as reader:
        for _ in messages(reader, played_topics(reader, reader.connections)):
            pass


def train(bag: Path) -> None:
    """Train on a bag."""
    train_model([read_run(bag)], candidates=('least_squares', 'lag_ridge')).to_json()


def evaluate(bag: Path) -> None:
    """Judge a model on a bag."""
    judged = judge_bag(
        NamedBag(bag, bag.stem),
        lambda *told: None,
        model_text=model_text(),
        start=None,
        probe_every=None,
        end=None,
        page=False,
    )
    assert np.isfinite(judged.evaluation.in_domain)


def uses(bag: Path, out: Path) -> Iterator[Callable[[], object]]:
    """Yield everything that reads a bag."""
    yield lambda: read_all(bag, True)
    yield lambda: read_all(bag, False)
    yield lambda: repair(bag, out)
    yield lambda: play(bag)
    yield lambda: replay(bag)
    yield lambda: read_run(bag)
    yield lambda: train(bag)
    yield lambda: evaluate(bag)


SLOW = (
    'chunk_of_the_smallest_messages',
    'chunks_that_overlap',
    'database_of_large_messages',
    'metadata_of_a_million_values',
    'one_topic_of_many_qos',
    'run_of_very_many_sensors',
    'very_many_topics',
)
CASES = [
    pytest.param(make, id=make.__name__, marks=[pytest.mark.slow] * (make.__name__ in SLOW))
    for make in hostile_files.CASES + hostile_runs.CASES
]


@pytest.mark.parametrize('make', CASES)
def test_hostile_bags_are_read_or_refused(make, tmp_path):
    bag = make(tmp_path / ('bag.mcap' if make in hostile_files.CASES else 'bag'))
    for use in uses(bag, tmp_path / 'repaired'):
        refusal(ValueError, use)
    shutil.rmtree(tmp_path, ignore_errors=True)


def test_what_costs_without_bound_is_found(monkeypatch):
    monkeypatch.setattr(campaign, 'COST_MAX', 3.0)
    monkeypatch.setattr(campaign, 'GLANCE', 0.1)

    def endless():
        while True:
            pass

    with pytest.raises(campaign.CostsTooMuch, match='at most 3 times'):
        refusal(ValueError, endless)


def test_honest_bags_are_read(tmp_path):
    """What is refused above is not refused for the way it is written."""
    run = hostile_runs.run_of(tmp_path / 'run', lambda record, row: record)
    named = ('read', 'read', 'repair', 'play', 'replay', 'read_run', 'train', 'evaluate')
    for name, use in zip(named, uses(run, tmp_path / 'repaired'), strict=True):
        assert bool(refusal(ValueError, use)) is (name == 'replay'), name  # it is no recording
    hello = raw.chunk(raw.message(1, 2), 2, 2)
    file = raw.mcap(
        tmp_path / 'a.mcap',
        [
            hostile_files.announced(definition=message_definition(raw.STRING)),
            hello,
            raw.attachment('a'),
        ],
    )
    database = raw.db3(
        tmp_path / 'a.db3',
        [
            "INSERT INTO topics VALUES(1, '/topic0', 'std_msgs/msg/String', 'cdr', '')",
            f'INSERT INTO messages {raw.rows(12_000)} SELECT n, 1, n, x'
            f"'{raw.HELLO.hex()}' FROM numbers",
        ],
    )
    for bag, count in ((file, 1), (database, 12_000)):
        with BagReader(bag) as reader:
            found = list(reader.messages())
        assert [item.message.data for item in found] == count * ['hi']
        assert [item.log_time for item in found] == sorted(item.log_time for item in found)


def test_a_chunk_of_another_size_than_it_states_is_damaged(tmp_path):
    data = raw.message(1, 2)
    head = struct.pack('<QQQI', 0, 9, len(data) + 1, 0) + raw.text('')
    chunk = raw.record(raw.CHUNK, head + struct.pack('<Q', len(data)) + data)
    file = raw.mcap(tmp_path / 'a.mcap', [hostile_files.announced(), chunk])
    with pytest.raises(BagFormatError, match=f'expected {len(data) + 1} bytes but found'):
        read_all(file, True)


@pytest.mark.parametrize(
    ('make', 'complaint'),
    [
        (hostile_files.chunk_that_hides_its_size, 'cannot be decompressed'),
        (hostile_files.chunk_of_lz4_that_hides_its_size, 'expected 100 bytes but found more'),
        (hostile_files.chunk_that_needs_a_window_of_a_gigabyte, 'requires too much memory'),
    ],
)
def test_chunks_that_unpack_to_more_are_damaged(tmp_path, make, complaint):
    file = make(tmp_path / 'a.mcap')
    assert file.stat().st_size < 3_000_000
    assert complaint in refusal(BagFormatError, lambda: read_all(file, True))


@pytest.mark.slow
def test_large_messages_are_read_a_few_at_a_time(tmp_path):
    bag = hostile_files.database_of_large_messages(tmp_path / 'a')

    def read():
        with BagReader(bag) as reader:
            assert sum(len(item.message) for item in reader.messages(raw=True)) == 600_000_000

    assert refusal(ValueError, read) == ''


def test_replay_of_stamps_that_jump_says_so(tmp_path):
    bag = hostile_runs.run_whose_stamps_jump(tmp_path / 'bag')
    assert 'cut the bag where the stamps jump' in refusal(ReplayError, lambda: replay(bag))
