# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures for all tests."""

import gc
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import command_lines
import hypothesis
import processes
import pytest
import real_time

# The same examples in every run, however long one takes on a busy machine;
# HYPOTHESIS_PROFILE=explore looks for new ones.
hypothesis.settings.register_profile('seeded', derandomize=True, deadline=None)
hypothesis.settings.register_profile('explore', derandomize=False, deadline=None)
hypothesis.settings.load_profile(os.environ.get('HYPOTHESIS_PROFILE', 'seeded'))

ROOT = Path(__file__).parents[1]
collect_ignore = ['support']

# What a test, the fixtures of a module or those of all have started ends with them.
nobody_left_by_a_test = pytest.fixture(autouse=True)(processes.nobody_left)
nobody_left_by_a_module = pytest.fixture(autouse=True, scope='module')(processes.nobody_left)
nobody_left_by_all = pytest.fixture(autouse=True, scope='session')(processes.nobody_left)


@pytest.fixture(scope='session')
def root() -> Path:
    """Top of the source tree."""
    return ROOT


@pytest.fixture(scope='session')
def data() -> Path:
    """Folder of the real recordings, which are not part of the repository."""
    folder = Path(os.environ.get('FUZZYCNC_DATA') or ROOT.parent / 'shared' / 'data')
    if not folder.is_dir():
        pytest.skip(
            'expected the folder of real recordings beside the repository as shared/data, '
            'or where FUZZYCNC_DATA says, but found none'
        )
    return folder


@pytest.fixture(scope='session')
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """The driver of a browser that all tests share: to start one takes seconds."""
    from chromium import chromium

    with chromium(tmp_path_factory.mktemp('profile')) as driver:
        yield driver


@pytest.fixture
def fuzzycnc(capsys, tmp_path, monkeypatch):
    """Run a command line in an empty folder."""
    from fuzzycnc_ros.cli.main import run

    monkeypatch.chdir(tmp_path)
    return command_lines.runner(run, capsys)


@pytest.fixture
def refused(fuzzycnc):
    """Run a command line that must be refused in one line that names certain things."""
    return command_lines.refuser(fuzzycnc)


@pytest.fixture
def domain() -> Iterator[int]:
    """A ROS domain of this test alone."""
    pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')
    from live_graph import free_domain

    with free_domain() as number:
        yield number


@pytest.fixture
def make_node(domain: int) -> Iterator[Any]:
    """Make nodes of the machine `mill` in this process, with parameters as arguments."""
    import rclpy
    from rclpy.parameter import Parameter

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    made = []

    def begin(name: str, **parameters: Any) -> Any:
        given = [Parameter(key, value=value) for key, value in parameters.items()]
        made.append(
            rclpy.create_node(name, namespace='/mill', context=context, parameter_overrides=given)
        )
        return made[-1]

    yield begin
    for node in made:
        node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.hookimpl(hookwrapper=True)
def pytest_collection() -> Iterator[None]:
    """Spare the collector of garbage what lives to the end: all modules and tests.

    Frozen it must not be: hypothesis 6.98 then takes its own examples for unreliable.
    """
    gc.disable()
    yield
    gc.enable()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file without a mark that all wanted tests have."""
    wanted = [word for word in config.option.markexpr.split(' and ') if word.isidentifier()]
    if collection_path.suffix != '.py' or not wanted:
        return None
    text = collection_path.read_text(encoding='utf-8')
    return any(word not in text for word in wanted) or None


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Judge what runs in real time only where time is kept."""
    real_time.before(item)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Measure anew where such a test fails."""
    outcome = yield
    real_time.after(item, outcome.get_result())
