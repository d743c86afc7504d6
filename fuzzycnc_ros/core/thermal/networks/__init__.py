# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The hybrid filter network of method sheet 003 and what it is compared with."""

from fuzzycnc_ros.core.thermal.networks.hybrid import HybridFilterNetwork
from fuzzycnc_ros.core.thermal.networks.rivals import (
    Arma,
    DynamicNetwork,
    LinearNetwork,
    StaticNetwork,
)

__all__ = ['Arma', 'DynamicNetwork', 'HybridFilterNetwork', 'LinearNetwork', 'StaticNetwork']
