# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Command lines run in this process, in an empty folder."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest


@dataclass(frozen=True)
class Outcome:
    """What a command line came to."""

    code: int
    out: str
    err: str


def runner(
    run: Callable[[Sequence[str]], int], capsys: pytest.CaptureFixture[str]
) -> Callable[..., Outcome]:
    """Return what carries out command lines."""

    def command(*arguments) -> Outcome:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return command


def refuser(command: Callable[..., Outcome]) -> Callable[..., str]:
    """Return what carries out command lines that must be refused in one line that names things."""

    def refuse(*arguments, naming) -> str:
        outcome = command(*arguments)
        assert outcome.code == 2, outcome
        # A slow computer also gets lines on the progress.
        lines = [line for line in outcome.err.splitlines() if not line.endswith(' s so far')]
        assert len(lines) == 1, outcome.err
        assert lines[0].startswith('error: ')
        missing = [text for text in naming if text not in lines[0]]
        assert not missing, f'{missing} not in: {lines[0]}'
        return lines[0]

    return refuse


def read_json(name: str) -> Any:
    """Return what a command has written as JSON."""
    return json.loads(Path(name).read_text(encoding='utf-8'))
