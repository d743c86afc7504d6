#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Take the picture of the live page in docs/figures from a page that runs.

Usage: tools/draw_page.py http://127.0.0.1:8642/ [--browser chromium]

The page in the docs is that of `fuzzycnc up --simulate T2 --rate 60 --model mill.json --autostart
--record shift --page` after a minute and a half, with a model of `fuzzycnc demo`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

OUT = Path(__file__).resolve().parents[1] / 'docs' / 'figures' / 'live-page.png'
SIZE = (1280, 800)
SETTLED = 6000
"""Time that the page gets to show something [ms]."""
COLOURS = 96
"""More are not needed: the page has few, and letters with grey edges."""


def main() -> int:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('url')
    parser.add_argument('--browser', default='chromium')
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        taken = Path(folder) / 'page.png'
        command = [given.browser, '--headless', '--no-sandbox', '--disable-gpu']
        command += [f'--user-data-dir={folder}/profile', f'--timeout={SETTLED}']
        command += [f'--window-size={SIZE[0]},{SIZE[1]}', f'--screenshot={taken}', given.url]
        subprocess.run(command, check=True)
        with Image.open(taken) as shown:
            few = shown.convert('RGB').quantize(COLOURS, dither=Image.Dither.NONE)
        few.save(OUT, optimize=True)
    print(f'{OUT.name}: {OUT.stat().st_size / 1000:.0f} kB')
    return 0


if __name__ == '__main__':
    sys.exit(main())
