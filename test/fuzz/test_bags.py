# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile bags: damaged containers, and whole ones with content that no machine makes."""

import random
import shutil
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from benches import predictor_bench
from fuzzing.campaign import SEEDS, bounded, fuzz, refusal
from fuzzing.file_mutations import mutated_bytes, mutated_json, mutated_text
from fuzzing.record_mutations import ROSBAGS, mutated
from hypothesis import given

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.thermal.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.components.thermal.sensor_selector import SensorSelector
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisition
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.graph import InProcessGraph
from fuzzycnc_ros.runtime.host import NodeConfiguration, NodeEvent

pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning')

TICKS = 70


@cache
def recorded():
    """Return topics and records of a short run with everything that a replay needs."""
    found = []
    machine = SimulatedMachine(SimulatedMachineConfig(duties=('D0',)))
    graph = InProcessGraph(
        machine,
        [
            TemperatureAcquisition(),
            SensorSelector(),
            ThermalPredictor(),
            Compensator(CompensatorConfig()),
        ],
        sink=lambda topic, record: found.append((topic, record)),
        provenance=True,
    )
    graph.request('thermal_predictor', 'use_model', model=predictor_bench.model_text())
    graph.request('compensator', 'activate')
    for _ in range(TICKS):
        graph.step()
    return tuple(found)


def write(path: Path, records, **options) -> None:
    """Write records into a new bag."""
    shutil.rmtree(path, ignore_errors=True)
    with BagWriter(path, flush_interval=None, **options) as writer:
        for topic, record in records:
            writer.add_topic(f'/mill/{topic}', record.TYPE)
            writer.write_message(f'/mill/{topic}', encode(record, ROSBAGS), max(record.stamp, 0))
        writer.attach('model.json', '{}')


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp('fuzz')


@pytest.fixture(scope='module')
def bags(folder):
    """Bags to damage: compressed, and open to damage that no checksum tells."""
    some = [item for item in recorded() if item[0] != 'node_configuration'][:120]
    found = []
    for name, options in (
        ('zstd', {'chunk_size': 4096}),
        ('plain', {'chunk_size': 4096, 'compression': 'none'}),
    ):
        write(folder / name, some, **options)
        file = next((folder / name).glob('*.mcap'))
        found.append(((folder / name / 'metadata.yaml').read_text(), file.read_bytes()))
    found.append((found[1][0], without_checksums(found[1][1])))
    return found


def without_checksums(data: bytes) -> bytes:
    """Return an MCAP file whose chunks have no checksum, so that none tells of damage."""
    found = bytearray(data)
    at = 8
    while at + 9 < len(found):
        opcode, length = found[at], int.from_bytes(found[at + 1 : at + 9], 'little')
        if opcode == 6:
            found[at + 33 : at + 37] = bytes(4)
        at += 9 + length
    return bytes(found)


def read_all(path: Path, strict: bool) -> None:
    """Read everything that a bag gives."""
    with BagReader(path, strict=strict) as reader:
        reader.attachments()
        assert reader.start <= reader.stop
        for _, _, _, message in reader.messages(raw=True):
            assert isinstance(message, bytes)
        for topic in reader.connections:
            with suppress(BagError):  # one that cannot be decoded leaves the others
                list(reader.messages([topic]))


@fuzz(40, share=0.2)
@given(seed=SEEDS)
def test_damaged_bags(folder, bags, seed):
    rng = random.Random(seed)
    metadata, data = rng.choice(bags)
    bag = folder / 'damaged'
    shutil.rmtree(bag, ignore_errors=True)
    bag.mkdir()
    name = next(line.split()[-1] for line in metadata.splitlines() if line.endswith('.mcap'))
    if rng.random() < 0.2:
        metadata = mutated_text(metadata, rng)
    else:
        data = mutated_bytes(data, rng)
    if rng.random() < 0.7:
        (bag / 'metadata.yaml').write_text(metadata, errors='surrogatepass')
    (bag / name).write_bytes(data)
    for strict in (True, False):
        refusal(ValueError, lambda strict=strict: read_all(bag, strict))
    refusal(ValueError, lambda: read_run(bag))
    shutil.rmtree(folder / 'repaired', ignore_errors=True)
    if not refusal(ValueError, lambda: repair(bag, folder / 'repaired')):
        with bounded():
            read_all(folder / 'repaired', strict=True)


@fuzz(15, share=0.2)
@given(seed=SEEDS)
def test_bags_with_hostile_content(folder, seed):
    rng = random.Random(seed)
    records = list(recorded())
    told = [k for k, item in enumerate(records) if isinstance(item[1], NodeConfiguration)]
    for _ in range(rng.choice((1, 1, 3, 20))):
        at = rng.choice(told) if rng.random() < 0.4 else rng.randrange(len(records))
        topic, record = records[at]
        records[at] = topic, hostile(record, rng)
    if rng.random() < 0.2:
        records.insert(rng.randrange(len(records)), rng.choice(records))
    bag = folder / 'hostile'
    write(bag, records)
    refusal(ValueError, lambda: read_all(bag, True))
    refusal(ValueError, lambda: topic_hashes_of(bag))
    refusal(ValueError, lambda: finite_run(bag))
    refusal(ValueError, lambda: replay(bag))


def hostile(record, rng):
    """Return a record with wrong content, also in the texts that are documents."""
    if isinstance(record, NodeConfiguration) and rng.random() < 0.6:
        parameters = mutated_json(record.parameters, rng)
        return replace(record, parameters=parameters.replace('\x00', ''))
    if isinstance(record, NodeConfiguration) and record.model:
        return replace(record, model=mutated_json(record.model, rng))
    if isinstance(record, NodeEvent) and rng.random() < 0.6:
        return replace(record, request=mutated_text(record.request, rng).replace('\x00', ''))
    found = mutated(record, rng)
    return replace(found, stamp=max(found.stamp, 0))


def topic_hashes_of(bag: Path) -> None:
    """Hash all messages of a bag."""
    with BagReader(bag) as reader:
        messages = [(m.topic, m.type, m.log_time, m.message) for m in reader.messages()]
    topic_hashes(messages)


def finite_run(bag: Path) -> None:
    """Read a run and assert that it holds numbers."""
    run = read_run(bag)
    assert np.isfinite(run.time).all()
    assert not np.isinf(run.temperature).any()
    assert not np.isinf(run.displacement).any()
