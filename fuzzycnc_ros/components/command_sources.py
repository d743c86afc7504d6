# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Who commands a machine: with two at once the machine side refuses both.

Hosts see who publishes a topic; the component only hears of it, by a request that is written down
as an event, so that a replay acts at the same point.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from fuzzycnc_ros.components.component import Answer, Component, Health, Level

REQUEST = 'sources'
"""Name of the request; arguments `input` and `node`, names of nodes, none if all is well again."""


class CommandSources:
    """The inputs of a component that several nodes command at once.

    Parameters
    ----------
    component : type
        Declares which inputs have to have one source alone.
    """

    def __init__(self, component: type[Component]) -> None:
        self._known = tuple(item.name for item in component.INPUTS if item.sole)
        self._nodes: dict[str, tuple[str, ...]] = {}

    def note(self, arguments: Mapping[str, Any]) -> Answer:
        """Take the fact that a host has found."""
        name, nodes = arguments.get('input'), arguments.get('node')
        if name not in self._known:
            return Answer(
                False, f'input: expected {", ".join(self._known) or "none"} but found {name}'
            )
        if not _is_names(nodes):
            return Answer(False, f'node: expected a list of node names but found {nodes!r}')
        assert isinstance(name, str)
        self._nodes[name] = tuple(nodes or ())
        return Answer(True, self.refusal(name) or f'{name} has one source again')

    def refusal(self, name: str) -> str:
        """Say why nobody is followed on an input; empty if its source is alone."""
        nodes = self._nodes.get(name, ())
        if not nodes:
            return ''
        named = ', '.join(nodes)
        return f'{name} comes from several nodes, all are refused: {named}; end all but one'

    def health(self) -> list[Health]:
        """Report each input that nobody is followed on."""
        found = [self.refusal(name) for name in self._known]
        return [
            Health(f'sources of {name}', Level.ERROR, text)
            for name, text in zip(self._known, found, strict=True)
            if text
        ]


def _is_names(value: Any) -> bool:
    names = isinstance(value, Sequence) and not isinstance(value, str)
    return names and all(isinstance(item, str) for item in value)
