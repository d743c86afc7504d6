# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What fails of a part of the tests is run once more, alone, unless it is much."""

import json
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

SPEC = spec_from_file_location('run_tests', Path(__file__).parents[2] / 'tools' / 'run_tests.py')
run_tests = module_from_spec(SPEC)
SPEC.loader.exec_module(run_tests)


@pytest.fixture
def part(tmp_path, monkeypatch):
    """Run a part whose runs fail as told, one list of tests after the other."""
    noted, asked = [], []
    monkeypatch.setattr(run_tests, 'LAST_FAILED', tmp_path / 'lastfailed')
    monkeypatch.setattr(run_tests, 'note', lambda name, outcome, seconds: noted.append(outcome))

    def run(*failures):
        left = list(failures)

        def fake(arguments):
            asked.append(arguments)
            failed = left.pop(0)
            if failed:
                run_tests.LAST_FAILED.write_text(json.dumps(dict.fromkeys(failed, True)))
            return run_tests.FAILED if failed else run_tests.PASSED

        monkeypatch.setattr(run_tests, 'pytest', fake)
        return run_tests.run('fast', ['-n', '3']), noted, asked

    return run


@pytest.mark.parametrize(
    ('failures', 'code', 'outcome', 'asked'),
    [
        ([[]], 0, 'passed', [['-n', '3']]),
        ([['a', 'b'], []], 0, 'unsteady', [['-n', '3'], ['a', 'b']]),
        ([['a', 'b'], ['a']], 1, 'failed', [['-n', '3'], ['a', 'b']]),
        ([[*'abcdef']], 1, 'failed', [['-n', '3']]),
    ],
)
def test_what_fails_is_run_once_more_alone(part, capsys, failures, code, outcome, asked):
    assert part(*failures) == (code, [outcome], asked)
    assert ('unsteady, to be mended: a, b' in capsys.readouterr().out) == (outcome == 'unsteady')


def test_failures_of_the_run_before_are_none_of_this_one(part):
    run_tests.LAST_FAILED.write_text('{"old": true}')
    assert part([]) == (0, ['passed'], [['-n', '3']])
