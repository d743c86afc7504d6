# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Names: foreign text as terminals and pages show it, as topics and files; hashes, repetitions."""

import hashlib
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable
from itertools import chain, count

CONTROLS = frozenset({'Cc', 'Cf', 'Cs', 'Zl', 'Zp'})
"""Unicode categories of what is no character but an order: C0, C1 and DEL, format and direction,
halves of characters, line and paragraph separators."""
_WORD = re.compile(r'(?!\d)[a-z0-9]+(_[a-z0-9]+)*', re.ASCII | re.IGNORECASE)
_WORD_MAX = 60
"""Longest word of a topic [characters]: ROS takes 247 for all of it, with the namespace."""


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


def first_names(names: Iterable[str], shown: int = 8) -> str:
    """Return names, each once, and how many more there are.

    Examples
    --------
    >>> first_names(['t1', 't2', 't3', 't4', 't4'], 2)
    't1, t2 and 2 more'
    """
    each = list(dict.fromkeys(name for name in names if name))
    more = f' and {len(each) - shown} more' if len(each) > shown else ''
    return ', '.join(each[:shown]) + more


def in_counting_order(name: str) -> list[tuple[str, int]]:
    """Return a key that sorts names as people count.

    Examples
    --------
    >>> sorted(['t10', 't2', 't1', 'air'], key=in_counting_order)
    ['air', 't1', 't2', 't10']
    """
    return [(word, int(digits or 0)) for word, digits in re.findall(r'(\D*)([0-9]{0,18})', name)]


def repeated_names(names: Iterable[str]) -> list[str]:
    """Return the names that come more than once, sorted; a list of thousands takes no time.

    Examples
    --------
    >>> repeated_names(['T2', 'T1', 'T3', 'T1', 'T2'])
    ['T1', 'T2']
    """
    return sorted(name for name, count in Counter(names).items() if count > 1)


def file_word(machine: str) -> str:
    """Return the name of a machine as a part of a file's name; no two share one.

    A namespace has slashes, and no hyphen, which stands for them.

    Examples
    --------
    >>> file_word('shop/mill'), file_word('shop_mill')
    ('shop-mill', 'shop_mill')
    """
    return machine.replace('/', '-')


def text_hash(text: str) -> str:
    """Return the SHA-256 of a text in UTF-8, 64 hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def topic_words(names: Iterable[str]) -> dict[str, str]:
    """Return a word of a topic for each name; no two share one.

    A name that is such a word stays as it is.  In others, what a topic may not hold becomes `_`;
    of those that would be alike the second gets a number.

    Parameters
    ----------
    names : iterable of str
        Any names, each once; the same names in the same order get the same words.

    Examples
    --------
    >>> topic_words(['T 1', 'T-1', 'T_1', '28-0316', '?'])
    {'T 1': 'T_1_2', 'T-1': 'T_1_3', 'T_1': 'T_1', '28-0316': 's28_0316', '?': 's'}
    """
    found = {name: name if _is_word(name) else '' for name in names}
    taken = set(found.values())
    for name in [name for name, word in found.items() if not word]:
        base = '_'.join(re.findall('[a-z0-9]+', name, re.ASCII | re.IGNORECASE))
        base = (base if base and not base[0].isdigit() else f's{base}')[:_WORD_MAX].rstrip('_')
        numbered = chain([base], (f'{base}_{number}' for number in count(2)))
        found[name] = next(word for word in numbered if word not in taken)
        taken.add(found[name])
    return found


def _is_word(name: str) -> bool:
    return len(name) <= _WORD_MAX and _WORD.fullmatch(name) is not None
