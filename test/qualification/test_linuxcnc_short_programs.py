# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""500 random short programs on a real LinuxCNC take and leave what the simulated one says."""

import pytest
from equipment.linuxcnc_machine import exclusive
from equipment.linuxcnc_short import agreement_table, compared, drive, driven
from programs.short_programs import short_program

from fuzzycnc_ros.adapters.linuxcnc import recorder

pytestmark = [pytest.mark.ros, pytest.mark.realtime, pytest.mark.qualify]

SEED, COUNT = 3, 500
SHARE = 0.98
"""Of the programs that have to agree; linuxcnc-feedrate.md names the others [-]."""


def test_random_short_programs_take_and_leave_what_the_model_says():
    with exclusive():
        pass  # skips where there is no LinuxCNC
    with recorder.recording() as recording:
        cuts = drive(recording, SEED, range(COUNT))
        found = {number: driven(short_program(SEED, number), cut) for number, cut in cuts}
    rows = compared(SEED, found)
    assert len(rows) == COUNT
    assert sum(row.agrees for row in rows) >= SHARE * COUNT, agreement_table(rows).to_text()
