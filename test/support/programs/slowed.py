# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feeds that are slower than a program's own."""

import math

import numpy as np


def slowed(program, seed):
    """Random feeds from a tenth of the program's own on; NaN for what keeps its own."""
    share = np.random.default_rng(seed).uniform(0.1, 1.0, len(program.segments)).tolist()
    return [
        part * segment.feed if segment.schedulable else math.nan
        for part, segment in zip(share, program.segments, strict=True)
    ]
