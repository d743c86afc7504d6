# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reach of an address: who can connect to it."""

import ipaddress


def is_loopback(address: str) -> bool:
    """Return True if only this computer reaches what listens at an address."""
    if address == 'localhost':
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False
