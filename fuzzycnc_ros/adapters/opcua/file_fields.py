# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What files say of OPC UA: servers, their security, and where a variable lies."""

import re
from pathlib import Path
from urllib.parse import urlsplit

from fuzzycnc_ros.adapters.opcua.pins import pin_file
from fuzzycnc_ros.adapters.opcua.session import Address, Security, Server
from fuzzycnc_ros.adapters.yaml_section import Section
from fuzzycnc_ros.ros.parameters import ParameterError

POLICIES = ('Basic256Sha256', 'Aes128Sha256RsaOaep', 'Aes256Sha256RsaPss')
ENCRYPTED = 'SignAndEncrypt'
MODES = ('Sign', ENCRYPTED)

_NODE = re.compile(r'((ns=[0-9]+|nsu=[^;]+);)?(i=[0-9]+|[sgb]=.+)')


def read_server(section: Section, state_directory: str = '') -> Server:
    """Return the server that the fields url, timeout, security and credentials describe.

    Parameters
    ----------
    section : Section
        The fields.
    state_directory : str
        Where a certificate is pinned on first use; empty: beside the file.

    Raises
    ------
    ParameterError
        If something is missing or wrong, or a password would be readable on the network.
    """
    url = section.text('url')
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(''), None
    if parts.scheme != 'opc.tcp' or not parts.hostname or port is None:
        raise section.line_error(
            'url', f'expected opc.tcp://HOST:PORT/PATH, usual port 4840, but found {url!r}'
        )
    if '@' in parts.netloc:
        raise section.line_error(
            'url', 'expected no user and password here; put them into the file credentials'
        )
    folder = Path(state_directory).expanduser() if state_directory else section.path.parent
    pin = pin_file(folder, parts.hostname, port)
    security = _security(section.section('security'), pin)
    return Server(
        url=url,
        timeout=section.number('timeout', 0.05, 60.0, 2.0, unit='s'),
        security=security,
        credentials=_credentials(section, security),
    )


def read_address(entry: Section) -> Address:
    """Return the address that the field node or path describes."""
    if ('node' in entry) == ('path' in entry):
        raise entry.error(
            'expected either node, such as ns=2;s=Spindle.T1, or path, such as '
            '0:Objects/2:Spindle/2:T1'
        )
    if 'path' in entry:
        steps = tuple(entry.text('path').strip('/').split('/'))
        wrong = [step for step in steps if not re.fullmatch(r'[0-9]{1,5}:.+', step)]
        if wrong:
            raise entry.line_error(
                'path',
                'expected steps from the root as namespace:name, such as '
                f'0:Objects/2:Spindle/2:T1, but found {wrong[0]!r}',
            )
        return Address(path=steps)
    node = entry.text('node')
    if not _NODE.fullmatch(node):
        raise entry.line_error(
            'node',
            'expected a node id such as ns=2;s=Spindle.T1, ns=2;i=1001 or nsu=urn:mill;s=T1 but '
            f'found {node!r}',
        )
    return Address(node=node)


def read_credentials(path: Path) -> tuple[str, str]:
    """Return user name and password of a credentials file.

    Raises
    ------
    ParameterError
        If others than its owner can read it, or it does not hold the two.
    """
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise ParameterError(f'{path}: expected credentials but: {error.strerror}') from error
    if mode & 0o077:
        raise ParameterError(
            f'{path}: expected a file that only its owner can read; run chmod 600 {path}'
        )
    section = Section.read(path, 'username and password')
    found = section.text('username'), section.text('password')
    section.done()
    return found


def _credentials(section: Section, security: Security | None) -> Path | None:
    """Return the file with user name and password, unless everybody could read them."""
    plain = section.word('allow_plain_password', ('true', 'false'), 'false') == 'true'
    if 'credentials' not in section:
        return None
    path = _file(section, 'credentials')
    if not plain and (security is None or security.mode != ENCRYPTED):
        raise section.line_error(
            'credentials',
            f'expected security with mode {ENCRYPTED} beside it, since without it the password '
            'may be sent so that everybody on the network can read it; add it, or say '
            'allow_plain_password: true',
        )
    return path


def _security(section: Section | None, pin: Path) -> Security | None:
    if section is None:
        return None
    given = 'server_certificate' in section
    security = Security(
        policy=section.word('policy', POLICIES),
        mode=section.word('mode', MODES, ENCRYPTED),
        certificate=_file(section, 'certificate'),
        private_key=_file(section, 'private_key'),
        # Without either any server could pass itself off as this one.
        server_certificate=_file(section, 'server_certificate') if given else pin,
        pinned=not given,
    )
    section.done()
    return security


def _file(section: Section, name: str) -> Path:
    """Return a file that a field names, relative to the file that it stands in."""
    path = section.path.parent / Path(section.text(name)).expanduser()
    if not path.is_file():
        raise section.line_error(name, f'expected a file but nothing is at {path}')
    return path
