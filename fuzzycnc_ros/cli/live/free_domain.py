# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""ROS domains that nobody else on this host uses."""

import fcntl
import os
import socket
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path

from fuzzycnc_ros.ros.presence import GraphError

DOMAINS = 100
"""ROS domains 1 to 100: above 101 the ports lie among those that the system hands out."""
FIRST_PORT, PORTS_EACH = 7410, 250
"""Port that the first participant of domain 0 takes, and ports of each domain (DDS-RTPS)."""


@contextmanager
def free_domain() -> Iterator[int]:
    """Yield a ROS domain that nobody on this host uses; a lock file holds it against others.

    Raises
    ------
    GraphError
        If there is none.
    """
    for offset in range(DOMAINS):
        number = 1 + (os.getpid() + offset) % DOMAINS
        path = Path(tempfile.gettempdir()) / f'fuzzycnc-domain-{os.getuid()}-{number}.lock'
        with path.open('w') as handle:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind(('', FIRST_PORT + PORTS_EACH * number))
            except OSError:
                continue
            yield number
            return
    raise GraphError(f'expected a free ROS domain among 1 to {DOMAINS} but all are in use')


def own_domain() -> None:
    """Put the graph on a domain of its own: whatever else runs on this host must not mix in.

    It is held until this process ends, and the same however often it is asked for.

    Raises
    ------
    GraphError
        If there is none.
    """
    os.environ['ROS_DOMAIN_ID'] = str(_held(os.getpid())[0])


@contextmanager
def other_domain() -> Iterator[None]:
    """Put what is started within it on a domain of its own, so that nobody's page shows it.

    Raises
    ------
    GraphError
        If there is none.
    """
    before = os.environ.get('ROS_DOMAIN_ID')
    with free_domain() as number:
        os.environ['ROS_DOMAIN_ID'] = str(number)
        try:
            yield
        finally:
            os.environ.pop('ROS_DOMAIN_ID')
            if before is not None:
                os.environ['ROS_DOMAIN_ID'] = before


@cache
def _held(process: int) -> tuple[int, ExitStack]:
    """Take a domain; the stack keeps its lock, which a fork of `process` does not own."""
    stack = ExitStack()
    return stack.enter_context(free_domain()), stack
