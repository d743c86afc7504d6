# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Open compensation stack for CNC machines as a ROS 2 node graph.

Doors for Python, loaded when they are first used: `fuzzycnc_ros.thermal`, `.feedrate`, `.servo`,
`.soft` and `.fleet`; `docs/tutorials/python.md` shows each of them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fuzzycnc_ros.api import feedrate as feedrate
    from fuzzycnc_ros.api import fleet as fleet
    from fuzzycnc_ros.api import servo as servo
    from fuzzycnc_ros.api import soft as soft
    from fuzzycnc_ros.api import thermal as thermal

__version__ = '0.1.0'
_DOORS = ('feedrate', 'fleet', 'servo', 'soft', 'thermal')


def __getattr__(name: str) -> Any:
    """Load a door; nodes and commands that need none do not pay for it."""
    if name in _DOORS:
        return import_module(f'fuzzycnc_ros.api.{name}')
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    """List the doors beside what is defined here."""
    return sorted({*globals(), *_DOORS})
