# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Secrets of the page's server: the token, and a certificate that it makes for itself."""

import datetime
import hashlib
import ipaddress
import re
import secrets
import socket
import ssl
from pathlib import Path

from fuzzycnc_ros.bags.secret_file import check_secret
from fuzzycnc_ros.core.encodings import decoded
from fuzzycnc_ros.files.atomic import SECRET_FILE, write_text

TOKEN_LEAST = 16
"""Characters that a token must have; its own ones have 43."""
VALID_DAYS = 3650


class KeyFileError(ValueError):
    """A file of the server is of no use; the text names it and the remedy."""


def own_token(file: Path) -> tuple[str, bool]:
    """Return the token in a file, and whether it was made just now.

    Raises
    ------
    KeyFileError
        If it cannot be read or made, or others may read it.
    """
    if not file.exists():
        text = secrets.token_urlsafe(32)
        _write(file, f'{text}\n'.encode())
        return text, True
    return read_token(file), False


def read_token(file: Path) -> str:
    """Return the token in a file.

    Raises
    ------
    KeyFileError
        If it cannot be read, is too short, or others may read it.
    """
    _check_secret(file, 'token')
    try:
        text = decoded(file.read_bytes()).strip()
    except OSError as error:
        raise KeyFileError(f'token {file}: expected a readable text but found: {error}') from error
    except ValueError as error:
        raise KeyFileError(f'token {file}: {error}') from error
    if len(text) < TOKEN_LEAST or not re.fullmatch(r'[\x21-\x7e]+', text):
        raise KeyFileError(
            f'token {file}: expected at least {TOKEN_LEAST} characters without spaces; delete '
            'the file to have one made'
        )
    return text


def own_certificate(folder: Path, address: str) -> tuple[Path, Path]:
    """Return the files of certificate and key that a server has made for itself.

    Raises
    ------
    KeyFileError
        If they cannot be made.
    ModuleNotFoundError
        If what makes them is not installed.
    """
    certificate, key = folder / 'certificate.pem', folder / 'key.pem'
    if not (certificate.exists() and key.exists()):
        public, private = _made(address)
        _write(key, private)
        _write(certificate, public)
    return certificate, key


def fingerprint(certificate: Path) -> str:
    """Return the SHA-256 of a certificate, as browsers show it.

    Raises
    ------
    KeyFileError
        If it is none.
    """
    try:
        body = ssl.PEM_cert_to_DER_cert(decoded(certificate.read_bytes()).strip())
    except (OSError, ValueError) as error:
        raise KeyFileError(
            f'certificate {certificate}: expected PEM but found: {error}'
        ) from error
    digest = hashlib.sha256(body).hexdigest().upper()
    return ':'.join(digest[place : place + 2] for place in range(0, len(digest), 2))


def check_pair(certificate: Path, key: Path) -> None:
    """Refuse a certificate and a key that do not serve.

    Raises
    ------
    KeyFileError
        If one cannot be read, they do not belong together, or others may read the key.
    """
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key)
    except (OSError, ValueError) as error:  # an SSLError is an OSError
        raise KeyFileError(
            f'certificate {certificate} and private_key {key}: expected a pair in PEM but '
            f'found: {error}'
        ) from error
    _check_secret(key, 'private_key')


def _check_secret(file: Path, what: str) -> None:
    """Refuse a secret file that others may read.

    Raises
    ------
    KeyFileError
        If they may, or it is not there.
    """
    try:
        check_secret(file, what)
    except ValueError as error:
        raise KeyFileError(str(error)) from None


def _write(file: Path, content: bytes) -> None:
    """Write a file that nobody else reads, whole or not at all."""
    try:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_text(file, content, SECRET_FILE)
    except OSError as error:
        raise KeyFileError(
            f'{file}: {error.strerror}; name a writable directory with state_directory'
        ) from error


def _made(address: str) -> tuple[bytes, bytes]:
    """Return a certificate that signs itself, and its key, in PEM."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    host = socket.gethostname()
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, f'fuzzycnc {host}'[:64])])
    names: list[x509.GeneralName] = [x509.DNSName('localhost'), x509.DNSName(host)]
    try:
        listening = ipaddress.ip_address(address)
        names += [] if listening.is_unspecified else [x509.IPAddress(listening)]
    except ValueError:
        names.append(x509.DNSName(address))
    now = datetime.datetime.now(datetime.timezone.utc)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=VALID_DAYS))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    return made.public_bytes(serialization.Encoding.PEM), private
