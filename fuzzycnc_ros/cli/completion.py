# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Proposals of a shell for the value of an option; nothing is imported until it asks."""

from collections.abc import Callable, Iterable, MutableMapping, Sequence
from glob import escape, glob
from os.path import isdir

Words = Sequence[str] | Callable[[], Iterable[str]]
"""Words that an option takes, or what gives them when a shell asks."""

Complete = Callable[[str], list[str]]
"""Takes what was typed so far and returns the values that begin so."""


def one_of(words: Words) -> Complete:
    """Return the completion of an option that takes one word.

    Examples
    --------
    >>> one_of(('thermal', 'contour'))('th')
    ['thermal']
    """

    def complete(incomplete: str) -> list[str]:
        return [word for word in _given(words) if word.startswith(incomplete)]

    return complete


def some_of(words: Words) -> Complete:
    """Return the completion of an option that takes several words with commas between.

    Examples
    --------
    >>> some_of(('D0', 'T1', 'T2'))('T2,T')
    ['T2,T1']
    """

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(',')
        taken = before.split(',')
        return [
            f'{before}{comma}{word}'
            for word in _given(words)
            if word.startswith(last) and word not in taken
        ]

    return complete


def word_or_file(words: Words, *endings: str) -> Complete:
    """Return the completion of an argument that takes one word, or a file with an ending."""

    def complete(incomplete: str) -> list[str]:
        paths = sorted(glob(escape(incomplete) + '*'))
        return [
            *one_of(words)(incomplete),
            *(f'{path}/' for path in paths if isdir(path)),
            *(path for path in paths if path.endswith(endings) and not isdir(path)),
        ]

    return complete


def _given(words: Words) -> Iterable[str]:
    return words() if callable(words) else words


def node_names() -> list[str]:
    """Return the names of the nodes that have a component."""
    from fuzzycnc_ros.registry import COMPONENTS

    return list(COMPONENTS)


def managed_nodes() -> list[str]:
    """Return the names of the nodes that have a lifecycle."""
    from fuzzycnc_ros.registry import COMPONENTS

    return [name for name, item in COMPONENTS.items() if item.MANAGED]


def settings(incomplete: str) -> list[str]:
    """Return NODE.NAME= of every parameter that begins so."""
    return _settings(incomplete, live=False)


def live_settings(incomplete: str) -> list[str]:
    """Return NODE.NAME= of every parameter that begins so and may change while the node runs."""
    return _settings(incomplete, live=True)


def _settings(incomplete: str, *, live: bool) -> list[str]:
    from dataclasses import fields

    from fuzzycnc_ros.registry import COMPONENTS

    found = (
        f'{node}.{item.name}='
        for node, component in COMPONENTS.items()
        for item in fields(component.CONFIG)
        if item.metadata['live'] or not live
    )
    return [text for text in found if text.startswith(incomplete)]


def join_bash_words(environment: MutableMapping[str, str]) -> None:
    """Take the sign out of `--option = value`, into which bash cuts `--option=value`.

    Parameters
    ----------
    environment : mapping
        Variables of a process that bash asks for completions: COMP_WORDS, with spaces or lines
        between the words, and COMP_CWORD, the number of the word that is being typed.
    """
    words = environment.get('COMP_WORDS', '').split()
    number = int(environment.get('COMP_CWORD', '0'))
    for place in range(min(number, len(words)) - 1, 0, -1):
        if words[place] == '=' and words[place - 1].startswith('--'):
            del words[place]
            number -= 1
            environment.update(COMP_WORDS=' '.join(words), COMP_CWORD=str(number))
