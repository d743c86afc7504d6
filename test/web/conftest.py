# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A browser and a server that shows it whatever a test wants, one of each a module."""

from collections.abc import Iterator

import pytest
from fake_dashboard import FakeDashboard, serving
from live_page import LivePage, browser


@pytest.fixture(scope='module')
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LivePage]:
    """The browser of a module."""
    with browser(tmp_path_factory.mktemp('profile')) as page:
        yield page


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
