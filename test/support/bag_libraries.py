# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of components that also write a bag: without the bag libraries they have nothing to do."""

import pytest


def need_bag_libraries() -> None:
    """Skip the test where the extra `bags` is not installed, as on the floor."""
    for name in ('mcap', 'zstandard', 'rosbags', 'yaml'):
        pytest.importorskip(name, reason=f"{name} is missing: pip install 'fuzzycnc_ros[bags]'")
