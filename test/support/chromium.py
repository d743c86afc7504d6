# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A browser that looks at pages, as Debian packages it: chromium and chromium-driver."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from processes import KEPT, command_line, wait_for

BROWSER, DRIVER = 'chromium', 'chromedriver'
FLAGS = (
    '--headless',
    '--no-sandbox',
    '--disable-gpu',
    '--disable-quic',
    '--no-first-run',
    '--disable-background-networking',
    '--disable-component-update',
    '--disable-sync',
    '--disable-dev-shm-usage',
)


@contextmanager
def chromium(profile: Path) -> Iterator[Any]:
    """Yield the driver of a browser with an empty profile; it has ended in the end."""
    paths = [shutil.which(BROWSER), shutil.which(DRIVER)]
    if not all(paths):
        pytest.skip(
            f'expected {BROWSER} and {DRIVER} in PATH but found {paths}: '
            'apt-get install chromium chromium-driver'
        )
    webdriver = pytest.importorskip('selenium.webdriver')

    options = webdriver.ChromeOptions()
    options.binary_location = paths[0]
    for flag in (*FLAGS, f'--user-data-dir={profile}'):
        options.add_argument(flag)
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    # Its processes come and go while tests run: they are looked after here, not by each test.
    environment = os.environ | dict([KEPT.split('=')])
    service = webdriver.ChromeService(paths[1], env=environment)
    driver = webdriver.Chrome(options=options, service=service)
    try:
        yield driver
    finally:
        driver.quit()
        wait_for(lambda: not _using(profile), 'the end of the browser')


def _using(profile: Path) -> list[int]:
    pids = [int(name) for name in os.listdir('/proc') if name.isdigit()]
    return [pid for pid in pids if f'--user-data-dir={profile}' in command_line(pid)]
