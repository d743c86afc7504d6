#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Draw the mermaid diagrams of the pages as SVG files, so that the site needs no script for them.

Usage: tools/draw_diagrams.py path/to/mermaid.min.js [--browser chromium]

`docs/figures/diagrams/<hash>.svg` is the picture of the diagram whose text has that hash; `make
docs` refuses a diagram without one.  Only new diagrams are drawn, and pictures without a diagram
are removed.  The script is the one in the npm package `mermaid`; the browser runs without a
window and without a network.
"""

from __future__ import annotations

import argparse
import hashlib
import html
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / 'docs' / 'figures' / 'diagrams'
FENCE = re.compile(r'^```mermaid\n(.*?)^```', re.M | re.S)
PAGE = """<!doctype html><meta charset="utf-8"><body><div id="drawn"></div>
<script src="mermaid.js"></script><script>
mermaid.initialize({startOnLoad: false, theme: 'neutral', htmlLabels: false,
                    flowchart: {htmlLabels: false}, fontFamily: 'sans-serif'});
mermaid.render('diagram', TEXT).then(({svg}) => {
  const xml = new XMLSerializer().serializeToString(
    new DOMParser().parseFromString(svg, 'image/svg+xml').documentElement);
  const held = document.createElement('pre');
  held.id = 'svg'; held.textContent = xml; document.body.replaceChildren(held);
});
</script>"""


def picture(text: str) -> Path:
    """Return where the picture of a diagram lies."""
    return PICTURES / f'{hashlib.sha256(text.strip().encode()).hexdigest()[:16]}.svg'


def draw(text: str, script: Path, browser: str) -> str:
    """Return a diagram as SVG."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / 'mermaid.js').write_bytes(script.read_bytes())
        page = Path(folder) / 'page.html'
        page.write_text(PAGE.replace('TEXT', repr(text)), encoding='utf-8')
        command = [browser, '--headless', '--no-sandbox', '--disable-gpu', '--dump-dom']
        command += ['--virtual-time-budget=20000', str(page)]
        found = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    drawn = re.search(r'<pre id="svg">(.*?)</pre>', found, re.S)
    if drawn is None:
        raise SystemExit(f'diagram: expected mermaid to draw it but found no picture:\n{text}')
    shown = html.unescape(drawn[1])
    width, height = re.search(r'viewBox="\S+ \S+ (\S+) (\S+)"', shown).groups()  # type: ignore[union-attr]
    size = f'width="{float(width):.0f}" height="{float(height):.0f}"'
    return shown.replace('width="100%"', size, 1) + '\n'


def main() -> int:
    """Draw what is new, remove what is left over."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('script', type=Path, help='mermaid.min.js')
    parser.add_argument('--browser', default='chromium')
    given = parser.parse_args()
    pages = sorted((ROOT / 'docs').rglob('*.md'))
    texts = [text for page in pages for text in FENCE.findall(page.read_text(encoding='utf-8'))]
    PICTURES.mkdir(parents=True, exist_ok=True)
    for text in texts:
        if not picture(text).exists():
            picture(text).write_text(draw(text, given.script, given.browser), encoding='utf-8')
            print(picture(text).relative_to(ROOT))
    for path in set(PICTURES.glob('*.svg')) - {picture(text) for text in texts}:
        path.unlink()
    return 0


if __name__ == '__main__':
    sys.exit(main())
