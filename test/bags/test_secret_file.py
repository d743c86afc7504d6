# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Secret files are their owner's alone."""

import pytest

from fuzzycnc_ros.bags.secret_file import check_secret


@pytest.mark.parametrize('mode', [0o604, 0o602, 0o640, 0o620, 0o644, 0o666, 0o660, 0o601])
def test_a_file_that_others_have_is_refused(tmp_path, mode):
    file = tmp_path / 'key.pem'
    file.touch()
    file.chmod(mode)
    with pytest.raises(ValueError, match=f'key {file}: .* mode {mode:o}; run chmod 600 {file}'):
        check_secret(file, 'key')


@pytest.mark.parametrize('mode', [0o600, 0o400, 0o700])
def test_that_of_its_owner_alone_is_taken(tmp_path, mode):
    (tmp_path / 'key.pem').touch()
    (tmp_path / 'key.pem').chmod(mode)
    check_secret(tmp_path / 'key.pem', 'key')


def test_a_secret_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ValueError, match=r'token .*/none: expected a readable file but found: No'):
        check_secret(tmp_path / 'none', 'token')
