# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The table of signs in conventions.md: from what drifts to what a control is given."""

import re
from pathlib import Path

import pytest
from benches.component_bench import Bench, applied, machine_state, thermal_error

from fuzzycnc_ros.components.thermal.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.core.inputs.offset_input import OffsetInput, OffsetInputConfig
from fuzzycnc_ros.runtime.records import SECOND

PAGE = Path(__file__).parents[3] / 'docs' / 'reference' / 'conventions.md'
DRIFT = 10e-6


def tool_against_workpiece(moving, place, drift):
    """Return where the tool is, relative to the workpiece [m].

    Parameters
    ----------
    moving : str
        What the axis moves: the tool, or the table, which then goes the other way.
    place : float
        Where the control sends the axis [m].
    drift : dict of str to float
        What has drifted towards plus, and by how much [m].
    """
    tool = (place if moving == 'tool' else 0.0) + drift.get('tool', 0.0)
    table = (0.0 if moving == 'tool' else -place) + drift.get('table', 0.0)
    return tool - table


def rows():
    """Return the rows of the table: moving, drifting, and three lengths [m]."""
    section = PAGE.read_text().partition('### Tool or table')[2].partition('\n## ')[0]
    found = re.findall(r'^\| the (\w+) \| the (\w+) \| (.+) \|$', section, re.M)
    return [
        (moving, drifting, *(1e-6 * float(cell.split()[0]) for cell in cells.split(' | ')))
        for moving, drifting, cells in found
    ]


def test_all_four_cases_stand_in_the_table():
    pairs = {row[:2] for row in rows()}
    assert pairs == {(a, b) for a in ('tool', 'table') for b in ('tool', 'table')}
    assert len(rows()) == 4


@pytest.mark.parametrize(('moving', 'drifting', 'error', 'offset', 'given'), rows())
def test_row_takes_the_drift_away(moving, drifting, error, offset, given):
    drift = {drifting: DRIFT}
    nominal = 0.123
    found = tool_against_workpiece(moving, nominal, drift) - nominal
    assert found == pytest.approx(error, abs=1e-15)
    bench = Bench(Compensator(CompensatorConfig(slew_max=1e-3)))
    bench.give('machine_state', machine_state(1.0))
    bench.give('compensation_applied', applied(1.0))
    assert bench.request('activate').success
    for time in (2.0, 3.0, 4.0, 5.0):
        bench.give('machine_state', machine_state(time))
        bench.give('thermal_error', thermal_error(time, (0.0, found)))
    command = bench.records('compensation')[-1]
    sent = dict(zip(command.axis, command.offset, strict=True))['Z']
    assert sent == pytest.approx(offset, abs=1e-12)
    # What a machine adds to the place that it was sent to, by its own guard.
    machine = OffsetInput(('Z',), OffsetInputConfig(slew_max=1e-3))
    machine.advance(5 * SECOND)
    answer = machine.command(
        epoch=1, stamp=5 * SECOND, valid_until=60 * SECOND, axis=('Z',), offset=[sent]
    )
    assert answer.accepted
    entered = float(machine.advance(6 * SECOND)[0])
    assert entered == pytest.approx(given, abs=1e-12)
    assert tool_against_workpiece(moving, nominal + entered, drift) == pytest.approx(nominal)
