# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers that a controller computes with, by name, for a form of it in another language."""

from __future__ import annotations

from typing import NamedTuple


class Constant(NamedTuple):
    """Number of a controller; a whole one counts, or says yes or no.

    Attributes
    ----------
    name : str
        Name in capitals.
    value : float or int
        The number in SI.
    unit : str
        Its unit; empty for whole numbers.
    meaning : str
        Meaning in a few words.
    """

    name: str
    value: float | int
    unit: str
    meaning: str
