# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Layout of the numbers in `PredictorState.state`.

First the recursion of the model, then the newest value of each driver beyond the sensors; how
many of both follows from the model.  Then come blocks, in any number and order: code, length n,
n numbers.  A predictor without probing that is not fading writes none.  Blocks of an unknown code
are passed over, so that a newer version's checkpoint can be read.

| code | block | numbers |
|---|---|---|
| 1 | `correction` | time left [s], offsets [m] and gains [-] in force, the same as wanted |
| 2 | `drift` | sums to the high and low side, probes in them, alarms, each per channel |
| 3 | `offset` | per channel: offset, gain, covariance (3), probed, doubted, its size |
| 4 | `kalman` | the same |
| 5 | `adaptation` | the same |
| 6 | `remainder` | time left [s], what is left of the model before per channel [m], zeros |
| 7 | `watch` | per input: excess to both sides [s], time of agreement [s], faulty |
"""

from collections.abc import Mapping

import numpy as np

from fuzzycnc_ros.runtime.records import Floats

BLOCKS = {
    'correction': 1,
    'drift': 2,
    'offset': 3,
    'kalman': 4,
    'adaptation': 5,
    'remainder': 6,
    'watch': 7,
}
"""Codes of the blocks."""


def write_blocks(recursion: Floats, blocks: Mapping[str, Floats]) -> Floats:
    """Return all numbers of a checkpoint as one flat array."""
    parts = [recursion]
    for name, values in blocks.items():
        parts += [np.array([BLOCKS[name], len(values)], dtype=np.float64), values]
    return np.concatenate(parts)


def read_blocks(state: Floats, size: int) -> tuple[Floats, dict[str, Floats]]:
    """Return the first `size` numbers of a checkpoint and its blocks by name.

    Raises
    ------
    ValueError
        If the array ends within a part of it, or holds a length that is none.
    """
    if len(state) < size:
        raise ValueError(f'state: expected {size} numbers or more, but found {len(state)}')
    names = {code: name for name, code in BLOCKS.items()}
    blocks = {}
    at = size
    while at < len(state):
        head = state[at : at + 2]
        length = int(head[1]) if len(head) == 2 and np.isfinite(head).all() else -1
        if length < 0 or at + 2 + length > len(state):
            raise ValueError(f'state: expected a whole block at {at}, but found {state[at:]}')
        name = names.get(int(head[0]))
        if name is not None:
            blocks[name] = state[at + 2 : at + 2 + length]
        at += 2 + length
    return state[:size], blocks
