# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Names that stand in a list more than once."""

from collections import Counter
from collections.abc import Iterable


def repeated_names(names: Iterable[str]) -> list[str]:
    """Return the names that come more than once, sorted; a list of thousands takes no time.

    Examples
    --------
    >>> repeated_names(['T2', 'T1', 'T3', 'T1', 'T2'])
    ['T1', 'T2']
    """
    return sorted(name for name, count in Counter(names).items() if count > 1)
