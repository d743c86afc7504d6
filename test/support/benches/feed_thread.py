# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What `fuzzycnc_feed` computes in the servo thread, compiled by the plain compiler."""

import ctypes
import functools
import subprocess
import tempfile
from pathlib import Path

HEADER = Path(__file__).parents[3] / 'linuxcnc' / 'fuzzycnc_feed_table.h'
SOURCE = f"""
#include "{HEADER}"
fuzzycnc_feed *take(const char *path, double close, double latency, double silence)
{{
    fuzzycnc_feed *feed = calloc(1, sizeof *feed);
    fuzzycnc_feed_point *points;
    unsigned id = 0;
    int count = fuzzycnc_feed_read(path, &points, &id);
    feed->unheard = 1e9;
    fuzzycnc_feed_set(feed, close, latency, silence);
    if (fuzzycnc_feed_take(feed, points, count))
        return feed;
    free(points);
    free(feed);
    return NULL;
}}
double step(fuzzycnc_feed *feed, const fuzzycnc_feed_input *in, double period)
{{ return fuzzycnc_feed_step(feed, in, period); }}
double least(const fuzzycnc_feed *feed) {{ return fuzzycnc_feed_least(feed); }}
int on_path(const fuzzycnc_feed *feed) {{ return fuzzycnc_feed_on_path(feed); }}
int active(const fuzzycnc_feed *feed) {{ return fuzzycnc_feed_active(feed); }}
double share(const fuzzycnc_feed *feed) {{ return fuzzycnc_feed_ahead(feed, 0.0); }}
int part(const fuzzycnc_feed *feed) {{ return feed->part; }}
"""


class FeedInput(ctypes.Structure):
    """What the pins say."""

    _fields_ = (
        *((name, ctypes.c_int) for name in ('arm', 'heartbeat', 'idle', 'line')),
        ('at', ctypes.c_double * 3),
    )


@functools.cache
def library():
    """Compile it, once a process."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, 'feed.so')
        command = ['cc', '-std=c99', '-O2', '-Wall', '-Wextra', '-Werror', '-ffp-contract=off']
        command += ['-shared', '-fPIC', '-x', 'c', '-', '-o', str(target)]
        subprocess.run(command, input=SOURCE, text=True, check=True)
        found = ctypes.CDLL(str(target))
    found.take.argtypes = [ctypes.c_char_p, *[ctypes.c_double] * 3]
    found.take.restype = ctypes.c_void_p
    found.step.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double]
    for name in ('least', 'on_path', 'active', 'share', 'part'):
        getattr(found, name).argtypes = [ctypes.c_void_p]
    found.step.restype = found.least.restype = found.share.restype = ctypes.c_double
    return found


def table_text(points, lines, shares):
    """Return a table of points [mm]."""
    rows = [
        f'{line} {x:.5f} {y:.5f} {z:.5f} {share:.4f}\n'
        for (x, y, z), line, share in zip(points, lines, shares, strict=True)
    ]
    head = f'fuzzycnc-feed 1\nprogram {"0123456789abcdef" * 4}\nwork-offset 0\ntool-length -1\n'
    return f'{head}points {len(rows)}\n{"".join(rows)}'


class FeedThread:
    """The component with a table.

    Parameters
    ----------
    path : Path
        File of the table.

    Raises
    ------
    ValueError
        If it is none.
    """

    PERIOD, SILENCE, CLOSE = 1e-3, 0.5, 0.02

    def __init__(self, path, latency=1e-3):
        self._library = library()
        self._feed = self._library.take(str(path).encode(), self.CLOSE, latency, self.SILENCE)
        if not self._feed:
            raise ValueError(f'{path}: no table')
        self.pins = FeedInput(idle=1)
        self.speaks = True

    def __getattr__(self, name):
        """Return what the component knows."""
        return getattr(self._library, name)(self._feed)

    def step(self, at, line):
        """Go on by a period with a position [mm] and a line; return the share."""
        self.pins.line, self.pins.at[:] = line, at
        if self.speaks:
            self.pins.heartbeat ^= 1
        share = self._library.step(self._feed, ctypes.byref(self.pins), self.PERIOD)
        assert 0.01 <= share <= 1.0
        return share

    def start(self, at):
        """Arm it, and start a program where the tool stands."""
        self.pins.arm = self.pins.idle = 1
        self.step(at, 0)
        self.pins.idle = 0
