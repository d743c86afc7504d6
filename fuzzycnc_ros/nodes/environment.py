# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Environment of the middleware; imports no ROS, so that it can be set before rclpy is."""

import os
from pathlib import Path

DISCOVERY_PROFILE = Path(__file__).with_name('quick_discovery.xml')


def prepare_environment() -> None:
    """Choose quick discovery on this host unless the user has chosen otherwise."""
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(DISCOVERY_PROFILE))


def limit_to_this_host() -> None:
    """Keep discovery on this host unless the user has opened it."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
