# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Environment of the middleware; imports no ROS, so that it can be set before rclpy is."""

import os
from pathlib import Path

DISCOVERY_PROFILE = Path(__file__).with_name('quick_discovery.xml')


RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
CHOSEN = (RANGE, 'ROS_LOCALHOST_ONLY', 'ROS_STATIC_PEERS', 'ROS_DISCOVERY_SERVER')
"""With any of these somebody has said who may find whom."""


def prepare_environment() -> None:
    """Choose quick discovery, and on this host alone, unless the user has chosen otherwise.

    A graph that moves a machine must not be open to a whole network by accident.
    """
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(DISCOVERY_PROFILE))
    if not any(os.environ.get(name) for name in CHOSEN):
        os.environ[RANGE] = 'LOCALHOST'


def open_to_network() -> None:
    """Let hosts of the same network find the graph, unless the user has chosen otherwise."""
    if not any(os.environ.get(name) for name in CHOSEN):
        os.environ[RANGE] = 'SUBNET'
