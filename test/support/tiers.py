# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Cases of a test of which a few say in the fast tier what all say in the slow one."""

from collections.abc import Iterable
from typing import Any

import pytest


def rest_slow(cases: Iterable[Any], *quick: int) -> list[Any]:
    """Return the cases of a test; all but those at the places of `quick` are slow."""
    found = [
        pytest.param(
            *(case if isinstance(case, tuple) else (case,)),
            marks=[] if place in quick else [pytest.mark.slow],
        )
        for place, case in enumerate(cases)
    ]
    assert sum(not case.marks for case in found) == len(quick)
    return found
