# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What can go wrong with a connection."""


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
