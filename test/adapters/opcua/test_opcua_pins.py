# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Certificates that are pinned on first use."""

import pytest

pytest.importorskip('asyncua')

from cryptography.x509.oid import ExtendedKeyUsageOID
from equipment.secured_server import certificate

from fuzzycnc_ros.adapters.link import LinkError
from fuzzycnc_ros.adapters.opcua.pins import check_pin, pin_file


@pytest.fixture(scope='module')
def shown(tmp_path_factory):
    """Certificates of two servers."""
    folder = tmp_path_factory.mktemp('certificates')
    usage = ExtendedKeyUsageOID.SERVER_AUTH
    return [certificate(folder, name, 'urn:control', usage)[0].read_bytes() for name in 'ab']


def test_one_certificate_for_ever_with_whatever_chain(shown, tmp_path):
    file = pin_file(tmp_path, 'mill-7.shop', 4840)
    assert file.name == 'opcua-mill-7.shop-4840.pem'
    check_pin(file, shown[0] + shown[1])
    first = file.read_text()
    assert first.startswith('-----BEGIN CERTIFICATE-----')
    check_pin(file, shown[0])
    with pytest.raises(LinkError, match='another certificate than'):
        check_pin(file, shown[1] + shown[0])
    assert file.read_text() == first


def test_servers_keep_apart_and_stay_in_the_folder(tmp_path):
    names = {
        pin_file(tmp_path, host, port)
        for host, port in (('a', 1), ('a', 2), ('b', 1), ('../a', 1), ('fe80::1%eth0', 1))
    }
    assert len(names) == 5
    assert {name.parent for name in names} == {tmp_path}


@pytest.mark.parametrize('nothing', [b'', b'0\x82\xff\xffx', b'certificate'])
def test_what_is_no_certificate_is_not_pinned(tmp_path, nothing):
    with pytest.raises(LinkError, match='expected a certificate of the server'):
        check_pin(tmp_path / 'pin.pem', nothing)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('kept', [b'', b'\xff\x00', b'-----BEGIN CERTIFICATE-----\n'])
def test_a_damaged_pin_trusts_nobody(shown, tmp_path, kept):
    file = tmp_path / 'pin.pem'
    file.write_bytes(kept)
    with pytest.raises(LinkError, match=r'pin.pem: expected the pinned certificate.*delete'):
        check_pin(file, shown[0])
    assert file.read_bytes() == kept


def test_a_pin_that_cannot_be_kept_trusts_nobody(shown, tmp_path):
    with pytest.raises(LinkError, match=r'cannot be pinned: .*; name a writable state_directory'):
        check_pin(tmp_path / 'nowhere' / 'pin.pem', shown[0])
