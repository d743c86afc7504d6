# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Closed parts to another place: proof of arrival, retries, ledger, secrets."""

import hashlib
import json
import sys
import threading
from functools import partialmethod
from pathlib import Path
from typing import ClassVar

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from fuzzycnc_ros.bags.errors import BagError, MissingLibraryError
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.bags.metadata import storage_files
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.recorder import RecordingThread
from fuzzycnc_ros.bags.shipping import LEDGER, Shipper
from fuzzycnc_ros.bags.writer import BagWriter

NUMBER = 'std_msgs/msg/UInt64'
HANG = 120.0
"""Wall time [s] after which something hangs."""


class Failing(MemoryFileSystem):
    """A place that fails in ways that a test sets."""

    protocol = 'failing'
    store: ClassVar = {}
    pseudo_dirs: ClassVar = ['']
    plan: ClassVar = []
    """What the next uploads do: an error, or what arrives in place of the file."""
    uploads: ClassVar = []
    gate = threading.Event()

    def put_file(self, lpath, rpath, **options):
        assert self.gate.wait(HANG)
        self.uploads.append(rpath)
        step = self.plan.pop(0) if self.plan else None
        if isinstance(step, Exception):
            raise step
        if step is not None:
            self.pipe_file(rpath, step)
            return
        super().put_file(lpath, rpath, **options)


@pytest.fixture
def failing():
    """The place, which lets all through; who was given up has ended before the next test."""
    fsspec.register_implementation('failing', Failing, clobber=True)
    Failing.store.clear()
    Failing.plan.clear()
    Failing.uploads.clear()
    Failing.gate.set()
    yield Failing
    Failing.gate.set()
    until(lambda: 'bag-shipper' not in {thread.name for thread in threading.enumerate()})


CLOSE = Shipper.close


@pytest.fixture(autouse=True)
def _patient(monkeypatch):
    """Whoever closes a recording waits until all has arrived, however busy the machine is."""
    monkeypatch.setattr(Shipper, 'close', lambda self, patience=HANG: CLOSE(self, patience))


@pytest.fixture
def hasty(_patient, monkeypatch):
    """Whoever closes a recording waits for hardly anything: it would not arrive."""
    monkeypatch.setattr(Shipper, 'close', partialmethod(CLOSE, 0.1))


def payload(number):
    return b'\x00\x01\x00\x00' + number.to_bytes(8, 'little')


def record(bag, url, count=500, **keep):
    writer = BagWriter(bag, split_duration=1.0)
    thread = RecordingThread(writer, shipper=Shipper(url, bag, delay=0.01), **keep)
    thread.add_topic('/numbers', NUMBER)
    for k in range(count):
        thread.put('/numbers', payload(k), k * 20_000_000, sequence=k + 1)
    return thread


def ledger(bag):
    return json.loads((bag / LEDGER).read_text())


def until(condition):
    """Wait for a condition."""
    over = threading.Event()
    timer = threading.Timer(HANG, over.set)
    timer.start()
    try:
        while not condition():
            assert not over.wait(0.01)
    finally:
        timer.cancel()


@pytest.mark.parametrize('written', [str, Path.as_uri])
def test_parts_arrive_in_a_folder(tmp_path, written):
    bag = tmp_path / 'bag'
    thread = record(bag, written(tmp_path / 'archive'))
    thread.close()
    parts = storage_files(bag)
    assert [entry['part'] for entry in ledger(bag)] == [part.name for part in parts]
    for part, entry in zip(parts, ledger(bag), strict=True):
        arrived = tmp_path / 'archive' / 'bag' / part.name
        assert arrived.read_bytes() == part.read_bytes()
        assert entry['sha256'] == hashlib.sha256(part.read_bytes()).hexdigest()
        assert entry['bytes'] == part.stat().st_size
        assert entry['to'] == str(arrived)
        assert entry['when'].endswith('+00:00')
    with BagReader(tmp_path / 'archive' / 'bag') as reader:  # what arrived is a bag
        assert [m.message.data for m in reader.messages()] == list(range(500))
    assert thread.notices() == []


def test_parts_arrive_in_memory(tmp_path):
    record(tmp_path / 'bag', 'memory://shop/mill').close()
    system = fsspec.filesystem('memory')
    assert len(system.ls('/shop/mill/bag')) == 10


def test_a_place_that_fails_is_tried_again(tmp_path, failing):
    failing.plan += [OSError('unreachable'), ConnectionError('reset'), TimeoutError()]
    thread = record(tmp_path / 'bag', 'failing://shop')
    until(lambda: (tmp_path / 'bag' / LEDGER).exists())
    thread.close()
    assert len(ledger(tmp_path / 'bag')) == 10
    assert [name.rpartition('/')[2] for name in failing.uploads[:4]] == ['bag_0.mcap'] * 4
    assert thread.progress().waiting == ''


def test_no_bucket_is_made_for_a_slip_in_its_name(tmp_path, failing, monkeypatch):
    made = []
    monkeypatch.setitem(sys.modules['fsspec.registry']._registry, 's3', failing)
    monkeypatch.setattr(failing, 'makedirs', lambda self, path, exist_ok: made.append(path))
    monkeypatch.setattr(failing, 'mkdirs', lambda self, path, exist_ok: None)  # of an upload
    record(tmp_path / 'bag', 's3://shop/mill').close()
    assert len(ledger(tmp_path / 'bag')) == 10
    assert not made
    record(tmp_path / 'other', 'failing://shop/mill').close()
    assert {*made} == {'failing://shop/mill/other'}


def test_a_place_that_does_not_answer_is_named_at_the_end(tmp_path, failing):
    failing.gate.clear()
    shipper = Shipper('failing://shop', tmp_path)
    (tmp_path / 'bag_0.mcap').write_bytes(b'x')
    shipper.submit(tmp_path / 'bag_0.mcap')
    (said,) = shipper.close(0.1)
    failing.gate.set()
    assert 'the place has not taken them within the last 0.1 s; check it' in said


def test_what_arrived_as_something_else_is_sent_again(tmp_path, failing):
    failing.plan += [b'half of it']
    record(tmp_path / 'bag', 'failing://shop').close()
    assert [name.rpartition('/')[2] for name in failing.uploads[:3]] == [
        'bag_0.mcap',
        'bag_0.mcap',
        'bag_1.mcap',
    ]
    assert len(ledger(tmp_path / 'bag')) == 10


def test_what_is_there_already_is_not_overwritten(tmp_path, failing, hasty):
    system, root = fsspec.url_to_fs('failing://shop/bag/bag_0.mcap')
    system.pipe_file(root, b'of last year')
    thread = record(tmp_path / 'bag', 'failing://shop')
    until(lambda: 'exists with other content' in thread.progress().waiting)
    thread.close()
    assert system.cat_file(root) == b'of last year'
    assert not (tmp_path / 'bag' / LEDGER).exists()
    (notice,) = thread.notices()
    assert notice.urgent
    assert '10 parts of' in notice.text


def test_what_did_not_arrive_is_named_at_the_end(tmp_path, failing, hasty):
    failing.plan += [PermissionError('denied')] * 1000
    thread = record(tmp_path / 'bag', 'failing://shop', 100)
    until(lambda: thread.progress().waiting)
    thread.close()
    (notice,) = thread.notices()
    assert '2 parts of' in notice.text
    assert 'bag_0.mcap cannot be shipped: denied' in notice.text
    assert 'copy them yourself' in notice.text
    assert thread.progress().lost == 0


def test_a_place_that_hangs_does_not_hold_the_recorder_up(tmp_path, failing):
    failing.gate.clear()
    try:
        thread = record(tmp_path / 'bag', 'failing://shop')
        until(lambda: thread.progress().written == 500)
        assert thread.progress().parts == 10
        assert failing.uploads == []
    finally:
        failing.gate.set()
    thread.close()
    assert len(ledger(tmp_path / 'bag')) == 10


def test_parts_are_deleted_once_they_have_arrived(tmp_path, failing):
    bag = tmp_path / 'bag'
    failing.gate.clear()
    try:
        thread = record(bag, 'failing://shop', budget=1)
        until(lambda: thread.progress().written == 500 and thread.progress().waiting)
        assert len(storage_files(bag)) == 10, 'nothing has arrived yet'
        assert 'bag_0.mcap is not shipped yet' in thread.progress().waiting
    finally:
        failing.gate.set()
    until(lambda: len(storage_files(bag)) == 2)
    until(lambda: not thread.progress().waiting)
    thread.close()
    assert [entry['part'] for entry in ledger(bag)] == [f'bag_{k}.mcap' for k in range(10)]
    with BagReader(bag) as reader:
        assert reader.problems == []
        assert [m.message.data for m in reader.messages()] == list(range(400, 500))


def test_part_that_somebody_took_away_is_passed_over(tmp_path, failing):
    failing.gate.clear()
    try:
        thread = record(tmp_path / 'bag', 'failing://shop')
        until(lambda: thread.progress().written == 500)
        (tmp_path / 'bag' / 'bag_5.mcap').unlink()
    finally:
        failing.gate.set()
    thread.close()
    names = [entry['part'] for entry in ledger(tmp_path / 'bag')]
    assert names == [f'bag_{k}.mcap' for k in range(10) if k != 5]


# Secrets


@pytest.mark.parametrize(
    'url', ['sftp://mill:s3same@host/a', 's3://AKIAXX@bucket', 'memory://a?sig=s3same']
)
def test_url_with_a_secret_is_refused_and_not_repeated(tmp_path, url):
    with pytest.raises(BagError, match='without a password') as caught:
        Shipper(url, tmp_path)
    assert 's3same' not in str(caught.value)
    assert 'AKIAXX' not in str(caught.value)


def test_no_secret_reaches_a_text_or_the_bag(tmp_path, failing, hasty, monkeypatch):
    monkeypatch.setenv('AWS_SECRET_ACCESS_KEY', 's3same-street')
    monkeypatch.setitem(fsspec.config.conf, 'failing', {'token': 'open-s3same'})
    failing.plan += [OSError('s3same-street and open-s3same are unknown')] * 1000
    thread = record(tmp_path / 'bag', 'failing://shop', 100)
    until(lambda: thread.progress().waiting)
    thread.close()
    texts = [thread.progress().waiting, *(text for _, text in thread.notices())]
    assert all('*** and *** are unknown' in text for text in texts)
    for path in (tmp_path / 'bag').iterdir():
        assert b's3same' not in path.read_bytes()


# Libraries


def test_missing_library_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 's3fs', None)
    with pytest.raises(MissingLibraryError, match=r's3:// needs another library, s3fs'):
        Shipper('s3://bucket/mill', tmp_path)
    load.cache_clear()
    monkeypatch.setitem(sys.modules, 'fsspec.core', None)
    with pytest.raises(MissingLibraryError, match=r"pip install 'fuzzycnc_ros\[ship\]'"):
        Shipper('memory://a', tmp_path)
    load.cache_clear()


def test_unknown_kind_of_place_is_refused(tmp_path):
    with pytest.raises(BagError, match='expected a folder, s3://'):
        Shipper('carrier-pigeon://roof', tmp_path)
