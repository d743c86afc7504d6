# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Pytest plugin of `tools/mutants.py`: says which test runs now, and how it ended.

Coverage gets one context a test, a shared fixture and a test file, here and, by an environment
variable, in the processes that are started meanwhile.  What happened goes to a file of JSON lines.
"""

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import coverage
import pytest

CONTEXT = 'FUZZYCNC_MUTANTS_CONTEXT'
REPORT = 'FUZZYCNC_MUTANTS_REPORT'
TESTS = 'FUZZYCNC_MUTANTS_TESTS'
MAPPING = 'COVERAGE_PROCESS_START' in os.environ
PACKAGE = 'fuzzycnc_ros'


def note(**content: Any) -> None:
    """Add a line to the report; appending is safe among processes."""
    with open(os.environ[REPORT], 'a', encoding='utf-8') as file:
        file.write(json.dumps(content) + '\n')


@contextmanager
def context(name: str) -> Iterator[None]:
    """Book what runs meanwhile under a name."""
    measured = coverage.Coverage.current() if MAPPING else None
    if measured is None:
        yield
        return
    before = os.environ.get(CONTEXT, '')
    switch(measured, name)
    try:
        yield
    finally:
        switch(measured, before)


def switch(measured: coverage.Coverage, name: str) -> None:
    """Book from now on under a name, also in processes that start."""
    os.environ[CONTEXT] = name
    measured.switch_context(name)


def forget() -> None:
    """Empty the package's caches, so that every test runs all that it depends on."""
    for name, module in list(sys.modules.items()):
        if name.split('.')[0] == PACKAGE:
            for value in list(vars(module).values()):
                if hasattr(value, 'cache_clear') and hasattr(value, '__wrapped__'):
                    value.cache_clear()


def pytest_configure(config: pytest.Config) -> None:
    """Run the tests that a file lists instead of those that the command line names."""
    if TESTS in os.environ:
        config.args = Path(os.environ[TESTS]).read_text(encoding='utf-8').splitlines()


@pytest.hookimpl(hookwrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[None]:
    """Book what a test file runs when it is imported."""
    with context(f'file {collector.nodeid}'):
        yield


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Book what a test runs, and which shared fixtures it uses."""
    if MAPPING:
        forget()
        definitions = getattr(item, '_fixtureinfo', None)
        known = definitions.name2fixturedefs.values() if definitions else ()
        note(test=item.nodeid, fixtures=[fixture_name(d[-1]) for d in known])
    with context(f'test {item.nodeid}'):
        yield


@pytest.hookimpl(hookwrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Iterator[None]:
    """Book what a fixture runs that several tests share."""
    if fixturedef.scope == 'function':
        yield
        return
    with context(f'fixture {fixture_name(fixturedef)}'):
        yield


def fixture_name(definition: Any) -> str:
    """Return a fixture's name with that of the folder or file it belongs to."""
    return f'{definition.baseid}::{definition.argname}'


def pytest_collectreport(report: pytest.CollectReport) -> None:
    """Note a file that cannot be collected."""
    if report.failed:
        note(test=report.nodeid, outcome='failed', duration=0.0)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note a test's outcome; under xdist only the process that gathers them does."""
    if 'PYTEST_XDIST_WORKER' not in os.environ:
        note(test=report.nodeid, outcome=report.outcome, duration=report.duration)


def pytest_sessionfinish() -> None:
    """Save the coverage of a worker, which may not live to do so at its exit."""
    measured = coverage.Coverage.current() if MAPPING else None
    if measured is not None:
        measured.save()
