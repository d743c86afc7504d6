# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page shows what the view says: every number, with its unit, within one update."""

import random
from itertools import count

import pytest
from fake_dashboard import STAMP, alarm, axis, busy_view, view
from live_page import GAP, micro, model_fields, node_rows, number, offset_rows, operator_fields

_numbers = count(1)


def shown(page, fake, document):
    """Show a view; return what is seen the first time that this view, or a later one, counts."""
    first = 1000 * next(_numbers)
    document['sequence'] = first
    fake.show(document)
    pictures = []

    def arrived():
        pictures.append(page.seen())
        return (pictures[-1]['sequence'] or 0) > first

    page.until(arrived, f'view {first}')
    return pictures[-1]


def random_view(seed):
    """Return a view of random numbers, some of them unknown."""
    draw = random.Random(seed)

    def some(low, high):
        return draw.choice([None, 0.0]) if draw.random() < 0.15 else draw.uniform(low, high)

    axes = [
        axis(
            name,
            offset=some(-2e-4, 2e-4),
            requested=some(-2e-4, 2e-4),
            slope=some(-1e-4, 1e-4),
            reference_position=some(-1, 1),
            limit=some(0, 1e-3),
            share=some(0, 1),
            rate=some(-1e-8, 1e-8),
            arrow=draw.choice(['up', 'down', 'steady']),
            predicted=some(-2e-4, 2e-4),
            band=some(0, 1e-5),
            limited=draw.sample(['clamp', 'slew', 'machine'], draw.randint(0, 3)),
            stable_in=some(0, 2e5),
            along=draw.choice(
                [None, {key: [some(-most, most) for _ in range(3)]
                        for key, most in (('position', 1), ('error', 1e-4), ('offset', 1e-4))}
                       | {'band': [some(0, 1e-5) for _ in range(3)]}]
            ),
            probe=draw.choice(
                [None, {'measured': some(-1e-4, 1e-4), 'predicted': some(-1e-4, 1e-4),
                        'age': some(0, 1e5)}]
            ),
        )
        for name in draw.sample('XYZABC', draw.randint(0, 4))
    ]  # fmt: skip
    document = view(axes=axes, spindle=some(-2000, 2000), recording=draw.choice(
        [None, {'active': True, 'bag': 'run_7'}]))  # fmt: skip
    document['state'] = {
        'compensation': draw.choice(['active', 'holding', 'ramping', 'inactive', 'absent']),
        'why': f'because of {draw.random()}',
        'machine': draw.choice(['running', 'homed', 'e-stop', 'off', 'unknown']),
        'offsets_allowed': draw.choice([True, False, None]),
    }
    document['model'] |= {
        'in_domain': draw.random() < 0.5,
        'valid': draw.random() < 0.5,
        'why': 'gap',
        'distance': some(0, 5),
        'runs': draw.choice([[], ['monday']]),
        'held_out': {'Y': some(0, 1e-5)},
    }
    for node in document['nodes']:
        node |= {
            'level': draw.choice(['ok', 'warn', 'error', 'stale']),
            'rate': some(0, 100),
            'latency': some(0, 0.1),
        }
    return document


@pytest.mark.parametrize('seed', range(8))
def test_operator_screen_is_the_view(page, fake, seed):
    document = random_view(seed)
    seen = shown(page, fake, document)
    assert seen['fields'] == operator_fields(document)
    assert seen['state'] == document['state']['compensation']


@pytest.mark.parametrize('seed', range(3))
def test_tables_are_the_view(page, fake, seed):
    document = random_view(seed + 100)
    page.open(fake.url, tab='offsets')
    assert shown(page, fake, document)['sheets'].get('Offsets now', []) == offset_rows(document)
    page.open(fake.url, tab='model')
    seen = shown(page, fake, document)
    assert seen['fields'] == model_fields(document)
    assert seen['sheets'] == {'Nodes': node_rows(document)}


def test_feeds_axes_and_soft_material_are_the_view(page, fake):
    page.open(fake.url, tab='motion')
    document = busy_view()
    seen = shown(page, fake, document)
    wanted = {
        'path': 'butterfly', 'status': 'following', 'place on the path': '123.400 mm',
        'feed': '3000 mm/min', 'override': '80 %', 'method': 'log_fuzzy', 'tolerance': '20.0 µm',
        'controllers': 'following', 'missed deadlines': '2', 'pattern': 'leaf',
        'material': 'foam', 'thickness': '30.00 mm', 'model': '77aa10bc9d01', 'stitches': '412',
        'not compensated in full': '7', 'largest offset': '1.800 mm',
    }  # fmt: skip
    found = {name: text.replace('\u00a0', ' ') for name, text in seen['fields'].items()}
    assert found.pop('range')
    assert found == wanted
    assert [
        [cell.replace('\u00a0', ' ') for cell in row] for row in seen['sheets']['Axes now']
    ] == [
        ['X', '123.456 mm', '+600.0 mm/min', '+1.50 µm', '✓ free'],
        ['Y', '\u221220.000 mm', '\u2212120.0 mm/min', '\u22122.25 µm', '✕ at its limit'],
    ]
    text = page.run('return document.body.innerText')
    assert 'does not run' not in text
    page.until(lambda: 'X position' in page.seen()['legends'], 'axes of the view')
    shown(page, fake, view())
    text = page.run('return document.body.innerText')
    for node in ('feedrate_scheduler', 'servo_controller', 'deformation_compensator'):
        assert f'{node} does not run at this machine.' in text


def test_temperatures_are_the_view(page, fake):
    page.open(fake.url, tab='temperatures')
    document = view(stamp=STAMP + 1.0)
    document['sensors']['values'] |= {'t03': -12.345, 't11': None}
    shown(page, fake, document)
    wanted = {
        name: number(value, 2, '°C') for name, value in document['sensors']['values'].items()
    }
    last = wanted.pop('t11')  # of which the newest is shown that was known
    page.until(lambda: page.seen()['legends'].items() >= wanted.items(), f'legends {wanted}')
    assert last == '\u2013' != page.seen()['legends']['t11']
    assert page.seen()['legends'].keys() == {*wanted, 't11', 't02 substituted'}
    headings = page.run(
        "return [...document.querySelectorAll('.chart h3')].map((h) => h.textContent)"
    )
    assert headings == ['Cluster of t01', 'Cluster of t05', 'In no cluster']


def test_offsets_and_error_follow_the_view(page, fake):
    for tab, name, value in (
        ('offsets', 'Y applied', -3.21e-6), ('offsets', 'Y requested', -4.32e-6),
        ('error', 'Y predicted', 5.4e-6),
    ):  # fmt: skip
        page.open(fake.url, tab=tab)
        document = view(stamp=STAMP + 1.0)
        document['axes'][0] |= {'offset': -3.21e-6, 'requested': -4.32e-6, 'predicted': 5.4e-6}
        shown(page, fake, document)
        wanted = micro(value, 2 if tab == 'offsets' else 1)
        page.until(lambda n=name, w=wanted: page.seen()['legends'].get(n) == w, f'{name} {wanted}')


def test_one_row_a_machine(page, fake):
    fake.show(
        view('mill'),
        busy_view('lathe'),
        view('grinder', silent='no data for 12 s: all nodes have ended'),
    )
    page.open(fake.url, tab='shop')
    rows = {}

    def all_told():
        rows.update({row[0]: row[2:] for row in page.seen()['sheets']['Machines of this server']})
        return rows.keys() == {'mill', 'lathe', 'grinder'} and rows['lathe'][0] != '\u2013'

    page.until(all_told, 'three rows')
    assert [text.replace('\u00a0', ' ') for text in rows['lathe']] == [
        '● active', 'running', '100.0 %', '1 h 15 min', '2', '✕ limit, ▲ sensors'
    ]  # fmt: skip
    assert rows['grinder'] == ['\u2013'] * 6
    assert 'NO DATA' not in page.seen()['noData']
    text = page.one('tr[data-key="grinder"]').text
    assert '✕ NO DATA: no data for 12 s: all nodes have ended' in text
    page.one('tr[data-key="lathe"] button').click()
    page.until(lambda: page.seen()['fields'].get('recording') == 'run_2', 'the lathe')
    assert page.run("return document.querySelector('#machine').value") == 'lathe'


def test_alarms_say_cause_and_remedy(page, fake):
    document = view(alarms=[alarm(), alarm('warn', node='compensator', name='late')])
    assert shown(page, fake, document)['alarms'] == [
        ['✕ error: ended (thermal_predictor)', 'thermal_predictor has ended',
         'start it again; its log says why it ended'],
        ['▲ warning: late (compensator)', 'thermal_predictor has ended',
         'start it again; its log says why it ended'],
    ]  # fmt: skip
    assert shown(page, fake, view())['alarms'] == []


HOSTILE = '<script>document.title="owned"</script><img src=x onerror="document.title=\'owned\'">'


def test_names_from_elsewhere_are_text(page, fake):
    document = busy_view(HOSTILE)
    document['axes'][0]['axis'] = HOSTILE
    document['sensors'] |= {
        'substituted': [{'name': HOSTILE, 'by': HOSTILE}],
        'missing': [{'name': HOSTILE, 'why': HOSTILE}],
        'values': {HOSTILE: 20.0},
        'clusters': [{'chosen': HOSTILE, 'members': [HOSTILE]}],
    }
    document['alarms'] = [alarm(node=HOSTILE, name=HOSTILE, cause=HOSTILE, remedy=HOSTILE)]
    document['state']['why'] = document['model']['name'] = HOSTILE
    document['nodes'][0]['name'] = document['recording']['bag'] = HOSTILE
    document['axes'][1]['limited'] = [HOSTILE]
    fake.show(document, view())
    page.run("document.title = 'clean'")
    for tab in ('operator', 'temperatures', 'error', 'offsets', 'model', 'motion', 'bags', 'shop'):
        page.open(fake.url, HOSTILE, tab)
        assert HOSTILE in page.run('return document.body.textContent'), tab
        made = page.run("return document.querySelectorAll('main script, main img').length")
        assert made == 0, tab
        assert page.driver.title != 'owned'
    page.open(fake.url, HOSTILE)
    page.one('[data-act="reference"]').click()
    assert HOSTILE in page.one('dialog h2').text


def test_it_tells_when_the_next_probe_is_due_and_what_the_last_changed(page, fake):
    told = {
        'due': False,
        'reason': '',
        'due_in': 5400.0,
        'age': 600.0,
        'changes': [{'channel': 'Y', 'change': -1.54e-6}],
        'cycle': None,
    }
    fields = shown(page, fake, view(probing=told))['fields']
    assert fields['probing'] == (
        f'Next probe due in about 1{GAP}h{GAP}30{GAP}min. The last, 10{GAP}min ago, changed '
        f'Y {micro(-1.54e-6, signed=True)}.'
    )
    cycle = {'due': True, 'reason': 'wide', 'outcome': '', 'accepted': True, 'failures': 0}
    told = {**told, 'due': True, 'reason': 'Z to 9 µm', 'age': None, 'cycle': cycle}
    fields = shown(page, fake, view(probing=told))['fields']
    assert fields['probing'] == 'Probe due: Z to 9 µm.'
    assert fields['probing cycle'] == 'Probing cycle: due, wide.'
