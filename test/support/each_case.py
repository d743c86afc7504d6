# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One test a rule: it tries every case and lists those that break the rule."""

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def for_each(
    cases: Iterable[Any], label: Callable[[Any], str] = str
) -> Callable[[Callable[..., None]], Callable[[], None]]:
    """Turn the check of one case into a test of all of them.

    Thousands of small cases cost more as tests of their own than their checks take.

    Parameters
    ----------
    cases
        Arguments of the check: one each, or a tuple of several.
    label
        Names a case where it fails.
    """
    found = list(cases)

    def decorate(check: Callable[..., None]) -> Callable[[], None]:
        def test() -> None:
            assert found, 'expected cases but found none'
            broken = []
            for case in found:
                try:
                    check(*case) if isinstance(case, tuple) else check(case)
                except (Exception, pytest.fail.Exception) as error:
                    broken.append(f'{label(case)}: {type(error).__name__}: {error}')
            assert not broken, f'{len(broken)} of {len(found)}:\n' + '\n'.join(broken)

        test.__name__ = check.__name__
        test.__qualname__ = check.__qualname__
        test.__module__ = check.__module__
        test.__doc__ = check.__doc__
        return test

    return decorate
