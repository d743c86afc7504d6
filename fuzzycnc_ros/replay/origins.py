# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Writers of a bag's topics: which a replay has to recompute, and which it takes as given.

A topic of a component's output is expected to be recomputed, even if nothing else in the bag tells
of that component: a `node_configuration` that is lost must not take its outputs along unseen.
Another node is believed to have written it only if the recorder saw so, or a person says so.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache

from fuzzycnc_ros.bags.canonical import excluded
from fuzzycnc_ros.bags.typestore import PACKAGE
from fuzzycnc_ros.registry import COMPONENTS, MACHINES

REPLAYABLE = tuple(name for name in COMPONENTS if name not in MACHINES)
"""Components that a replay sets up."""

_CONFIGURATION = 'node_configuration'

GIVEN_REMEDY = 'name it as given if another node wrote it'
"""Ends the reasons for which a topic may be one that no replay recomputes."""


@dataclass(frozen=True)
class Origin:
    """Origin of the messages of a topic that were not recomputed."""

    given: bool
    """True if a replay takes them as they are; otherwise it should have recomputed them."""
    text: str
    """Writer of the messages, or the reason why they were not recomputed."""


@dataclass(frozen=True)
class Origins:
    """Writers of a bag's topics.

    Attributes
    ----------
    topics : mapping of str to str
        Type of each topic of the bag.
    configured : collection of str
        Nodes whose configuration is in the bag, `<namespace>/<node>`.
    traces : collection of str
        Nodes that something else in the bag tells of.
    publishers : mapping of str to collection of str
        Nodes that the recorder saw publish on a topic; empty if it did not say.
    given : collection of str
        Topics that a person says another node wrote, with or without their namespace.
    """

    topics: Mapping[str, str]
    configured: Collection[str] = ()
    traces: Collection[str] = ()
    publishers: Mapping[str, Collection[str]] = field(default_factory=dict)
    given: Collection[str] = ()

    def of(self, topic: str) -> Origin | None:
        """Return the origin of a topic that was not recomputed; None if it is no business of ours.

        Those are topics that tell how the run was carried out, and messages that no component
        takes or gives.
        """
        if excluded(topic):
            return None
        kind = self.topics[topic]
        space, _, name = topic.rpartition('/')
        if topic in self.given or name in self.given:
            return Origin(True, 'said to be of another node')
        seen = self.publishers.get(topic, ())
        own = [node for node in seen if node.rpartition('/')[2] in REPLAYABLE]
        if own:
            return Origin(False, self._lacking(own))
        if seen and self._foreign(seen):
            return Origin(True, f'of {", ".join(sorted(seen))}')
        machines, writers = _writers(name, kind, MACHINES), _writers(name, kind, REPLAYABLE)
        if writers:
            nodes = [f'{space}/{node}' for node in writers]
            known = [node for node in nodes if node in self.configured or node in self.traces]
            others = machines or not kind.startswith(f'{PACKAGE}/')
            if known or not others or any(self._has_outputs(node) for node in nodes):
                return Origin(False, self._lacking(known or nodes, sure=bool(known)))
        if machines:
            return Origin(True, 'of the machine')
        if _is_input(name, kind):
            return Origin(True, 'an input')
        if kind in _only_replayable():
            return Origin(
                False,
                'no node in the bag writes a topic of this name; one that was renamed cannot be '
                f'replayed; {GIVEN_REMEDY}',
            )
        return None

    def _foreign(self, nodes: Iterable[str]) -> bool:
        """Return True if none of some nodes serves a component that a replay might set up."""
        own = {
            node
            for topic, seen in self.publishers.items()
            if topic.rpartition('/')[2] == _CONFIGURATION
            for node in seen
        }
        return all(node not in own or node.rpartition('/')[2] in MACHINES for node in nodes)

    def _has_outputs(self, node: str) -> bool:
        """Return True if a topic is in the bag that no machine but this node writes."""
        space, _, name = node.rpartition('/')
        return any(
            self.topics.get(f'{space}/{item.name}') == item.record.TYPE
            and not _writers(item.name, item.record.TYPE, MACHINES)
            for item in COMPONENTS[name].OUTPUTS
        )

    def _lacking(self, nodes: Iterable[str], *, sure: bool = True) -> str:
        """Say why what some nodes wrote was not recomputed."""
        lost = [node for node in nodes if node not in self.configured]
        if not lost:
            return 'under another name than its node has for it, which cannot be replayed'
        text = f'the bag has no node_configuration of {" or ".join(lost)}'
        return text if sure else f'{text}; {GIVEN_REMEDY}'


def _writers(name: str, kind: str, nodes: Iterable[str]) -> list[str]:
    return [
        node
        for node in nodes
        if any(o.name == name and o.record.TYPE == kind for o in COMPONENTS[node].OUTPUTS)
    ]


def _is_input(name: str, kind: str) -> bool:
    return any(
        item.name == name and item.record.TYPE == kind
        for component in COMPONENTS.values()
        for item in component.INPUTS
    )


@cache
def _only_replayable() -> frozenset[str]:
    """Return the types of this package that nobody but a replayable component publishes."""
    machines = {o.record.TYPE for name in MACHINES for o in COMPONENTS[name].OUTPUTS}
    own = {o.record.TYPE for name in REPLAYABLE for o in COMPONENTS[name].OUTPUTS}
    return frozenset(kind for kind in own - machines if kind.startswith(f'{PACKAGE}/'))
