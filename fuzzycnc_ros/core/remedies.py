# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Ways out of a refusal, as data: who prints it knows what its reader can set."""

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple


class Remedy(NamedTuple):
    """Remedy in words, and the arguments that apply it where the reader has them.

    Parameters
    ----------
    words : str
        What to do, which is true for any caller.
    arguments : mapping of str to str
        Name of an argument, as Python spells it -> value.
    """

    words: str
    arguments: Mapping[str, str]


class RemediedError(ValueError):
    """A refusal whose text ends with what helps.

    Parameters
    ----------
    problem : str
        What was expected and what was found.
    remedies : Remedy
        What helps, best first.
    """

    def __init__(self, problem: str, *remedies: Remedy) -> None:
        super().__init__(problem, *remedies)
        self.problem, self.remedies = problem, remedies

    def __str__(self) -> str:
        return self.told(lambda remedy: remedy.words)

    def told(self, told: Callable[[Remedy], str]) -> str:
        """Return the text with each remedy in other words; an empty one is left out."""
        words = [text for text in map(told, self.remedies) if text]
        return '; '.join([self.problem, *([', or '.join(words)] if words else [])])


def remedied(error: Exception) -> RemediedError | None:
    """Return a refusal whose remedies are known, also where another says what it is about."""
    if isinstance(error, RemediedError):
        return error
    cause = error.__cause__
    if not isinstance(cause, RemediedError) or str(cause) not in str(error):
        return None
    return RemediedError(str(error).replace(str(cause), cause.problem), *cause.remedies)


_OPTION = re.compile(r'(?<![\w-])--([a-z][a-z0-9-]*)')


@contextmanager
def options_as(spelt: Callable[[str], str]) -> Iterator[None]:
    """Name in other words the options that refusals of a command name.

    Parameters
    ----------
    spelt : callable
        Takes an option without its dashes.

    Raises
    ------
    ValueError
        The refusal, of its own class.
    """
    try:
        yield
    except ValueError as error:
        text = _OPTION.sub(lambda match: spelt(match[1]), str(error))
        if text == str(error):
            raise
        raise type(error)(text) from error
