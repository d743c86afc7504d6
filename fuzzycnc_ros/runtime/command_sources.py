# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Who publishes what only one node may: with two at once a component believes neither.

Hosts see who publishes a topic; the component only hears of it, by a request that is written down
as an event, so that a replay acts at the same point.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

REQUEST = 'sources'
"""Name of the request; arguments `input` and `node`, names of nodes, none if all is well again."""


class CommandSources:
    """The inputs of a component that several nodes publish at once.

    Parameters
    ----------
    inputs : iterable of str
        Inputs that have to have one source alone.
    """

    def __init__(self, inputs: Iterable[str]) -> None:
        self._known = tuple(inputs)
        self._nodes: dict[str, tuple[str, ...]] = {}

    def note(self, arguments: Mapping[str, Any]) -> str:
        """Take the fact that a host has found; return it in words.

        Raises
        ------
        ValueError
            If it names no such input, or no nodes.
        """
        name, nodes = arguments.get('input'), arguments.get('node')
        if not isinstance(name, str) or name not in self._known:
            known = ', '.join(self._known) or 'none'
            raise ValueError(f'input: expected {known} but found {name}')
        if not _is_names(nodes):
            raise ValueError(f'node: expected a list of node names but found {nodes!r}')
        self._nodes[name] = tuple(nodes or ())
        return self.refusal(name) or f'{name} has one source again'

    def refusal(self, name: str) -> str:
        """Say why nobody is believed on an input; empty if its source is alone."""
        nodes = self._nodes.get(name, ())
        if not nodes:
            return ''
        named = ', '.join(nodes)
        return f'{name} comes from several nodes, all are refused: {named}; end all but one'

    @property
    def refusals(self) -> dict[str, str]:
        """Why nobody is believed, by input; without those that are well."""
        found = {name: self.refusal(name) for name in self._known}
        return {name: text for name, text in found.items() if text}


def _is_names(value: Any) -> bool:
    names = isinstance(value, Sequence) and not isinstance(value, str)
    return names and all(isinstance(item, str) for item in value)
