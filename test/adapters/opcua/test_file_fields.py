# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files of credentials: what is wrong with one is said without its content."""

import pytest

from fuzzycnc_ros.adapters.opcua.file_fields import read_credentials
from fuzzycnc_ros.ros.parameters import ParameterError

SECRET = 'Zq7geheim'

WRONG = [
    f'username: mill\npassword: "{SECRET}\n',
    f'username: mill\npassword: x: {SECRET}\n',
    f'username: mill\npassword: @{SECRET}\n',
    f'username: mill\npassword: %{SECRET}\n',
    f'username: mill\npassword: *{SECRET}\n',
    f'username: mill\npassword: !{SECRET} x\npasword: x\n',
    f'username: mill\npassword: [{SECRET}]\n',
    f'username: mill\npassword:\t{SECRET}: {SECRET}\n\tb\n',
    f'username: mill\n{SECRET}\n',
    f'username: mill\npassword: x\n{SECRET}: x\n',
    f'{{"username": "mill", "password": "{SECRET}"',
    f'username=mill\npassword={SECRET}\n',
    f'{SECRET}\n',
    f'{SECRET}: 1\n{SECRET}: 2\n',
    f'username: mill\npassword: "{SECRET}\x01"\n',
]
"""Passwords that mean something in YAML, and slips of those who write one."""


@pytest.mark.parametrize('text', WRONG)
def test_no_secret_is_quoted(tmp_path, text):
    path = tmp_path / 'user.yaml'
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(ParameterError) as caught:
        read_credentials(path)
    error = caught.value
    assert str(error).startswith(f'{path}: ')
    assert 'expected username and password' in str(error)
    assert SECRET not in str(error)
    assert error.__cause__ is None
    assert error.__suppress_context__, 'a traceback shows what the context says'


def test_quotes_take_any_password(tmp_path):
    path = tmp_path / 'user.yaml'
    path.write_text("username: mill\npassword: '@%*: {x\"#'\n")
    path.chmod(0o600)
    assert read_credentials(path) == ('mill', '@%*: {x"#')
