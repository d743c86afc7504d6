# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The text of a CSV file, whatever program wrote it."""

import codecs
from pathlib import Path

from fuzzycnc_ros.bags.errors import CsvError

ENCODINGS = ('cp1252', 'latin-1', 'utf-16')
"""What programs write that do not write UTF-8, Excel on Windows first."""

_WORKBOOKS = (b'PK\x03\x04', b'\xd0\xcf\x11\xe0')
_UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: Path, encoding: str) -> str:
    """Return the text of a file without a byte order mark.

    Raises
    ------
    CsvError
        If it cannot be read, is a workbook, or is no text in this encoding.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CsvError(f'{path}: cannot be read: {error.strerror}') from error
    if data.startswith(_WORKBOOKS):
        raise CsvError(
            f'{path}: expected a CSV file but found a workbook; save its sheet as CSV (UTF-8)'
        )
    if (data.startswith(_UTF16_MARKS) or b'\0' in data) and not _is_wide(encoding):
        raise CsvError(
            f'{path}: expected text in {encoding} but found what looks like UTF-16; import with '
            '--encoding utf-16'
        )
    if not _is_unicode(encoding) and not data.isascii() and _is_utf8(data):
        raise CsvError(
            f'{path}: expected text in {encoding} but it is UTF-8; import without --encoding'
        )
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        line = data.count(b'\n', 0, error.start) + 1
        byte = data[error.start : error.start + 1]
        others = [name for name in ENCODINGS if name != encoding]
        raise CsvError(
            f'{path}, line {line}: expected text in {encoding} but byte {error.start} is '
            f'0x{byte.hex()}, in cp1252 {byte.decode("cp1252", "replace")!r}; import with '
            f'--encoding {others[0]}, or else {" or ".join(others[1:])}'
        ) from error
    except UnicodeError as error:
        raise CsvError(f'{path}: expected text in {encoding} but found {error}') from error
    return text.removeprefix('\ufeff')


def _is_unicode(encoding: str) -> bool:
    return codecs.lookup(encoding).name.startswith('utf')


def _is_utf8(data: bytes) -> bool:
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True


def _is_wide(encoding: str) -> bool:
    """Return whether an encoding has zero bytes in plain text."""
    return codecs.lookup(encoding).name.startswith(('utf-16', 'utf-32'))
