# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the helper of feed shares compares, and when it arms the component."""

import hashlib
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from fuzzycnc_ros.adapters.linuxcnc.feed_process import FEED, HalError, Helper, Judge
from fuzzycnc_ros.studies.programs import adaptive_feed

PROGRAM = b'G21\nM52 P1\nG64 P0.002 Q0.002\nG1 X1 F60\nM52 P0\nM2\n'
HASH = hashlib.sha256(PROGRAM).hexdigest()
ID = int(HASH[:8], 16)
IDLE, RUNNING = 1, 2


@pytest.fixture
def state(tmp_path):
    """A LinuxCNC that has the program loaded."""
    file = tmp_path / 'part.ngc'
    file.write_bytes(PROGRAM)
    tool = SimpleNamespace(id=3, xoffset=0.0, yoffset=0.0, zoffset=12.5)
    return SimpleNamespace(
        file=str(file), rotation_xy=0.0, gcodes=(10, 400, 540), g5x_index=1,
        g5x_offset=(5.0, 0.0, 1.0), g92_offset=(0.0, 2.0, 0.0), tool_offset=(0.0, 0.0, 12.5),
        tool_in_spindle=3, tool_table=(tool,), interp_state=IDLE, poll=lambda: None,
    )  # fmt: skip


def test_the_same_program_and_coordinates_are_accepted(state):
    assert Judge(HASH, 540, 3).doubt(state, ID) == ''
    assert Judge(HASH, 0, adaptive_feed.NO_LENGTH).doubt(state, ID) == ''
    assert Judge(HASH, 540, adaptive_feed.LENGTH_OF_TOOL).doubt(state, ID) == ''


@pytest.mark.parametrize(
    ('change', 'told'),
    [
        ({'file': ''}, 'no program is loaded'),
        ({'file': '/none.ngc'}, '/none.ngc is loaded: expected'),
        ({'rotation_xy': 3.0}, 'rotation: expected none but found 3 degrees'),
        ({'gcodes': (10, 410)}, 'cutter compensation: expected none'),
        ({'g5x_index': 7}, 'work offset: expected G54 but found G59.1'),
        ({'tool_offset': (0.0, 0.0, 12.4)}, 'tool length: expected that of tool 3 in force'),
        ({'tool_table': ()}, 'but the tool table has none'),
    ],
)
def test_what_shifts_the_path_is_refused(state, change, told):
    vars(state).update(change)
    doubt = Judge(HASH, 540, 3).doubt(state, ID)
    assert told in doubt
    assert '\n' not in doubt


def test_changed_program_and_other_table_are_refused(state):
    judge = Judge(HASH, 0, 0)
    assert 'has another table' in judge.doubt(state, ID + 1)
    with open(state.file, 'ab') as file:
        file.write(b'(changed)\n')
    assert 'expected the program of the table' in judge.doubt(state, ID)


@pytest.fixture
def rig(state):
    """A helper on a HAL that is none; its pins by name."""
    hal, pins = MagicMock(), {}
    values = {f'{FEED}.table-id': ID, f'{FEED}.active': True}
    hal.error = RuntimeError
    hal.component.return_value.newpin = lambda name, *_: pins.setdefault(
        name, SimpleNamespace(value=0)
    )
    hal.get_info_signals.return_value = [
        {'NAME': f'{FEED}-{name}', 'DRIVER': None}
        for name in ('arm', 'heartbeat', 'offset-x', 'offset-y', 'offset-z')
    ]
    hal.get_value.side_effect = lambda name: values.get(name, 0)
    linuxcnc = SimpleNamespace(stat=lambda: state, INTERP_IDLE=IDLE)
    judge = Judge(HASH, 540, 3)
    return SimpleNamespace(hal=hal, linuxcnc=linuxcnc, pins=pins, judge=judge, values=values)


def test_helper_arms_with_the_offsets_in_force_and_beats(rig, state):
    helper = Helper(rig.hal, rig.linuxcnc, rig.judge)
    assert [helper.look(), helper.look()] == ['armed', '']
    assert [rig.pins[f'offset-{axis}'].value for axis in 'xyz'] == [5.0, 2.0, 13.5]
    beats = []
    for _ in range(4):
        helper.look()
        beats.append(bool(rig.pins['heartbeat'].value))
    assert beats in ([True, False] * 2, [False, True] * 2)
    rig.values[f'{FEED}.lost'] = True
    assert helper.look().startswith('lost: the least share')
    rig.values.update({f'{FEED}.lost': False, f'{FEED}.active': False})
    assert helper.look() == 'to be armed when no program runs'
    helper.close()
    assert not rig.pins['arm'].value


def test_coordinates_that_change_while_the_program_runs_disarm(rig, state):
    helper = Helper(rig.hal, rig.linuxcnc, rig.judge)
    helper.look()
    state.interp_state, state.g92_offset = RUNNING, (0.0, 2.1, 0.0)
    assert helper.look() == 'refused: the coordinates have changed while the program runs'
    assert not rig.pins['arm'].value
    assert rig.pins['offset-y'].value == 2.0
    state.interp_state = IDLE
    assert helper.look() == 'armed'


def test_signals_of_another_helper_are_left_to_it(rig):
    rig.hal.get_info_signals.return_value[0]['DRIVER'] = 'other.arm'
    with pytest.raises(HalError, match='expected no writer but found other'):
        Helper(rig.hal, rig.linuxcnc, rig.judge)
    rig.hal.get_info_signals.return_value.clear()
    with pytest.raises(HalError, match=r'load fuzzycnc_feed\.hal'):
        Helper(rig.hal, rig.linuxcnc, rig.judge)
