# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The rule for files with a token, a password or a private key: they are their owner's alone."""

from pathlib import Path

OTHERS = 0o077
"""Permissions that others than the owner have."""


def check_secret(path: Path, what: str) -> None:
    """Refuse a secret file that others than its owner can read or change.

    Parameters
    ----------
    path : Path
        The file.
    what : str
        What is in it, for the message.

    Raises
    ------
    ValueError
        If they can, or it is not there; the message names the file, and the remedy.
    """
    try:
        mode = path.stat().st_mode & 0o777
    except OSError as error:
        raise ValueError(
            f'{what} {path}: expected a readable file but found: {error.strerror}'
        ) from error
    if mode & OTHERS:
        raise ValueError(
            f'{what} {path}: expected a file that only its owner can read but found mode '
            f'{mode:o}; run chmod 600 {path}'
        )
