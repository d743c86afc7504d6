# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Who reaches what listens at an address."""

import ipaddress


def is_loopback(address: str) -> bool:
    """Whether only this computer reaches what listens at an address."""
    if address == 'localhost':
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False
