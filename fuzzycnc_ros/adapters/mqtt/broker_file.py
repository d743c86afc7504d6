# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The file that says where the broker is and how the way to it is secured.

docs/how-to/mqtt.md describes it with examples.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from fuzzycnc_ros.adapters.opcua.file_fields import File, read_credentials
from fuzzycnc_ros.adapters.yaml_model import (
    SWITCH,
    Choice,
    Field,
    Fields,
    Number,
    Text,
    model_validator,
    read_file,
    wrong,
)

PORT, PORT_TLS = 1883, 8883


@dataclass(frozen=True, kw_only=True)
class Tls:
    """Encryption of the connection to a broker.

    Parameters
    ----------
    ca : Path
        Certificates of those who may vouch for the broker.
    certificate, private_key : Path, optional
        Own certificate, where the broker asks for one.
    """

    ca: Path
    certificate: Path | None = None
    private_key: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Broker:
    """A broker.

    Parameters
    ----------
    host : str
        Name or address.
    port : int
        Its port.
    keep_alive : int
        Time after which a silent connection counts as lost [s].
    tls : Tls, optional
        How the way is secured; None: not at all.
    credentials : Path, optional
        File with user name and password.
    """

    host: str
    port: int
    keep_alive: int
    tls: Tls | None
    credentials: Path | None

    @property
    def address(self) -> str:
        """Address for messages."""
        return f'MQTT {self.host}:{self.port}'


@dataclass(frozen=True, kw_only=True)
class ReportBroker(Broker):
    """A broker that gets reports.

    Parameters
    ----------
    topic : str
        What its topics begin with.
    buffered : int
        Most reports that are kept while the broker is away.
    """

    topic: str
    buffered: int


class _TlsFields(Fields):
    """Encryption of the connection."""

    ca: File = Field(description='Certificates of those who may vouch for the broker, PEM')
    certificate: File = Field(default_factory=Path, description='Own certificate, PEM')
    private_key: File = Field(default_factory=Path, description='Key of the own certificate, PEM')

    @model_validator(mode='after')
    def _check_pair(self) -> '_TlsFields':
        if (self.certificate == Path()) != (self.private_key == Path()):
            raise wrong('expected certificate and private_key together, or neither')
        return self


class BrokerFields(Fields):
    """Address of a broker, and the encryption of the connection."""

    host: Annotated[str, Text()] = Field(description='Name or address, as in its certificate')
    port: Annotated[int, Number(0, 65535, whole=True)] = Field(
        0, description=f'Port; 0 takes {PORT_TLS} with tls, else {PORT}'
    )
    keep_alive: Annotated[int, Number(1, 3600, 's', whole=True)] = Field(
        5, description='Time after which a silent connection counts as lost [s]'
    )
    tls: _TlsFields | None = Field(None, description='Security of the connection')
    credentials: File = Field(default_factory=Path, description='File with username and password')
    allow_plain_password: Annotated[bool, Choice(SWITCH)] = Field(
        False, description='Whether a password may go out so that others can read it'
    )

    @model_validator(mode='after')
    def _check_password(self) -> 'BrokerFields':
        if self.credentials != Path() and self.tls is None and not self.allow_plain_password:
            raise wrong(
                'expected tls beside it, since without it everybody on the network can read the '
                'password; add it, or say allow_plain_password: true',
                'credentials',
            )
        return self

    @property
    def entered(self) -> Path | None:
        """File with user name and password, None if it names none."""
        return self.credentials if self.credentials != Path() else None

    def way(self) -> dict[str, Any]:
        """Return what all brokers have."""
        tls = None
        if self.tls is not None:
            own = self.tls.certificate != Path()
            tls = Tls(
                ca=self.tls.ca,
                certificate=self.tls.certificate if own else None,
                private_key=self.tls.private_key if own else None,
            )
        return {
            'host': self.host,
            'port': self.port or (PORT if tls is None else PORT_TLS),
            'keep_alive': self.keep_alive,
            'tls': tls,
            'credentials': self.entered,
        }


class BrokerFile(BrokerFields):
    """The broker of a machine's reports."""

    topic: Annotated[str, Text(r'[^#+/]+(/[^#+/]+)*')] = Field(
        'fuzzycnc', description='What topics begin with'
    )
    buffered: Annotated[int, Number(1, 1_000_000, whole=True)] = Field(
        3600, description='Most reports that are kept while the broker is away, one a second'
    )

    @model_validator(mode='after')
    def _check_topic(self) -> 'BrokerFile':
        if any(mark in self.topic for mark in '#+') or '' in self.topic.split('/'):
            raise wrong(f'expected words between slashes but found {self.topic!r}', 'topic')
        return self


def read_broker(path: Path) -> ReportBroker:
    """Read and check a broker file, and the credentials that it names.

    Raises
    ------
    ParameterError
        If something is missing, unknown or out of bounds; the text names file, line and field.
    """
    found = read_file(path, BrokerFile, 'a file of a broker')
    if found.entered is not None:
        read_credentials(found.entered)
    return ReportBroker(**found.way(), topic=found.topic, buffered=found.buffered)
