# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of the nodes that play and record bags: patterns and the bag."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.bags.shipping import file_system
from fuzzycnc_ros.ros.node_config import RecorderConfig
from fuzzycnc_ros.ros.parameters import ParameterError


class Closing(Protocol):
    """Object that can be closed."""

    def close(self) -> object:
        """Close it."""


def pattern(name: str, text: str) -> re.Pattern[str]:
    """Return the regular expression that a parameter holds.

    Raises
    ------
    ParameterError
        If it is none.
    """
    try:
        return re.compile(text)
    except re.error as error:
        raise ParameterError(
            f'parameter {name}: {text!r} is no regular expression: {error}'
        ) from error


@contextmanager
def bag_refused() -> Iterator[None]:
    """Refuse a bag that cannot be used as a wrong parameter: the node does not start."""
    try:
        yield
    except BagError as error:
        raise ParameterError(str(error)) from error


def check_keeping(config: RecorderConfig) -> None:
    """Refuse what a recorder cannot do with the parts of its bag, before there is one.

    Raises
    ------
    ParameterError
        If there is a budget but nothing splits the bag, or nothing can be shipped to `ship`.
    """
    if config.budget and not (config.split_size or config.split_duration):
        raise ParameterError(
            'parameter budget: expected split_size or split_duration, too: only parts that are '
            'closed can be deleted'
        )
    if config.ship:
        with bag_refused():
            file_system(config.ship)


@contextmanager
def closed_on_failure(bag: Closing) -> Iterator[None]:
    """Close a bag if what is built around it fails; a signal must not leave it torn either."""
    try:
        yield
    except BaseException:
        bag.close()
        raise
