# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Text of foreign origin as terminals and pages may show it, and names that come twice."""

import unicodedata
from collections import Counter
from collections.abc import Iterable

CONTROLS = frozenset({'Cc', 'Cf', 'Cs', 'Zl', 'Zp'})
"""Unicode categories of what is no character but an order: C0, C1 and DEL, format and direction,
halves of characters, line and paragraph separators."""


def visible(text: str, keep: str = '') -> str:
    r"""Return a text with its control characters spelt out; they move no cursor, hide nothing.

    Names come from files, topics and devices of others, and reach terminals and pages.

    Parameters
    ----------
    text : str
        Any text.
    keep : str
        Control characters that stay.

    Examples
    --------
    >>> print(visible('T1\x1b[2J\u202e'))
    T1\x1b[2J\u202e
    """
    if text.isprintable():
        return text
    return ''.join(
        _spelt_out(character)
        if unicodedata.category(character) in CONTROLS and character not in keep
        else character
        for character in text
    )


def _spelt_out(character: str) -> str:
    code = ord(character)
    if code < 0x100:
        return f'\\x{code:02x}'
    return f'\\u{code:04x}' if code < 0x10000 else f'\\U{code:08x}'


def repeated_names(names: Iterable[str]) -> list[str]:
    """Return the names that come more than once, sorted; a list of thousands takes no time.

    Examples
    --------
    >>> repeated_names(['T2', 'T1', 'T3', 'T1', 'T2'])
    ['T1', 'T2']
    """
    return sorted(name for name, count in Counter(names).items() if count > 1)
