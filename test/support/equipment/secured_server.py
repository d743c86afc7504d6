# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Certificates and one user for a secured OPC UA server."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from asyncua.crypto.permission_rules import SimpleRoleRuleset
from asyncua.server.user_managers import User, UserRole
from cryptography.x509.oid import ExtendedKeyUsageOID

SECURITY = (
    'security: {policy: Basic256Sha256, certificate: own.der, private_key: own-key.pem, '
    'server_certificate: control.der}'
)
"""Fields of a file beside the certificates."""
PASSWORD = 'secret'


def certificate(folder: Path, name: str, uri: str, usage: Any) -> tuple[Path, Path]:
    """Make a self-signed certificate; return certificate and key."""
    made = folder / f'{name}.der', folder / f'{name}-key.pem'
    asyncio.run(setup_self_signed_certificate(made[1], made[0], uri, 'localhost', [usage], {}))
    made[1].chmod(0o600)
    return made


PINNING = SECURITY.replace(', server_certificate: control.der', '')
"""The same without the certificate of the server."""


def secured(
    folder: Path, heard: Callable[[Any], Any] = lambda name: None
) -> Callable[[Server], Any]:
    """Make certificates of both sides; return what secures a server with them.

    `heard` is told the name of everybody who sends a password.
    """
    theirs = certificate(folder, 'control', 'urn:control', ExtendedKeyUsageOID.SERVER_AUTH)
    certificate(folder, 'own', 'urn:fuzzycnc:mill', ExtendedKeyUsageOID.CLIENT_AUTH)

    async def secure(server: Server) -> None:
        policies = [ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt]
        server.set_security_policy(policies, SimpleRoleRuleset())
        await server.set_application_uri('urn:control')
        await server.load_certificate(str(theirs[0]))
        await server.load_private_key(str(theirs[1]))
        server.set_identity_tokens([ua.UserNameIdentityToken])
        server.iserver.user_manager = Users(heard)

    return secure


def user_file(folder: Path, password: str = PASSWORD) -> Path:
    """Write the credentials of the one user; return the file."""
    path = folder / 'user.yaml'
    path.write_text(f'username: joe\npassword: {password}\n')
    path.chmod(0o600)
    return path


class Users:
    """One user may log in."""

    def __init__(self, heard: Callable[[Any], Any]) -> None:
        self._heard = heard

    def get_user(
        self, iserver: Any, username: Any = None, password: Any = None, certificate: Any = None
    ) -> User | None:
        self._heard(username)
        allowed = (username, password) == ('joe', PASSWORD)
        return User(role=UserRole.User, name=username) if allowed else None
