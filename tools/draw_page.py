#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Take the picture of the live page in docs/figures from a page that runs.

Usage: tools/draw_page.py http://127.0.0.1:8642/ [--browser chromium]

The page in the docs is that of `fuzzycnc up --simulate T2 --rate 60 --model mill.json --autostart
--record shift --page` after some minutes, with a model of `fuzzycnc demo`.  Besides chromium it
needs its driver: `apt-get install chromium chromium-driver`.
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
from pathlib import Path

from PIL import Image
from selenium import webdriver
from selenium.webdriver.support.wait import WebDriverWait

OUT = Path(__file__).resolve().parents[1] / 'docs' / 'figures' / 'live-page.png'
SIZE = {'width': 1280, 'height': 800, 'deviceScaleFactor': 1, 'mobile': False}
PATIENCE = 60.0
"""Time [s] in which the page must show a machine whose offsets are in force."""
COLOURS = 96
"""More are not needed: the page has few, and letters with grey edges."""


def main() -> int:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('url')
    parser.add_argument('--browser', default='chromium')
    parser.add_argument('--driver', default='chromedriver')
    given = parser.parse_args()
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which(given.browser) or given.browser
    for flag in ('--headless', '--no-sandbox', '--disable-gpu', '--disable-dev-shm-usage'):
        options.add_argument(flag)
    service = webdriver.ChromeService(shutil.which(given.driver))
    with webdriver.Chrome(options=options, service=service) as driver:
        driver.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', SIZE)
        driver.get(given.url)
        WebDriverWait(driver, PATIENCE).until(
            lambda page: page.find_elements('css selector', '.state[data-state="active"]')
        )
        taken = driver.get_screenshot_as_png()
    with Image.open(io.BytesIO(taken)) as shown:
        few = shown.convert('RGB').quantize(COLOURS, dither=Image.Dither.NONE)
    few.save(OUT, optimize=True)
    print(f'{OUT.name}: {OUT.stat().st_size / 1000:.0f} kB')
    return 0


if __name__ == '__main__':
    sys.exit(main())
