# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fields of files for OPC UA: servers, their security, and the address of a variable."""

import re
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

from fuzzycnc_ros.adapters.opcua.pins import pin_file
from fuzzycnc_ros.adapters.opcua.session import Security, Server
from fuzzycnc_ros.adapters.yaml_model import (
    SWITCH,
    AfterValidator,
    BeforeValidator,
    Choice,
    Field,
    Fields,
    Number,
    Text,
    ValidationInfo,
    address_of,
    model_validator,
    read_file,
    wrong,
)
from fuzzycnc_ros.bags.secret_file import check_secret
from fuzzycnc_ros.ros.parameters import ParameterError

POLICIES = ('Basic256Sha256', 'Aes128Sha256RsaOaep', 'Aes256Sha256RsaPss')
ENCRYPTED = 'SignAndEncrypt'
MODES = ('Sign', ENCRYPTED)

NODE = r'((ns=[0-9]+|nsu=[^;]+);)?(i=[0-9]+|[sgb]=.+)'
STEP = r'[0-9]{1,5}:.+'


def _file(node: Any, info: 'ValidationInfo[Path]') -> Path:
    """Return a file that a field names, relative to the file that it stands in."""
    path: Path = info.context.parent / Path(Text().read(node)).expanduser()
    if not path.is_file():
        raise wrong(f'expected a file but nothing is at {path}')
    return path


def _steps(node: Any) -> list[str]:
    steps = Text().read(node).strip('/').split('/')
    for step in steps:
        if not re.fullmatch(STEP, step):
            raise wrong(
                'expected steps from the root as namespace:name, such as '
                f'0:Objects/2:Spindle/2:T1, but found {step!r}'
            )
    return steps


def _node(text: str) -> str:
    if not re.fullmatch(NODE, text):
        raise wrong(
            'expected a node id such as ns=2;s=Spindle.T1, ns=2;i=1001 or nsu=urn:mill;s=T1 but '
            f'found {text!r}'
        )
    return text


def _url(text: str) -> str:
    parts = address_of(text, ('opc.tcp',))
    if parts is None:
        raise wrong(f'expected opc.tcp://HOST:PORT/PATH, usual port 4840, but found {text!r}')
    if '@' in parts.netloc:
        raise wrong('expected no user and password here; put them into the file credentials')
    return text


File = Annotated[Path, BeforeValidator(_file)]


class PlaceFields(Fields):
    """A variable of a server."""

    node: Annotated[str, Text(NODE), AfterValidator(_node)] = Field(
        '', description='Node id, such as ns=2;s=Spindle.T1'
    )
    path: Annotated[tuple[str, ...], BeforeValidator(_steps, json_schema_input_type=str)] = Field(
        (), description='Browse path from the root, such as 0:Objects/2:Spindle/2:T1'
    )

    @model_validator(mode='after')
    def _check_place(self) -> 'PlaceFields':
        if bool(self.node) == bool(self.path):
            raise wrong(
                'expected either node, such as ns=2;s=Spindle.T1, or path, such as '
                '0:Objects/2:Spindle/2:T1'
            )
        return self


class SecurityFields(Fields):
    """Security of the connection."""

    policy: Annotated[str, Choice(POLICIES)] = Field(description='Security policy')
    mode: Annotated[str, Choice(MODES)] = Field(ENCRYPTED, description='Security mode')
    certificate: File = Field(description='Own certificate, relative to this file')
    private_key: File = Field(description='Key of the own certificate')
    server_certificate: File = Field(
        default_factory=Path,
        description='Certificate of the server; the first one is pinned without it',
    )


class ServerFields(Fields):
    """Address of a server, and the credentials for it."""

    url: Annotated[str, Text(r'opc\.tcp://.+'), AfterValidator(_url)] = Field(
        description='Address, opc.tcp://HOST:PORT/PATH'
    )
    timeout: Annotated[float, Number(0.05, 60.0, 's')] = Field(
        2.0, description='Longest wait for an answer [s]'
    )
    security: SecurityFields | None = Field(None, description='Security of the connection')
    credentials: File = Field(default_factory=Path, description='File with username and password')
    allow_plain_password: Annotated[bool, Choice(SWITCH)] = Field(
        False, description='Whether a password may go out so that others can read it'
    )

    @model_validator(mode='after')
    def _check_password(self) -> 'ServerFields':
        safe = self.security is not None and self.security.mode == ENCRYPTED
        if self.credentials != Path() and not safe and not self.allow_plain_password:
            raise wrong(
                f'expected security with mode {ENCRYPTED} beside it, since without it the '
                'password may be sent so that everybody on the network can read it; add it, or '
                'say allow_plain_password: true',
                'credentials',
            )
        return self

    def server(self, folder: Path) -> Server:
        """Return the server; `folder` is where its certificate is pinned on first use."""
        security = None
        if self.security is not None:
            parts, given = urlsplit(self.url), dict(self.security)
            pinned = self.security.server_certificate == Path()
            if pinned:  # without either any server could pass itself off as this one
                given['server_certificate'] = pin_file(
                    folder, parts.hostname or '', parts.port or 0
                )
            security = Security(**given, pinned=pinned)
        entered = self.credentials if self.credentials != Path() else None
        return Server(url=self.url, timeout=self.timeout, security=security, credentials=entered)


def pin_folder(path: Path, state_directory: str) -> Path:
    """Return where certificates are pinned; without a state directory beside the file."""
    return Path(state_directory).expanduser() if state_directory else path.parent


class _Credentials(Fields):
    username: Annotated[str, Text()]
    password: Annotated[str, Text()]


def read_credentials(path: Path) -> tuple[str, str]:
    """Return user name and password of a credentials file.

    What is wrong in it is not quoted: it may be the password.

    Raises
    ------
    ParameterError
        If others than its owner can read it, or it does not hold the two.
    """
    try:
        check_secret(path, 'credentials')
    except ValueError as error:
        raise ParameterError(str(error)) from None
    try:
        found = read_file(path, _Credentials, 'username and password')
    except ParameterError as error:
        line = re.search(r'line \d+', str(error))
        place = f'{path}: {line[0]}' if line else f'{path}'
        raise ParameterError(
            f"{place}: expected username and password, a line each, as password: 'SECRET' in "
            'quotes; its content is not shown'
        ) from None
    return found.username, found.password
