# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Text of files that others wrote; another encoding is refused by its likely name."""

import codecs
from collections.abc import Callable, Sequence

_LIKELY = ('cp1252', 'latin-1', 'utf-16')
"""Encodings of files that are not UTF-8, that of Excel on Windows first."""

_WIDE = ('utf-16', 'utf-32')  # encodings with zero bytes in plain text


def _save(likely: Sequence[str]) -> str:
    return 'save it as UTF-8'


def decoded(
    data: bytes,
    encoding: str = 'utf-8',
    errors: str = 'strict',
    remedy: Callable[[Sequence[str]], str] = _save,
) -> str:
    """Return the text of a file without a byte order mark, its line ends as they are.

    Parameters
    ----------
    data : bytes
        The whole file.
    encoding : str
        Its encoding.
    errors : str
        Handling of what is no text in it, of `codecs`; UTF-16 and zero bytes are refused by any.
    remedy : callable
        Names what helps, given the likely encodings.

    Raises
    ------
    ValueError
        If it is no such text; without the file's name.

    Examples
    --------
    >>> decoded('20 µm'.encode('cp1252'))
    Traceback (most recent call last):
    ValueError: line 1: expected text in utf-8 but byte 3 is 0xb5, in cp1252 'µ'; save it as UTF-8
    """
    if not codecs.lookup(encoding).name.startswith(_WIDE):
        if _looks_wide(data):
            raise ValueError(
                f'expected text in {encoding} but found what looks like UTF-16; '
                f'{remedy(("utf-16",))}'
            )
        place = data.find(b'\0')
        if place >= 0:
            line, number = data.count(b'\n', 0, place) + 1, data.count(0)
            found = 'a zero byte' if number == 1 else f'{number} zero bytes, the first one'
            raise ValueError(
                f'line {line}: expected text but found {found} as byte {place}, as a torn write '
                'leaves them; delete what is damaged'
            )
    try:
        text = data.decode(encoding, errors)
    except UnicodeDecodeError as error:
        line = data.count(b'\n', 0, error.start) + 1
        byte = data[error.start : error.start + 1]
        raise ValueError(
            f'line {line}: expected text in {encoding} but byte {error.start} is 0x{byte.hex()}, '
            f'in cp1252 {byte.decode("cp1252", "replace")!r}; '
            f'{remedy([name for name in _LIKELY if name != encoding])}'
        ) from error
    except UnicodeError as error:
        raise ValueError(f'expected text in {encoding} but found {error}') from error
    return text.removeprefix('\ufeff')


def is_utf8(data: bytes) -> bool:
    """Return whether bytes are text in UTF-8."""
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True


def _looks_wide(data: bytes) -> bool:
    """Return whether every other byte is zero, as of plain text in UTF-16."""
    zeros = sorted((data[::2].count(0), data[1::2].count(0)))
    marked = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return marked or (zeros[1] > len(data) // 4 and zeros[0] < zeros[1] / 4)
