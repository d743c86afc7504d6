# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The environment of the middleware where the home folder cannot be written."""

import os
from pathlib import Path

import pytest

from fuzzycnc_ros.ros.processes import prepare_environment


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A home folder; what is below `locked` cannot be written, also not by root."""
    may = os.access
    monkeypatch.setattr(os, 'access', lambda p, mode: 'locked' not in str(p) and may(p, mode))
    monkeypatch.delenv('ROS_LOG_DIR', raising=False)
    monkeypatch.delenv('ROS_HOME', raising=False)
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    monkeypatch.setattr('tempfile.tempdir', None)

    def enter(name):
        (tmp_path / name).mkdir()
        monkeypatch.setenv('HOME', str(tmp_path / name))
        return tmp_path / name

    return enter


def test_logs_go_to_the_home_folder_where_they_can(home):
    home('mine')
    prepare_environment()
    assert 'ROS_LOG_DIR' not in os.environ


def test_logs_go_elsewhere_where_the_home_folder_is_locked(home, tmp_path, monkeypatch):
    home('locked')
    prepare_environment()
    folder = Path(os.environ['ROS_LOG_DIR'])
    assert folder.is_dir()
    assert folder.parent == tmp_path
    monkeypatch.delenv('ROS_LOG_DIR')
    prepare_environment()
    assert os.environ['ROS_LOG_DIR'] == str(folder), 'it is the same for all processes'
    monkeypatch.delenv('ROS_LOG_DIR')
    folder.rmdir()
    folder.symlink_to(tmp_path / 'locked')
    prepare_environment()
    assert os.environ['ROS_LOG_DIR'] != str(folder), 'somebody else has put something there'


def test_a_chosen_folder_that_cannot_be_written_is_named(home, tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_LOG_DIR', str(home('locked') / 'log'))
    with pytest.raises(ValueError, match='ROS_LOG_DIR: expected a folder that can be written'):
        prepare_environment()
