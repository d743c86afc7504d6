# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Closed parts of a bag to another place, with a proof that they arrived."""

import hashlib
import json
import os
import re
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import urlsplit

from fuzzycnc_ros.bags.errors import BagError, MissingLibraryError
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.files.atomic import write_text

LEDGER = 'shipped.json'
"""File in the bag that says what arrived where."""

FIRST_DELAY, LAST_DELAY = 1.0, 300.0
"""Time [s] before the first attempt anew, and the longest; each is twice the one before."""

PATIENCE = 5.0
"""Time [s] that the end of a recording waits for what is on its way."""

STORES = frozenset({'s3', 's3a', 'gs', 'gcs', 'az', 'abfs', 'abfss', 'oss'})
"""Places with buckets and without folders: what would be made there for a slip is a bucket."""

_BLOCK = 1024 * 1024
_SECRET_NAME = re.compile(r'key|secret|token|password|passwd|credential', re.IGNORECASE)
_SECRET_MIN = 4  # letters; shorter values would blacken words


class Shipper:
    """Ships files in a thread of its own, in order, until each has arrived.

    Parameters
    ----------
    url : str
        Where to, as fsspec writes it: a folder, or for example `s3://bucket/mill`.  Each
        bag has a folder of its own name there.
    bag : Path
        Directory of the bag, where the ledger is kept.
    delay : float
        Time before the first attempt anew [s].

    Raises
    ------
    MissingLibraryError
        If fsspec is not installed, or what it needs for this kind of place.
    BagError
        If the URL carries a password or a query, or is of an unknown kind.

    Notes
    -----
    A part has arrived when what was read back has the SHA-256 of the file here.  A file that is
    there with another content, and was not put there by this object, is never overwritten.
    """

    def __init__(self, url: str, bag: Path, *, delay: float = FIRST_DELAY) -> None:
        self._system, self._root = file_system(url)
        self._has_folders = urlsplit(url).scheme not in STORES
        self._bag = bag
        self._delay = delay
        self._queue: deque[Path] = deque()
        self._ledger: list[dict[str, Any]] = []
        self._attempted: set[str] = set()
        self._trouble = ''
        self._closing = False
        self._given_up = False
        self._changed = threading.Condition()  # guards all of it
        self._thread = threading.Thread(target=self._run, name='bag-shipper', daemon=True)
        self._thread.start()

    @property
    def trouble(self) -> str:
        """Why nothing arrives, and what is done about it; empty while all is well."""
        return self._trouble

    def submit(self, path: Path) -> None:
        """Have a closed file shipped; returns at once."""
        with self._changed:
            self._queue.append(path)
            self._changed.notify()

    def has(self, name: str) -> bool:
        """Return whether a part has arrived."""
        with self._changed:
            return any(entry['part'] == name for entry in self._ledger)

    def close(self, patience: float = PATIENCE) -> list[str]:
        """Wait for what is on its way, but not for long.

        Parameters
        ----------
        patience : float
            Longest wait [s].

        Returns
        -------
        list of str
            What did not arrive, in one sentence; empty if everything did.
        """
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(patience)
        with self._changed:
            self._given_up = True
            self._changed.notify()
            left = [path.name for path in self._queue]
        if not left:
            return []
        cause = self._trouble or (
            f'the place has not taken them within the last {patience:g} s; check it, its access '
            'rights and the network'
        )
        return [
            f'{len(left)} parts of {self._bag} are not shipped ({", ".join(left)}): {cause}; '
            f'copy them yourself, {LEDGER} has the SHA-256 of those that arrived'
        ]

    def _run(self) -> None:
        delay = self._delay
        while True:
            with self._changed:
                while not self._queue and not self._closing:
                    self._changed.wait()
                if self._given_up or not self._queue:
                    return
                path = self._queue[0]
            try:
                entry = self._ship(path)
            except Exception as error:  # a library of any kind may fail in any way
                self._fail(path, error, delay)
                self._rest(delay)
                delay = min(2.0 * delay, LAST_DELAY)
                continue
            delay = self._delay
            with self._changed:
                self._trouble = ''
                self._queue.popleft()
                if entry is not None:
                    self._ledger.append(entry)
            with suppress(OSError):  # the disk is full; the next entry brings this one along
                write_text(self._bag / LEDGER, json.dumps(self._ledger, indent=2) + '\n')

    def _rest(self, delay: float) -> None:
        """Wait [s]; the end of the recording is worth an attempt at once."""
        with self._changed:
            before = self._closing
            self._changed.wait_for(lambda: self._given_up or self._closing != before, delay)

    def _ship(self, path: Path) -> dict[str, Any] | None:
        """Ship a file and return its entry in the ledger; None if it is not there any more."""
        try:
            with open(path, 'rb') as file:
                digest, size = _digest(file)
        except FileNotFoundError:
            return None
        folder = f'{self._root.rstrip("/")}/{self._bag.absolute().name}'
        target = f'{folder}/{path.name}'
        if self._has_folders:
            self._system.makedirs(folder, exist_ok=True)
        self._system.invalidate_cache()
        there = self._system.exists(target)
        if there and path.name not in self._attempted and self._arrived(target) != (digest, size):
            raise FileExistsError(
                f'{target} exists with other content; move it, or rename the bag next time'
            )
        if not there or path.name in self._attempted:
            self._attempted.add(path.name)
            self._system.put_file(str(path), target)
            self._system.invalidate_cache()
        found = self._arrived(target)
        if found != (digest, size):
            raise OSError(
                f'expected {size} bytes of SHA-256 {digest} at {target} but read back {found[1]} '
                f'bytes of {found[0]}'
            )
        now = datetime.now(timezone.utc).isoformat(timespec='seconds')
        return {'part': path.name, 'bytes': size, 'sha256': digest, 'when': now, 'to': target}

    def _arrived(self, target: str) -> tuple[str, int]:
        with self._system.open(target, 'rb') as file:
            return _digest(file)

    def _fail(self, path: Path, error: Exception, delay: float) -> None:
        text = ' '.join(str(error).split()) or type(error).__name__
        self._trouble = (
            f'{path.name} cannot be shipped: {without_secrets(text)}; tried again in {delay:g} s; '
            'check the place, its access rights and the network'
        )


def check_no_secret(url: str) -> None:
    """Refuse a URL that carries a secret, before it stands in a log or a list of processes.

    Raises
    ------
    BagError
        If it does; the text does not repeat it.
    """
    parts = urlsplit(url)
    if parts.query or parts.password or (parts.username and parts.scheme in ('s3', 'gs')):
        raise BagError(
            'ship: expected a URL without a password, key or query but found one; '
            "credentials come from the environment or from the files of the place's own tools"
        )


def file_system(url: str) -> tuple[Any, str]:
    """Return the file system of a URL and the path in it.

    Raises
    ------
    MissingLibraryError
        If a library is missing; the text names it.
    BagError
        If the URL carries a password or a query, or is of an unknown kind.
    """
    check_no_secret(url)
    parts = urlsplit(url)
    try:
        core = load('fsspec.core')
    except MissingLibraryError as error:
        raise MissingLibraryError(
            'ship: expected the Python library fsspec but it is not installed; install it with: '
            "pip install 'fuzzycnc_ros[ship]'"
        ) from error
    try:
        system, root = core.url_to_fs(url)
    except ImportError as error:
        library = 's3fs' if parts.scheme in ('s3', 's3a') else without_secrets(str(error))
        raise MissingLibraryError(
            f'ship: {parts.scheme}:// needs another library, {library}; install it with pip'
        ) from error
    except ValueError as error:
        raise BagError(
            f'ship: expected a folder, s3:// or another kind that fsspec knows but found '
            f'{without_secrets(str(error))}'
        ) from error
    return system, str(root)


def without_secrets(text: str) -> str:
    """Return a text in which no secret of the environment or of fsspec's settings is left.

    Examples
    --------
    >>> os.environ['SHOP_ACCESS_KEY'] = 'x7Lq09'
    >>> without_secrets('denied: x7Lq09 is unknown')
    'denied: *** is unknown'
    >>> del os.environ['SHOP_ACCESS_KEY']
    """
    found = {value for name, value in os.environ.items() if _SECRET_NAME.search(name)}
    with suppress(MissingLibraryError):
        found |= set(_texts(load('fsspec.config').conf))
    for secret in sorted(found, key=len, reverse=True):
        if len(secret) >= _SECRET_MIN:
            text = text.replace(secret, '***')
    return text


def _texts(value: object, name: str = '') -> Iterator[str]:
    """Yield the texts in nested settings whose name is one of a secret."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _texts(item, str(key))
    elif isinstance(value, str) and _SECRET_NAME.search(name):
        yield value


def _digest(file: BinaryIO) -> tuple[str, int]:
    """Return the SHA-256 and the size of what can be read."""
    digest, size = hashlib.sha256(), 0
    while block := file.read(_BLOCK):
        digest.update(block)
        size += len(block)
    return digest.hexdigest(), size
