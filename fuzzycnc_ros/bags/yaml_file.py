# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""YAML files from anywhere: bounded in size and depth, and without references.

ROS itself reads no references (`&name`, `*name`) in parameter files; with them a file of a
kilobyte can stand for more values than any memory holds.
"""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Any

from fuzzycnc_ros.bags.os_errors import os_sentence

SIZE_MAX = 1_000_000
"""Largest file that is read [bytes]; parameter files of all nodes together take 30,000."""
DEPTH_MAX = 50
"""Deepest nesting that is read."""


def value_errors() -> tuple[type[Exception], ...]:
    """Return what PyYAML raises for a value that its tag does not fit, such as `!!int ''`."""
    import yaml

    return (
        yaml.YAMLError, ValueError, OverflowError, LookupError, AttributeError, TypeError,
    )  # fmt: skip


def compose(path: Path, wanted: str) -> Any:
    """Return the root node of a YAML file, None if it is empty; nodes know their lines.

    Parameters
    ----------
    path : Path
        The file.
    wanted : str
        What it should be, for the message.

    Raises
    ------
    ValueError
        If it is missing, no regular file, too large, no YAML, nested too deep, or has references.
    """
    import yaml

    try:
        status = path.stat()
    except OSError as error:
        raise ValueError(
            f'{path}: expected {wanted} but nothing is there'
            if isinstance(error, FileNotFoundError)
            else os_sentence(error, path)
        ) from error
    if not stat.S_ISREG(status.st_mode) or status.st_size > SIZE_MAX:
        raise ValueError(f'{path}: expected {wanted}, a file of at most {SIZE_MAX} bytes')
    try:
        text = path.read_text(encoding='utf-8')
        depth = 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEPTH_MAX:
                raise ValueError(f'expected at most {DEPTH_MAX} levels')
            if isinstance(event, yaml.AliasEvent):
                place = f'line {event.start_mark.line + 1}: ' if event.start_mark else ''
                raise ValueError(f'{place}expected no references (*{event.anchor})')
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except OSError as error:
        raise ValueError(os_sentence(error, path)) from error
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(f'{path}: expected {wanted} (YAML) but: {error}') from error


def construct(path: Path, node: Any) -> Any:
    """Return the value of a node.

    Raises
    ------
    ValueError
        If it cannot be made; the message names file and line.
    """
    import yaml

    try:
        return None if node is None else yaml.SafeLoader('').construct_document(node)
    except value_errors() as error:
        line = node.start_mark.line + 1
        raise ValueError(f'{path}: line {line}: expected a value but: {error}') from error
