# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One connection to a device: what the drivers of the protocols have in common."""

import os
from collections.abc import Mapping, Sequence
from typing import Protocol, TypeAlias

from fuzzycnc_ros.adapters.link import LinkError

Reading: TypeAlias = float | str
"""A value in degC, for the spindle in rad/s, or why there is none."""


__all__ = ['Link', 'LinkError', 'Reading', 'port_trouble']


class Link(Protocol):
    """A connection that is opened once, read many times and closed; the next one is a new link."""

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes."""

    @property
    def facts(self) -> Mapping[str, str]:
        """Further entries of /diagnostics; most protocols have none."""
        return {}

    async def open(self) -> None:
        """Connect.

        Raises
        ------
        LinkError
            If that fails for a reason that is worth its own words.
        """

    async def read(self) -> Sequence[Reading]:
        """Return a reading of each channel.

        Raises
        ------
        LinkError
            If the connection is of no more use.
        """

    async def close(self) -> None:
        """Let go of everything, whatever state the connection is in."""


def port_trouble(port: str) -> str:
    """Say why a serial port cannot be opened, and what to do."""
    if not os.path.exists(port):
        return f'no serial port {port}; is the adapter plugged in?'
    if not os.access(port, os.R_OK | os.W_OK):
        return f'{port} may not be opened; add the user to the group of the file, often dialout'
    return f'cannot open {port}; another program may hold it, or it is no serial port'
