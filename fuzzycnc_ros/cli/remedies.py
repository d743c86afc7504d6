# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Remedies against a refusal, as options of the command that prints it."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from shlex import quote

from fuzzycnc_ros.core.remedies import Remedy, remedied

_OPTIONS: ContextVar[frozenset[str]] = ContextVar('options', default=frozenset())


@contextmanager
def command_with(options: Collection[str]) -> Iterator[None]:
    """Say which options the command has that runs meanwhile."""
    token = _OPTIONS.set(frozenset(options))
    try:
        yield
    finally:
        _OPTIONS.reset(token)


def sentence(error: Exception) -> str:
    """Return the text of an error, with options of the command that runs.

    A remedy by arguments that it has no options for stays in words, unless it has some for
    another.
    """
    found = remedied(error)
    if found is None:
        return str(error)
    able = any(map(_options, found.remedies))
    return found.told(lambda remedy: _with_options(remedy, able))


def _with_options(remedy: Remedy, able: bool) -> str:
    options = _options(remedy)
    if options:
        return f'{remedy.words}: {options}'
    return '' if able and remedy.arguments else remedy.words


def _options(remedy: Remedy) -> str:
    """Return the options that do it; empty if the command lacks one."""
    named = {f'--{name.replace("_", "-")}': value for name, value in remedy.arguments.items()}
    if not named.keys() <= _OPTIONS.get():
        return ''
    return ' '.join(f'{option} {quote(value)}' for option, value in named.items())
