# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the operating system, most of them real ones, in sentences with a remedy."""

import errno
import os
import resource

import pytest

from fuzzycnc_ros.files.atomic import write_text
from fuzzycnc_ros.files.os_errors import about, os_sentence


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def sentence(work, *arguments):
    """Return the sentence on what goes wrong."""
    with pytest.raises(OSError, match='Errno') as caught:
        work(*arguments)
    return os_sentence(caught.value)


def test_what_is_missing(here):
    assert sentence(open, 'shift.json') == (
        'shift.json: expected a file but nothing is there; check the name'
    )
    assert sentence(open, 'a/b/c.json') == (
        'a/b/c.json: expected an existing folder but found no a/b; make it first'
    )


def test_a_file_in_place_of_a_folder(here):
    (here / 'file').touch()
    text = 'file/b/c: expected a folder but file is a file; name another place'
    assert sentence(open, 'file/b/c') == text
    assert sentence(os.scandir, 'file').startswith('file: expected')


def test_a_folder_in_place_of_a_file(here):
    (here / 'folder').mkdir()
    assert sentence(open, 'folder') == 'folder: expected a file but found a folder; name a file'
    assert 'expected a new name but it exists' in sentence(os.mkdir, 'folder')
    (here / 'folder' / 'file').touch()
    assert 'expected an empty folder' in sentence(os.rmdir, 'folder')


def test_links_and_names(here):
    (here / 'a').symlink_to('b')
    (here / 'b').symlink_to('a')
    assert sentence(open, 'a') == ('a: symbolic links lead round in a circle; remove one of them')
    assert 'the name is too long' in sentence(open, 300 * 'x')


def test_a_full_disk():
    full = os.open('/dev/full', os.O_WRONLY)
    try:
        with pytest.raises(OSError, match='No space') as caught:
            os.write(full, b'text')
    finally:
        os.close(full)
    assert os_sentence(about(caught.value, 'shift.json')) == (
        'shift.json: the disk is full; free some space, or name a place on another disk'
    )


def test_too_many_open_files():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
    try:
        with pytest.raises(OSError, match='Too many') as caught:
            os.open(os.devnull, os.O_RDONLY)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert 'too many files are open' in os_sentence(caught.value)
    assert '`ulimit -n 4096`' in os_sentence(caught.value)


def test_a_broken_pipe():
    reader, writer = os.pipe()
    os.close(reader)
    try:
        assert sentence(os.write, writer, b'text') == (
            'its reader has gone, so the rest of the output is lost'
        )
    finally:
        os.close(writer)


@pytest.mark.parametrize(
    ('number', 'wanted'),
    [
        (errno.EACCES, 'f: no permission; change its rights with chmod'),
        (errno.EPERM, 'f: no permission; ask its owner'),
        (errno.EROFS, 'f: this disk can only be read; name a place on another one'),
        (errno.EDQUOT, 'f: your share of the disk is used up'),
        (errno.EXDEV, f'f: {os.strerror(errno.EXDEV)}'),
    ],
)
def test_what_root_does_not_meet(number, wanted):
    assert os_sentence(OSError(number, os.strerror(number), 'f')).startswith(wanted)


def test_an_error_without_a_number_keeps_its_words():
    assert os_sentence(OSError('the server has gone')) == 'the server has gone'


def test_a_file_that_is_written_whole_is_named_and_not_its_temporary_one(here):
    (here / 'file').touch()
    assert sentence(write_text, here / 'file' / 'out.json', 'text').startswith(
        f'{here}/file/out.json: expected a folder but {here}/file is a file'
    )
    (here / 'folder').mkdir()
    assert sentence(write_text, here / 'folder', 'text').startswith(f'{here}/folder: expected')
    assert sorted(item.name for item in here.iterdir()) == ['file', 'folder']
