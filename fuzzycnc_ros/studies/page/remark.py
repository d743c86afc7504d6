# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A sentence on a result, for pages and terminals."""

from typing import NamedTuple


class Remark(NamedTuple):
    """A sentence, and whether it warns."""

    text: str
    warning: bool = False
