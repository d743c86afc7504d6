# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Persistent outputs: the newest record of each, kept on disk over a restart."""

from pathlib import Path

from rclpy.serialization import deserialize_message, serialize_message

from fuzzycnc_ros.files.atomic import write_text
from fuzzycnc_ros.ros.topics import RCLPY, message_class
from fuzzycnc_ros.runtime.component import Output
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.runtime.records import Record

_SIZE_MAX = 1 << 24


class StateFileError(RuntimeError):
    """A state file cannot be read or written; the text names it and the remedy."""


class StateDirectory:
    """One file per persistent output, written whole or not at all.

    Parameters
    ----------
    path : str
        Directory; empty switches persistence off.
    owner : str
        Fully qualified node name, so that the machines of a shop keep apart.
    """

    def __init__(self, path: str, owner: str) -> None:
        self._path = Path(path).expanduser() if path else None
        self._owner = owner.strip('/').replace('/', '.')
        if self._path is not None:
            try:
                self._path.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise StateFileError(
                    f'state_directory {self._path}: {error.strerror}; name a writable directory'
                ) from error

    def save(self, output: Output, record: Record) -> None:
        """Keep a record; the one before stays whole if this fails.

        Raises
        ------
        StateFileError
            If the file cannot be written.
        """
        if self._path is None:
            return
        file = self._file(output)
        payload = f'{record.TYPE}\n'.encode() + serialize_message(encode(record, RCLPY))
        try:
            write_text(file, payload)
        except OSError as error:
            raise StateFileError(f'{file}: {error.strerror}; state is not kept') from error

    def load(self, output: Output) -> Record | None:
        """Return the record kept from an earlier life, None if there is none.

        Raises
        ------
        StateFileError
            If the file is damaged.
        """
        if self._path is None:
            return None
        file = self._file(output)
        try:
            if file.stat().st_size > _SIZE_MAX:
                raise StateFileError(f'{file}: larger than {_SIZE_MAX} bytes; delete it')
            head, _, body = file.read_bytes().partition(b'\n')
        except FileNotFoundError:
            return None
        except OSError as error:
            raise StateFileError(f'{file}: {error.strerror}; state is not restored') from error
        if head.decode('ascii', 'replace') != output.record.TYPE or len(body) < 4:
            raise StateFileError(
                f'{file}: expected {output.record.TYPE} but found '
                f'{head[:80].decode("ascii", "replace")!r}; delete it'
            )
        try:
            message = deserialize_message(body, message_class(output.record.TYPE))
        except Exception as error:  # rmw raises its own kinds for damaged bytes
            raise StateFileError(f'{file}: damaged ({error}); delete it') from error
        return decode(output.record, message)

    def _file(self, output: Output) -> Path:
        assert self._path is not None
        return self._path / f'{self._owner}.{output.name}.state'
