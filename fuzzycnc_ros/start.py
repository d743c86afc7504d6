# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Entry points of the executables, one name each, whose modules are imported on use.

That takes up to a second, in which a wish to end is to be heard as quietly as later.  So this
module imports next to nothing.
"""

import os
import signal
from collections.abc import Callable
from importlib import import_module
from types import FrameType

COMMAND = 'fuzzycnc'
_CODES = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


def __getattr__(name: str) -> Callable[[], None]:
    """Return the entry point of an executable.

    Raises
    ------
    AttributeError
        If the name is private: none is called like that.
    """
    if name.startswith('_'):
        raise AttributeError(name)

    def main() -> None:
        """Import the module of the executable and run it."""

        def end(number: int, frame: FrameType | None) -> None:
            # Nothing is open yet; once the module runs, it hears signals itself.
            os._exit(_CODES[signal.Signals(number)] if name == COMMAND else 0)

        for number in _CODES:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # `nohup`
                signal.signal(number, end)
        module = 'fuzzycnc_ros.cli.main' if name == COMMAND else f'fuzzycnc_ros.nodes.{name}'
        import_module(module).main()

    return main
