# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are whole or the old ones."""

import os

import pytest

from fuzzycnc_ros.bags.atomic import whole_file, write_text


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
            draft.write_text('new')
            raise ValueError('half')

    with pytest.raises(ValueError, match='half'):
        fail()
    assert [path.name for path in tmp_path.iterdir()] == ['file']
    assert file.read_text() == 'old'


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileNotFoundError) as found:
        write_text(tmp_path / 'none' / 'file', 'text')
    assert found.value.filename == str(tmp_path / 'none' / 'file')
