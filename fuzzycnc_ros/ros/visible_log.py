# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What nodes say on standard error and in their logs, with control characters spelt out.

Topics, devices and other nodes give names and reasons that end there.
"""

import sys
from typing import Any

from rclpy.impl.rcutils_logger import RcutilsLogger, _internal_callers

from fuzzycnc_ros.core.visible import visible


def tell_error(error: object) -> None:
    """Write a line on standard error."""
    print(f'error: {visible(" ".join(str(error).split()))}', file=sys.stderr, flush=True)


def spell_out_logs() -> None:
    """Have all loggers of this process spell control characters out.

    rclpy has no formatter of its own to set, and a logger is made inside every node.
    """
    if RcutilsLogger.log is not _log:
        # It tells callers apart by their place, and leaves the files of this list out.
        _internal_callers.append(__file__)
        RcutilsLogger.log = _log


_plain_log = RcutilsLogger.log


def _log(self: Any, message: Any, severity: Any, **settings: Any) -> Any:
    return _plain_log(self, visible(str(message)), severity, **settings)
