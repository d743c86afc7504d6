# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The operator's screen: readable in 80x24, whatever a machine says."""

import numpy as np
import pytest

from fuzzycnc_ros.cli.live.watch import _settle
from fuzzycnc_ros.cli.live.watch_screen import HEIGHT, WIDTH, screen
from fuzzycnc_ros.components.dashboard.machine_view import MachineView
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.records import SECOND, Compensation, CompensationApplied, Temperatures


def offsets(value, at=0):
    common = {'stamp': (1000 + at) * SECOND, 'axis': ('Y',), 'at_limit': np.array([True])}
    told = Compensation(
        epoch=1,
        state=1,
        offset=np.array([value]),
        slope=np.zeros(1),
        reference_position=np.zeros(1),
        slewing=np.zeros(1, bool),
        valid_until=common['stamp'] + 180 * SECOND,
        source=(),
        **common,
    )
    applied = CompensationApplied(epoch=1, status=1, reason='', offset=told.offset, **common)
    return told, applied


@pytest.fixture
def view():
    """A machine with an offset, a bad sensor, and far too much to say."""
    made = MachineView('mill')
    told, applied = offsets(-12.34e-6)
    names = tuple(f't{number}' for number in range(100))
    status = np.zeros(100, np.uint8)
    status[7] = 1
    sample = Temperatures(
        stamp=1000 * SECOND, sensor=names, temperature=np.full(100, 20.0), status=status
    )
    made.take('temperatures', sample, 0.0)
    made.take('compensation', told, 0.0)
    made.take('compensation_applied', applied, 0.0)
    trouble = [
        Health(f'item {n}', Level.ERROR, f'{"bad " * 30}; see \x1b[2J it') for n in range(40)
    ]
    made.take_health('compensator', [Health('state', Level.OK, 'active'), *trouble], 0.0)
    return made


@pytest.mark.parametrize('now', [0.1, 60.0])
def test_it_fits_into_80_columns_and_24_lines(view, now):
    lines = screen(view.document(now), WIDTH, HEIGHT).split('\n')
    assert len(lines) <= HEIGHT
    assert max(line.cell_len for line in lines) <= WIDTH
    assert '\x1b' not in ''.join(line.plain for line in lines)


def test_it_shows_state_offset_share_and_what_is_wrong(view):
    text = screen(view.document(0.1), WIDTH, 200).plain
    assert 'ACTIVE' in text
    assert '-12.34' in text
    assert 'clamp' in text
    assert '99 of 100 good' in text
    assert 't7 no reading' in text
    assert '40 alarms' in text
    assert 'NO DATA' not in text


def test_the_model_is_named_with_its_domain_and_what_it_left(view):
    document = view.document(0.1)
    told = {'name': 'lag_ridge', 'valid': True, 'in_domain': True, 'held_out': {'Y': 1.62e-6}}
    for change, said in (
        ({}, 'model lag_ridge: in domain; left on unseen runs Y 1.6 µm'),
        ({'in_domain': False}, 'model lag_ridge: OUTSIDE its training range; left'),
        ({'valid': False, 'why': 'no speed'}, 'model lag_ridge: no speed; left on unseen runs Y'),
        ({'name': '', 'held_out': {}}, 'model none: in domain'),
    ):
        text = screen({**document, 'model': {**told, **change}}, WIDTH, 200).plain
        (found,) = (line for line in text.splitlines() if line.startswith('model'))
        assert found.startswith(said)
    assert 'model' not in screen({**document, 'model': None}, WIDTH, 200).plain


def test_no_data_cannot_be_missed(view):
    lines = screen(view.document(60.0), WIDTH, HEIGHT).plain.splitlines()
    assert '█ NO DATA █' in lines[1]
    assert 'no data for 60 s' in lines[2]


def test_what_has_no_room_is_counted(view):
    text = screen(view.document(0.1), WIDTH, HEIGHT).plain
    assert 'more: a higher window shows them' in text


def test_a_machine_that_says_nothing_is_shown():
    text = screen(MachineView('mill').document(0.0), WIDTH, HEIGHT).plain
    assert 'no data yet' in text
    assert 'ABSENT' in text


def test_it_tells_when_the_next_probe_is_due_and_why(view):
    document = view.document(0.1)
    assert 'probe due' not in screen(document, WIDTH, 200).plain
    told = {
        'due': True,
        'reason': 'known: Z to 9 µm',
        'due_in': None,
        'age': 60.0,
        'changes': [{'channel': 'Z', 'change': -1.5e-6}],
        'cycle': {
            'due': True,
            'reason': '',
            'outcome': 'a chip',
            'accepted': False,
            'failures': 1,
        },
    }
    text = screen({**document, 'probing': told}, WIDTH, 200).plain
    assert 'probe due: known: Z to 9 µm; the last changed Z -1.5 µm' in text
    assert 'probing cycle: a chip' in text
    text = screen({**document, 'probing': {**told, 'due': False, 'due_in': 5400.0}}, WIDTH, 200)
    assert 'next probe due in about' in text.plain


def test_one_screen_waits_for_a_compensator_that_is_found_late():
    view = MachineView('mill')
    told = Temperatures(
        stamp=SECOND, sensor=('t',), temperature=np.full(1, 20.0), status=np.zeros(1, np.uint8)
    )
    view.take('temperatures', told, 0.0)
    view.take_health('thermal_predictor', [Health('prediction', Level.OK, '', {})], 0.0)
    assert view.complete

    class Graph:
        def __init__(self):
            self.waited = 0

        def pause(self, duration):
            self.waited += 1

        def look(self):
            if self.waited == 3:
                view.take_health('compensator', [Health('state', Level.OK, '', {})], 0.0)

        def read(self):
            pass

    graph = Graph()
    _settle(graph, graph, view)
    assert graph.waited == 3
    assert view.document(0.0)['state']['compensation'] == 'inactive'
