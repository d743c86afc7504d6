# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The token and the certificate that the server makes for itself."""

import json
import ssl
import urllib.request

import pytest
from served_page import SECRET

from fuzzycnc_ros.runtime.addresses import is_loopback
from fuzzycnc_ros.web.keys import (
    KeyFileError,
    check_pair,
    fingerprint,
    own_certificate,
    own_token,
    read_token,
)


def mode(file):
    return file.stat().st_mode & 0o777


def test_a_token_is_made_once(tmp_path):
    file = tmp_path / 'state' / 'token'
    made, fresh = own_token(file)
    assert fresh
    assert len(made) >= 40
    assert mode(file) == 0o600
    assert mode(file.parent) == 0o700
    assert own_token(file) == (made, False)
    assert own_token(tmp_path / 'other')[0] != made


def test_a_token_that_is_of_no_use_is_refused_with_the_remedy(tmp_path):
    file = tmp_path / 'token'
    with pytest.raises(KeyFileError, match='readable'):
        read_token(file)
    file.write_text('short')
    file.chmod(0o600)
    with pytest.raises(KeyFileError, match='at least 16 characters'):
        read_token(file)
    file.write_text('long enough but with spaces')
    with pytest.raises(KeyFileError, match='without spaces'):
        read_token(file)
    file.write_text('x' * 40)
    file.chmod(0o644)
    with pytest.raises(KeyFileError, match=r'mode 644; run chmod 600'):
        read_token(file)
    with pytest.raises(KeyFileError, match='state_directory'):
        own_token(file / 'below' / 'token')


def test_a_certificate_is_made_once_and_serves(serve, tmp_path):
    pytest.importorskip('cryptography')
    files = own_certificate(tmp_path, '127.0.0.1')
    assert own_certificate(tmp_path, '127.0.0.1') == files
    assert mode(files[1]) == 0o600
    page = serve(SECRET, certificate=files)
    assert page.server.url.startswith('https://127.0.0.1:')
    context = ssl.create_default_context(cafile=str(files[0]))
    with urllib.request.urlopen(f'{page.server.url}bags/', context=context) as answer:
        assert json.load(answer) == []
    seen = ssl.get_server_certificate(page.address)
    (tmp_path / 'seen.pem').write_text(seen)
    assert fingerprint(tmp_path / 'seen.pem') == fingerprint(files[0])
    assert len(fingerprint(files[0])) == 95
    check_pair(*files)
    with pytest.raises(KeyFileError, match='expected a pair'):
        check_pair(files[0], files[0])
    files[1].chmod(0o640)
    with pytest.raises(KeyFileError, match=r'private_key .* mode 640; run chmod 600'):
        check_pair(*files)
    files[1].chmod(0o600)
    with pytest.raises(KeyFileError, match='PEM'):
        fingerprint(files[1].with_name('nothing'))


@pytest.mark.parametrize(
    ('address', 'only_here'),
    [
        ('127.0.0.1', True),
        ('127.9.9.9', True),
        ('::1', True),
        ('localhost', True),
        ('0.0.0.0', False),
        ('::', False),
        ('192.168.1.5', False),
        ('localhost.evil.example', False),
        ('', False),
    ],
)
def test_what_only_this_computer_reaches(address, only_here):
    assert is_loopback(address) == only_here
