# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What `fuzzycnc_offset` computes in the servo thread, compiled by the plain compiler."""

import ctypes
import functools
import subprocess
import tempfile
from pathlib import Path

HEADER = Path(__file__).parents[3] / 'linuxcnc' / 'fuzzycnc_offset.h'
SOURCE = f"""
#include "{HEADER}"
void aim(fuzzycnc_line *line, const fuzzycnc_limits *limits, double o, double s, double r)
{{ fuzzycnc_aim(line, limits, o, s, r); }}
void drop(fuzzycnc_line *line) {{ fuzzycnc_drop(line); }}
double at(const fuzzycnc_line *line, const fuzzycnc_limits *limits, double place)
{{ return fuzzycnc_at(line, limits, place); }}
double step(fuzzycnc_line *line, const fuzzycnc_limits *limits, int tracks, double x, double t)
{{ return fuzzycnc_step(line, limits, tracks, x, t); }}
"""


class OffsetLimits(ctypes.Structure):
    """Limits of the component."""

    _fields_ = tuple((name, ctypes.c_double) for name in ('size', 'rate', 'slope', 'speed'))


class OffsetLine(ctypes.Structure):
    """State of an axis."""

    _fields_ = (
        *(
            (name, ctypes.c_double)
            for name in ('min', 'max', 'low', 'high', 'to_low', 'to_high', 'position', 'value')
        ),
        ('known', ctypes.c_int),
    )


@functools.cache
def library():
    """Compile it, once a process."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, 'offset.so')
        command = ['cc', '-std=c99', '-O2', '-Wall', '-Wextra', '-Werror', '-ffp-contract=off']
        command += ['-shared', '-fPIC', '-x', 'c', '-', '-o', str(target)]
        subprocess.run(command, input=SOURCE, text=True, check=True)
        found = ctypes.CDLL(str(target))
    found.aim.argtypes = [ctypes.c_void_p, ctypes.c_void_p, *[ctypes.c_double] * 3]
    found.drop.argtypes = [ctypes.c_void_p]
    found.at.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double]
    found.step.argtypes = [
        *(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int),
        *(ctypes.c_double, ctypes.c_double),
    ]
    found.aim.restype = found.drop.restype = None
    found.at.restype = found.step.restype = ctypes.c_double
    return found


class OffsetThread:
    """One axis of the component."""

    def __init__(self, limits, low, high):
        self.limits, self.line = limits, OffsetLine(min=low, max=high)
        self._library = library()
        self._line, self._limits = ctypes.byref(self.line), ctypes.byref(limits)

    def aim(self, offset, slope, reference):
        """Take a set."""
        self._library.aim(self._line, self._limits, offset, slope, reference)

    def drop(self):
        """Have no offset, at once."""
        self._library.drop(self._line)

    def at(self, place):
        """Return the offset of the line in force at a place."""
        return self._library.at(self._line, self._limits, place)

    def step(self, tracks, position, period):
        """Go on by a period."""
        return self._library.step(self._line, self._limits, tracks, position, period)
