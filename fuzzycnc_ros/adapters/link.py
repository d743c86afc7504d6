# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Failures of a connection."""

import asyncio


class LinkError(Exception):
    """A connection failed.

    Parameters
    ----------
    text : str
        What happened and what to do, for the operator.
    pause : float
        Shortest time before another try [s].
    """

    def __init__(self, text: str, pause: float = 0.0) -> None:
        super().__init__(text)
        self.pause = pause


def trouble_in_words(error: Exception, timeout: float) -> str:
    """Say what went wrong with a connection that gets `timeout` [s] for an answer."""
    if isinstance(error, (asyncio.TimeoutError, TimeoutError)):
        return f'no answer within {timeout:g} s'
    if isinstance(error, ConnectionRefusedError):
        return 'connection refused; is the server running, is the port right?'
    if isinstance(error, OSError):
        return f'connection lost ({error})'
    # Whatever the other side made a library stumble over.
    return f'answer not understood: {type(error).__name__}: {error}'
