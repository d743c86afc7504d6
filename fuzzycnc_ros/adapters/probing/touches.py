# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Touches of a probing cycle from what its program tells: a code and a number."""

import numpy as np

from fuzzycnc_ros.adapters.probing.programs import BEGIN, END
from fuzzycnc_ros.runtime.enums import TouchKind
from fuzzycnc_ros.runtime.records import ProbeTouch, Stamp

MM = 1e-3


def touch_of(
    stamp: Stamp, frame_id: str, code: float, value: float, *, includes_offset: bool
) -> ProbeTouch | None:
    """Return the touch that a program tells; None for what none tells.

    Parameters
    ----------
    stamp : int
        When it was told [ns].
    frame_id : str
        Frame of the machine.
    code, value : float
        Its code, and the number beside it: a signature, or a coordinate [mm].
    includes_offset : bool
        Whether coordinates contain the offset in force.
    """
    if not (np.isfinite(code) and np.isfinite(value) and 0.0 < abs(code) <= END):
        return None
    kind, number, position = TouchKind.TOUCH, round(abs(code)), np.nan
    if code == BEGIN:
        kind, number = TouchKind.BEGIN, max(round(value), 0)
    elif code == END:
        kind, number = TouchKind.END, 0
    elif code < 0.0:
        kind = TouchKind.MISS
    else:
        position = MM * value
    return ProbeTouch(
        stamp=stamp,
        frame_id=frame_id,
        kind=int(kind),
        number=number,
        position=position,
        includes_offset=includes_offset,
    )
