# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted models as they run: one class per form, no estimator and no training data."""

from fuzzycnc_ros.core.thermal.recursions.base import (
    Recursion,
    Stream,
    check_interval,
    check_shapes,
    run_slices,
)
from fuzzycnc_ros.core.thermal.recursions.grey import GreyRecursion, development_of, pole_of
from fuzzycnc_ros.core.thermal.recursions.linear import LinearRecursion, first_order_lags
from fuzzycnc_ros.core.thermal.recursions.parallel import (
    ParallelRecursion,
    combine,
    read_recursion,
    write_recursion,
)

FORMS: tuple[type[Recursion], ...] = (LinearRecursion, GreyRecursion, ParallelRecursion)
"""All forms that a model file may hold."""

__all__ = [
    'FORMS',
    'GreyRecursion',
    'LinearRecursion',
    'ParallelRecursion',
    'Recursion',
    'Stream',
    'check_interval',
    'check_shapes',
    'combine',
    'development_of',
    'first_order_lags',
    'pole_of',
    'read_recursion',
    'run_slices',
    'write_recursion',
]
