# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Certificates of OPC UA servers that are pinned on first use.

Who has no certificate of the server at hand trusts the one that it shows first, and from then on
no other: whoever takes the server's place later is refused.
"""

import hashlib
import re
from pathlib import Path

from fuzzycnc_ros.adapters.link import LinkError
from fuzzycnc_ros.files.atomic import write_text


def pin_file(folder: Path, host: str, port: int) -> Path:
    """Return the file in which the certificate of a server is pinned."""
    return folder / f'opcua-{re.sub("[^A-Za-z0-9.-]", "_", host)}-{port}.pem'


def check_pin(file: Path, shown: bytes) -> None:
    """Compare what a server shows with its pinned certificate; pin the first.

    Parameters
    ----------
    file : Path
        Where it is pinned.
    shown : bytes
        Certificate that the server shows, DER; a chain may follow it.

    Raises
    ------
    LinkError
        If it is another than the pinned one, none at all, or cannot be pinned.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import Encoding

    try:
        # The outer sequence tells its length: what follows is the chain.
        found = x509.load_der_x509_certificate(shown[: 4 + int.from_bytes(shown[2:4], 'big')])
    except ValueError as error:
        raise LinkError(f'expected a certificate of the server but: {error}') from error
    if not file.exists():
        try:
            write_text(file, found.public_bytes(Encoding.PEM).decode())
        except OSError as error:
            raise LinkError(
                f'{file}: the certificate of the server cannot be pinned: {error.strerror}; name '
                'a writable state_directory, or the certificate as server_certificate'
            ) from error
        return
    try:
        pinned = x509.load_pem_x509_certificate(file.read_bytes())
    except (OSError, ValueError) as error:
        raise LinkError(
            f'{file}: expected the pinned certificate of the server but: {error}; delete the '
            'file, and the one that the server shows next is pinned'
        ) from error
    if found != pinned:
        name = found.subject.rfc4514_string() or 'no name'
        digest = hashlib.sha256(found.public_bytes(Encoding.DER)).hexdigest()
        raise LinkError(
            f'the server shows another certificate than {file}; if it was given a new one, '
            f'delete that file, else it is not our server: {name}, SHA-256 {digest}'
        )
