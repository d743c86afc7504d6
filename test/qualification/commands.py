# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Qualification as a command: `python test/qualification faults|soak ...`, or `make faults`."""

from campaign.command import faults
from soak.command import soak

from fuzzycnc_ros.cli.application import Application

HELP = """Show that live graphs stay safe and that nothing in them grows.

    make faults ARGS='--only kill_compensator --out killed'
    make soak ARGS='--hours 1000 --repeat 2'
"""

APPLICATION = Application(
    'qualification', HELP, {'faults': faults, 'soak': soak}, watching=('faults', 'soak')
)
