# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Report of a node, and the part of it that concerns an operator."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from fuzzycnc_ros.components.dashboard.values import finite, number
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.host import NodeConfiguration

NODE_SILENT = 5.0
"""Time [s] without a report after which a node does not answer: they report once a second."""
_VERBS = frozenset(
    (
        *('activate', 'add', 'call', 'check', 'choose', 'compare', 'cut', 'deactivate', 'delete'),
        *('end', 'force', 'give', 'import', 'look', 'name', 'plug', 'put', 'raise', 'release'),
        *('repair', 'replace', 'restart', 'see', 'send', 'set', 'start', 'train', 'try', 'use'),
    )
)
"""Words with which nodes begin to say what to do."""


@dataclass(frozen=True)
class Alarm:
    """Something that an operator has to know."""

    level: str
    node: str
    name: str
    cause: str
    remedy: str


def split_advice(text: str) -> tuple[str, str]:
    """Return cause and remedy of what a node says; the remedy may be empty.

    Nodes say first what is wrong, then, behind a semicolon, what to do.

    Examples
    --------
    >>> split_advice('no model; set the parameter model or call train_thermal_model')
    ('no model', 'set the parameter model or call train_thermal_model')
    """
    parts = text.split('; ')
    for place, part in enumerate(parts):
        if place and part.split(' ')[0] in _VERBS:
            return '; '.join(parts[:place]), '; '.join(parts[place:])
    return text, ''


@dataclass
class NodeReport:
    """Report of a node.

    Attributes
    ----------
    ended : bool
        Whether its process is known to have ended.
    heard_at : float, optional
        Time of its newest health [s].
    items : tuple of Health
        Its newest health.
    configuration : NodeConfiguration, optional
        What it runs with.
    parameters : mapping
        The same, read.
    """

    ended: bool = False
    heard_at: float | None = None
    items: tuple[Health, ...] = ()
    configuration: NodeConfiguration | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def told(self) -> bool:
        """True if it has reported anything: others, such as an operator's, only pass by."""
        return self.heard_at is not None or self.configuration is not None

    def silent(self, now: float) -> bool:
        """Return True if it reports no more."""
        return self.heard_at is not None and now - self.heard_at > NODE_SILENT

    @property
    def lifecycle(self) -> str:
        """Lifecycle state that it has told last; empty if none."""
        return '' if self.configuration is None else self.configuration.lifecycle_state

    def alarms(self, name: str, now: float) -> list[Alarm]:
        """Return what an operator has to know of the node of a name."""
        if self.ended:
            remedy = f'start it again; its log says why it ended (ros2 run fuzzycnc_ros {name})'
            return [Alarm('error', name, 'ended', f'{name} has ended', remedy)]
        if self.silent(now):
            assert self.heard_at is not None, 'it was heard before it was silent'
            cause = f'{name} does not report, for {now - self.heard_at:.0f} s'
            remedy = 'look whether its process hangs, and at the network to its computer'
            return [Alarm('error', name, 'silent', cause, remedy)]
        return [
            Alarm(
                'warn' if item.level is Level.WARN else 'error',
                name,
                item.name,
                *split_advice(item.message),
            )
            for item in self.items
            if item.level > Level.OK
        ]

    def document(self, name: str, now: float) -> dict[str, Any]:
        """Return how the node of a name is."""
        worst = max((item.level for item in self.items), default=Level.OK)
        level = {Level.OK: 'ok', Level.WARN: 'warn', Level.ERROR: 'error'}.get(worst, 'stale')
        lifecycle = self.lifecycle or ('running' if self.heard_at is not None else '')
        if self.ended:
            level, lifecycle = 'error', 'ended'
        elif self.silent(now):
            level, lifecycle = 'stale', 'silent'
        activity: Mapping[str, str] = {}
        for item in self.items:
            if item.name == 'activity':
                activity = item.values
        rate = finite(number(activity.get('rate [1/s]', 'nan')))
        latency = finite(1e-3 * number(activity.get('latency [ms]', 'nan')))
        troubles = sorted((i for i in self.items if i.level > Level.OK), key=lambda i: -i.level)
        return {
            'name': visible(name),
            'lifecycle': lifecycle,
            'level': level,
            'rate': rate,
            'latency': latency,
            'trouble': [visible(f'{item.name}: {item.message}') for item in troubles],
        }
