# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""LinuxCNC's own interpreter as the judge of part programs."""

import math
import os
import re
import shutil
import subprocess

import numpy as np
import pytest

from fuzzycnc_ros.core.feedrate.gcode.segments import ArcSegment, DwellSegment


def interpreted(text, folder):
    """Moves that LinuxCNC's own interpreter makes of a program: kind, numbers [m], feed [m/s]."""
    interpreter = shutil.which('rs274')
    if interpreter is None:
        pytest.skip("expected LinuxCNC's rs274 (Debian's linuxcnc-uspace) but it is not installed")
    program, output = folder / 'program.ngc', folder / 'canon.txt'
    program.write_bytes(text.encode('utf-8', errors='surrogateescape'))
    (folder / 'tool.tbl').write_text('T1 P1 Z0\n', encoding='utf-8')
    (folder / 'rs274.var').write_text('', encoding='utf-8')
    subprocess.run(
        [interpreter, '-g', '-t', 'tool.tbl', '-v', 'rs274.var', program.name, output.name],
        cwd=folder,
        # Its tool table lies there; others that run at the same time would overwrite it.
        env={**os.environ, 'HOME': str(folder)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=60,
        check=False,  # a program that ends without M2 or % counts as failed
    )
    unit, feed, moves = 1e-3, 0.0, []
    for line in output.read_text(encoding='utf-8').splitlines():
        name, _, rest = line.split(maxsplit=2)[2].partition('(')
        values = [float(value) for value in re.findall(r'-?\d+\.\d+|-?\d+', rest)]
        if name == 'USE_LENGTH_UNITS':
            unit = 25.4e-3 if 'INCH' in rest else 1e-3
        elif name == 'SET_FEED_RATE':
            feed = values[0] * unit / 60.0
        elif name in ('STRAIGHT_TRAVERSE', 'STRAIGHT_FEED'):
            moves.append(
                (name, [*(value * unit for value in values[:3]), 0.0, 0.0, 0.0], feed, unit)
            )
        elif name == 'ARC_FEED':
            x, y, centre_x, centre_y, turns, z = values[:6]
            numbers = [value * unit for value in (x, y, z, centre_x, centre_y)]
            moves.append((name, [*numbers, turns], feed, unit))
    return moves


def check_against(program, moves):
    """Compare ends, centres, directions and feeds; rs274 prints four decimals of a unit."""
    parts = [part for part in program.segments if not isinstance(part, DwellSegment)]
    assert [name for name, *_ in moves] == [
        'ARC_FEED'
        if isinstance(part, ArcSegment)
        else 'STRAIGHT_TRAVERSE'
        if part.rapid
        else 'STRAIGHT_FEED'
        for part in parts
    ]
    expected = np.array([canonical(part) for part in parts])
    found = np.array([numbers for _, numbers, *_ in moves])
    close = 1.01e-4 * np.array([unit for *_, unit in moves])
    assert (np.abs(found - expected) <= close[:, np.newaxis]).all()
    feed = np.array([0.0 if part.rapid else part.feed for part in parts])
    moving = np.array([not part.rapid for part in parts])
    off = np.abs(np.array([feed for *_, feed, _ in moves]) - feed)
    assert (off <= close / 60.0)[moving].all()


def canonical(part):
    """The numbers of `interpreted` [m]: end, centre, turns."""
    if not isinstance(part, ArcSegment):
        return (*part.end, 0.0, 0.0, 0.0)
    first, second, across = part.axes
    turns = math.ceil(abs(part.sweep) / (2.0 * math.pi) - 1e-9)
    return (
        *(part.end[axis] for axis in (first, second, across)),
        *part.centre,
        math.copysign(turns, part.sweep),
    )
