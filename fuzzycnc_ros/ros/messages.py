# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""rclpy's message classes by type name."""

from functools import cache
from importlib import import_module
from typing import Any

from fuzzycnc_ros.runtime.convert import Target


@cache
def message_class(type_name: str) -> Any:
    """Return the class of `package/kind/Name`."""
    package, kind, name = type_name.split('/')
    return getattr(import_module(f'{package}.{kind}'), name)


RCLPY = Target(message_class, numpy_arrays=False)
"""Builds rclpy's messages."""
