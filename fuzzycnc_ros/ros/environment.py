# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Environment of the middleware; imports no ROS, so that it can be set before rclpy is."""

import os
from pathlib import Path

DISCOVERY_PROFILE = Path(__file__).with_name('quick_discovery.xml')


RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
CHOSEN = (RANGE, 'ROS_LOCALHOST_ONLY', 'ROS_STATIC_PEERS', 'ROS_DISCOVERY_SERVER')
"""With any of these somebody has said who may find whom."""

DOMAIN_MAX = 232
"""Highest ROS domain that has ports; from 102 on they lie among those that Linux hands out."""


def prepare_environment() -> None:
    """Choose quick discovery, and on this host alone, unless the user has chosen otherwise.

    A graph that moves a machine must not be open to a whole network by accident.

    Raises
    ------
    ValueError
        If `ROS_DOMAIN_ID` is no domain: the middleware would take another one, or say why not in
        its own words.
    """
    domain = os.environ.get('ROS_DOMAIN_ID', '').strip()
    if domain and not (domain.isascii() and domain.isdigit() and int(domain) <= DOMAIN_MAX):
        raise ValueError(
            f'ROS_DOMAIN_ID: expected a whole number from 0 to 101 (at most {DOMAIN_MAX}) but '
            f'found {domain!r}: set one that your shop uses, or unset it for 0'
        )
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(DISCOVERY_PROFILE))
    if not any(os.environ.get(name) for name in CHOSEN):
        os.environ[RANGE] = 'LOCALHOST'


def open_to_network() -> None:
    """Let hosts of the same network find the graph, unless the user has chosen otherwise."""
    if not any(os.environ.get(name) for name in CHOSEN):
        os.environ[RANGE] = 'SUBNET'
