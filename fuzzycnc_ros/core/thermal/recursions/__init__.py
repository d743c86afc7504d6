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
from fuzzycnc_ros.core.thermal.recursions.composed import (
    BOUND_FACTOR,
    BoundedRecursion,
    ParallelRecursion,
    SeriesRecursion,
    bound_of,
    combine,
    leading,
    read_recursion,
    write_recursion,
)
from fuzzycnc_ros.core.thermal.recursions.filters import (
    FilterNetworkRecursion,
    MovingAverageRecursion,
)
from fuzzycnc_ros.core.thermal.recursions.grey import (
    DifferencedGreyRecursion,
    GreyRecursion,
    development_of,
    pole_of,
)
from fuzzycnc_ros.core.thermal.recursions.kernel import KernelRecursion, LayersRecursion
from fuzzycnc_ros.core.thermal.recursions.linear import LinearRecursion, first_order_lags
from fuzzycnc_ros.core.thermal.recursions.rules import CorrectedRecursion, RulesRecursion

FORMS: tuple[type[Recursion], ...] = (
    LinearRecursion,
    GreyRecursion,
    DifferencedGreyRecursion,
    SeriesRecursion,
    CorrectedRecursion,
    RulesRecursion,
    KernelRecursion,
    LayersRecursion,
    FilterNetworkRecursion,
    MovingAverageRecursion,
    BoundedRecursion,
    ParallelRecursion,
)
"""All forms that a model file may hold."""

__all__ = [
    'BOUND_FACTOR',
    'FORMS',
    'BoundedRecursion',
    'CorrectedRecursion',
    'DifferencedGreyRecursion',
    'FilterNetworkRecursion',
    'GreyRecursion',
    'KernelRecursion',
    'LayersRecursion',
    'LinearRecursion',
    'MovingAverageRecursion',
    'ParallelRecursion',
    'Recursion',
    'RulesRecursion',
    'SeriesRecursion',
    'Stream',
    'bound_of',
    'check_interval',
    'check_shapes',
    'combine',
    'development_of',
    'first_order_lags',
    'leading',
    'pole_of',
    'read_recursion',
    'run_slices',
    'write_recursion',
]
