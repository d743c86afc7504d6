# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The live page, and a server of a module that shows it whatever a test wants."""

from collections.abc import Iterator
from typing import Any

import pytest
from fake_dashboard import FakeDashboard, serving
from live_page import LivePage


@pytest.fixture
def opened(browser: Any) -> Iterator[LivePage]:
    """The live page in the browser of all tests; it is closed in the end."""
    page = LivePage(browser)
    yield page
    browser.get('about:blank')  # what is left open goes on asking its server
    page.complaints()


@pytest.fixture(scope='module')
def server() -> Iterator[FakeDashboard]:
    """The server of a module."""
    with serving() as fake:
        yield fake


@pytest.fixture
def fake(server: FakeDashboard) -> FakeDashboard:
    """The server, showing a machine that is well."""
    server.reset()
    return server


@pytest.fixture
def page(opened: LivePage, fake: FakeDashboard) -> LivePage:
    """The page of an operator, as somebody opens it for the first time."""
    opened.driver.get(f'{fake.url}static/icon.svg')  # scripts of the page do not run here
    opened.run('localStorage.clear(); sessionStorage.clear();')
    opened.look(1920, 1080, 'light')
    opened.open(fake.url)
    opened.complaints()
    return opened
