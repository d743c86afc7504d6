# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A process that reads values from HAL: names as its arguments, JSON lines out.

As `hal_process` it runs under the Python that LinuxCNC's modules are built for.  Each line that it
reads gets one line of answer: a list with a value for each name, null where HAL has none of it.
It reads pins, signals and parameters, writes nothing, and needs HAL alone, no LinuxCNC.
"""

import json
import os
import signal
import sys
from importlib import import_module

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
common = import_module('hal_process')


def values(hal, names):
    """Return a value for each name, None where there is none; NaN and infinity as texts."""
    found = []
    for name in names:
        try:
            value = hal.get_value(name)
        except RuntimeError:
            value = None
        if isinstance(value, float) and value - value != 0.0:
            value = str(value)
        found.append(value)
    return found


def main():
    """Answer until the input ends."""
    out = os.fdopen(os.dup(1), 'w')
    os.dup2(2, 1)  # HAL's library prints where it likes

    def answer(content):
        out.write(json.dumps(content) + '\n')
        out.flush()

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the node says when
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    memory = common.hal_memory()
    if memory is None:
        answer({'error': 'HAL does not run here; start LinuxCNC'})
        return
    sys.path.append(common.MODULES)
    try:
        hal = import_module('hal')
    except ImportError as error:
        answer({'error': f"expected LinuxCNC's Python module hal but: {error}"})
        return
    component = hal.component(f'{common.PREFIX}-values-{os.getpid()}')
    try:
        component.ready()
        for _ in sys.stdin:
            if common.hal_memory() != memory:
                answer({'error': 'HAL has ended, and LinuxCNC with it'})
                return
            answer(values(hal, sys.argv[1:]))
    finally:
        component.exit()


if __name__ == '__main__':
    main()
