# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Names of machines: namespaces of their nodes, checked before anything is started."""

import re

LENGTH_MAX = 100
"""Longest name [characters]: ROS takes 247 for a whole topic, and some of ours take 60."""
_NAME = re.compile(r'(?!\d)\w+(/(?!\d)\w+)*', re.ASCII)


def machine_name(text: str, option: str = '--machine') -> str:
    """Return the name of a machine without slashes at its ends.

    Raises
    ------
    ValueError
        If it can be no namespace.
    """
    name = text.strip('/')
    if not _NAME.fullmatch(name) or '__' in name or len(name) > LENGTH_MAX:
        shown = repr(text) if len(text) <= LENGTH_MAX else f'one of {len(text)} characters'
        raise ValueError(
            f'{option}: expected a name such as mill_1, of letters, digits and single _, no part '
            f'beginning with a digit, at most {LENGTH_MAX} characters, but found {shown}'
        )
    return name
