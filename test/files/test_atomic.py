# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are whole or the old ones."""

import os
import socket
import stat
from concurrent.futures import ThreadPoolExecutor

import pytest

from fuzzycnc_ros.files.atomic import (
    SECRET_FILE,
    is_written_through,
    whole_file,
    write_regular,
    write_text,
)


def test_a_file_has_the_mode_of_any_new_file(tmp_path, monkeypatch):
    """The mask is not asked for: while that sets it, other threads write for everybody."""
    (tmp_path / 'other').touch()
    monkeypatch.delattr(os, 'umask')
    write_text(tmp_path / 'file', 'text')
    assert (tmp_path / 'file').read_text() == 'text'
    assert (tmp_path / 'file').stat().st_mode == (tmp_path / 'other').stat().st_mode


def test_after_an_error_the_old_file_is_there_alone(tmp_path):
    file = tmp_path / 'file'
    write_text(file, 'old')

    def fail():
        with whole_file(file) as draft:
            draft.write(b'new')
            raise ValueError('half')

    with pytest.raises(ValueError, match='half'):
        fail()
    assert [path.name for path in tmp_path.iterdir()] == ['file']
    assert file.read_text() == 'old'


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileNotFoundError) as found:
        write_text(tmp_path / 'none' / 'file', 'text')
    assert found.value.filename == str(tmp_path / 'none' / 'file')


def test_a_secret_is_read_by_its_owner_alone(tmp_path):
    (tmp_path / 'file').touch(0o644)
    write_text(tmp_path / 'file', 'text', SECRET_FILE)
    assert stat.S_IMODE((tmp_path / 'file').stat().st_mode) == 0o600


@pytest.mark.parametrize('link', ['one', 'chain', 'folder'])
def test_a_link_stays_and_its_target_is_written_whole(tmp_path, link):
    (tmp_path / 'there').mkdir()
    target = tmp_path / 'there' / 'file'
    target.write_text('old')
    before = target.stat().st_ino
    name = tmp_path / 'name'
    if link == 'folder':
        name.symlink_to('there')
        name = name / 'file'
    else:
        (tmp_path / 'middle').symlink_to('there/file')
        name.symlink_to('middle' if link == 'chain' else target)
    write_text(name, 'new')
    assert (tmp_path / 'name').is_symlink()
    assert target.read_text() == 'new'
    assert target.stat().st_ino != before, 'it was written in place'
    assert [path.name for path in (tmp_path / 'there').iterdir()] == ['file']


def test_what_a_link_leads_to_is_made(tmp_path):
    (tmp_path / 'name').symlink_to('file')
    write_text(tmp_path / 'name', 'new')
    assert (tmp_path / 'name').is_symlink()
    assert (tmp_path / 'file').read_text() == 'new'


def test_a_circle_of_links_is_named(tmp_path):
    (tmp_path / 'a').symlink_to('b')
    (tmp_path / 'b').symlink_to('a')
    with pytest.raises(OSError, match='symbolic links') as found:
        write_text(tmp_path / 'a', 'text')
    assert found.value.filename == str(tmp_path / 'a')


@pytest.mark.parametrize('linked', [False, True])
def test_a_pipe_takes_what_is_written(tmp_path, linked):
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    name = pipe
    if linked:
        name = tmp_path / 'name'
        name.symlink_to(pipe)
    with ThreadPoolExecutor(1) as reader:
        read = reader.submit(pipe.read_text)
        write_text(name, 'text')
        assert read.result(10) == 'text'
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert name.is_symlink() == linked
    assert is_written_through(name)


def test_nothing_is_written_through_after_an_error(tmp_path):
    here, there = os.pipe()

    def fail():
        with whole_file(tmp_path / 'name') as draft:
            draft.write(b'half')
            raise ValueError('half')

    (tmp_path / 'name').symlink_to(f'/proc/self/fd/{there}')
    with pytest.raises(ValueError, match='half'):
        fail()
    os.close(there)
    with open(here, 'rb') as read:
        assert read.read() == b''


@pytest.mark.parametrize('name', ['/proc/self/fd/{}', '/dev/fd/{}', 'link'])
@pytest.mark.parametrize('kind', ['pipe', 'socket', 'file'])
def test_a_descriptor_takes_what_is_written_where_it_stands(tmp_path, name, kind):
    if kind == 'pipe':
        here, there = os.pipe()
    elif kind == 'socket':
        here, there = (end.detach() for end in socket.socketpair())
    else:
        there = os.open(tmp_path / 'file', os.O_WRONLY | os.O_CREAT)
        here = os.open(tmp_path / 'file', os.O_RDONLY)
    os.write(there, b'before, ')
    if name == 'link':
        (tmp_path / 'link').symlink_to(f'/proc/self/fd/{there}')
        path = tmp_path / 'link'
    else:
        path = type(tmp_path)(name.format(there))
    write_text(path, 'text, ')
    os.write(there, b'after')
    os.close(there)
    with open(here, 'rb') as read:
        assert read.read() == b'before, text, after'
    assert name != 'link' or path.is_symlink()


def test_a_device_is_written_through(tmp_path):
    here, there = os.openpty()
    (tmp_path / 'name').symlink_to(os.ttyname(there))
    write_text(tmp_path / 'name', 'text')
    assert os.read(here, 100) == b'text'
    assert (tmp_path / 'name').is_symlink()
    os.close(here)
    os.close(there)


def test_a_pipe_without_reader_is_named(tmp_path):
    here, there = os.pipe()
    (tmp_path / 'name').symlink_to(f'/proc/self/fd/{there}')
    os.close(here)
    with pytest.raises(BrokenPipeError) as found:
        write_text(tmp_path / 'name', 'text')
    assert found.value.filename == str(tmp_path / 'name')
    os.close(there)


def test_a_node_waits_for_no_reader(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(OSError, match='expected a regular file') as found:
        write_regular(tmp_path / 'pipe', 'text')
    assert found.value.filename == str(tmp_path / 'pipe')
    write_regular(tmp_path / 'file', 'text')
    assert (tmp_path / 'file').read_text() == 'text'
