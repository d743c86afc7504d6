# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading messages of older message sets, by named upgraders from one version to the next."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from fuzzycnc_ros.bags.errors import BagVersionError
from fuzzycnc_ros.runtime.provenance import MESSAGE_SET

Upgrader = Callable[[Any], Any]
"""Takes a message of one version and returns what the next version has in its place.

The argument has the old definition's attributes; so has the result the new one's.
"""


@dataclass
class Upgraders:
    """Upgraders by type and the version that they start from.

    Parameters
    ----------
    current : int
        Version that all messages are brought to.

    Examples
    --------
    >>> upgraders = Upgraders(current=2)
    >>> @upgraders.register('fuzzycnc_msgs/msg/Note', 1)
    ... def note_gets_upper_case(message):
    ...     return message.upper()
    >>> upgraders.upgrade('fuzzycnc_msgs/msg/Note', 1, 'warm')
    'WARM'
    """

    current: int = MESSAGE_SET
    _steps: dict[tuple[str, int], Upgrader] = field(default_factory=dict)

    def register(self, type_name: str, version: int) -> Callable[[Upgrader], Upgrader]:
        """Return a decorator that registers the upgrader of a type from `version` to the next.

        Raises
        ------
        ValueError
            If there is one already, or `version` is not older than the current one.
        """
        if version >= self.current or (type_name, version) in self._steps:
            raise ValueError(
                f'{type_name}: expected one upgrader from a version before {self.current} '
                f'but found another from {version}'
            )

        def decorator(upgrader: Upgrader) -> Upgrader:
            self._steps[type_name, version] = upgrader
            return upgrader

        return decorator

    def names(self, type_name: str, version: int) -> list[str]:
        """Return the names of the upgraders that a message of `version` passes, in order."""
        return [step.__name__ for step in self._chain(type_name, version)]

    def upgrade(self, type_name: str, version: int, message: Any) -> Any:
        """Bring a message from `version` to the current one."""
        for step in self._chain(type_name, version):
            message = step(message)
        return message

    def _chain(self, type_name: str, version: int) -> list[Upgrader]:
        steps = ((type_name, v) for v in range(version, self.current))
        return [self._steps[step] for step in steps if step in self._steps]

    def check_version(self, version: int, where: object) -> None:
        """Refuse a bag that a newer fuzzycnc recorded.

        Raises
        ------
        BagVersionError
            If `version` is newer than the current one.
        """
        if version > self.current:
            raise BagVersionError(
                f'{where}: expected message set {self.current} or older but found {version}; '
                'install the fuzzycnc that recorded it, or a newer one'
            )


UPGRADERS = Upgraders()
"""The upgraders of this version; message set 1 is the first, so there is none yet."""
