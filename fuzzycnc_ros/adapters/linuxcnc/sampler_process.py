# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reads what HAL's sampler keeps, to the last bit: `halsampler` prints six decimals.

Runs under the Python that LinuxCNC's modules are built for, with the types of the samples (f, b)
as argument, and writes rows of doubles, the number of the sample first, until its input ends.
"""

import os
import struct
import sys
import threading
import time
from importlib import import_module

sys.path.append('/usr/lib/python3/dist-packages')
hal = import_module('hal')


def main():
    """Write rows until standard input ends, and then what is left."""
    types = sys.argv[1]
    component = hal.component(f'fuzzycnc-samples-{os.getpid()}')
    stream = hal.stream(component, hal.sampler_base, types)
    component.ready()
    ended = threading.Event()

    def wait():
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait, daemon=True).start()
    row = struct.Struct(f'{len(types) + 1}d')
    while True:
        last = ended.is_set()
        while (sample := stream.read()) is not None:
            sys.stdout.buffer.write(row.pack(stream.sampleno, *sample))
        sys.stdout.buffer.flush()
        if last:
            break
        time.sleep(0.01)
    del stream  # else its memory would outlive LinuxCNC
    component.exit()


if __name__ == '__main__':
    main()
