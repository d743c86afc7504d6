# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A small embroidery design with everything that a file of it can say."""

from math import cos, pi, sin
from pathlib import Path

import pyembroidery as pe


def embroidery(path: Path) -> Path:
    """Write a design with two colours, a trim, a jump and a fill, and return its file."""
    pattern = pe.EmbPattern()
    pattern.add_thread({'color': 0xAA1122})
    pattern.add_thread({'color': 0x1122AA})
    outline = [(round(200 * cos(k * pi / 20)), round(150 * sin(k * pi / 20))) for k in range(41)]
    fill = [(-90 + 6 * k, 40 * (k % 2)) for k in range(31)]
    line = [(25 * k, 200) for k in range(12)]
    for number, run in enumerate((outline, fill, line)):
        pattern.add_stitch_absolute(pe.JUMP, *run[0])
        for point in run:
            pattern.add_stitch_absolute(pe.STITCH, *point)
        pattern.add_command(pe.TRIM if number != 1 else pe.COLOR_CHANGE)
    pattern.add_command(pe.END)
    pe.write(pattern, str(path))
    return path
