# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What goes wrong shows with its cause in the first view that knows it, and silence by itself."""

from fake_dashboard import STAMP, alarm, busy_view, view


def first_seen(page, fake, document, begin):
    """Show a view; return what is seen when the first view of that number is seen."""
    document['sequence'] = begin
    fake.show(document)
    pictures = []

    def arrived():
        pictures.append(page.seen())
        return (pictures[-1]['sequence'] or 0) > begin

    page.until(arrived, f'view {begin}')
    return pictures[-1]


def test_a_sensor_that_is_pulled(page, fake):
    document = view()
    document['sensors'] |= {
        'ok': 10,
        'missing': [{'name': 't05', 'why': 'no reading'}],
        'substituted': [{'name': 't01', 'by': 't02'}],
    }
    document['alarms'] = [alarm('warn', name='sensor', cause='t05 gives no reading')]
    seen = first_seen(page, fake, document, 1000)
    assert seen['lost'] == ['\u00d7 t05: no reading', '▨ t01: t02 stands in']
    assert seen['alarms'][0][1] == 't05 gives no reading'


def test_a_predictor_that_is_killed(page, fake):
    state = {'compensation': 'holding', 'why': 'no error for 3 s', 'machine': 'running',
             'offsets_allowed': True}  # fmt: skip
    seen = first_seen(page, fake, view(alarms=[alarm()], state=state), 1000)
    assert seen['alarms'] == [
        ['✕ error: ended (thermal_predictor)', 'thermal_predictor has ended',
         'start it again; its log says why it ended']
    ]  # fmt: skip
    assert (seen['state'], seen['fields']['compensation']) == ('holding', 'holding')
    assert seen['fields']['why'] == 'no error for 3 s'


def test_a_limit_that_is_reached(page, fake):
    seen = first_seen(page, fake, busy_view(), 1000)
    assert seen['fields']['Z limited'] == '✕ limit of size, limit of rate'
    assert seen['fields']['Y limited'] == ''
    bar = page.run(
        "const bar = document.querySelectorAll('.bar')[1]; const fill = bar.firstElementChild;"
        'return [bar.dataset.level, bar.getAttribute("aria-valuenow"), fill.style.left, '
        'fill.style.width]'
    )
    assert bar == ['limit', '100.0', '50%', '50%']
    low = busy_view()
    low['axes'][1] |= {'offset': -4.5e-5, 'share': 0.9, 'limited': []}
    first_seen(page, fake, low, 2000)
    bar = page.run(
        "const bar = document.querySelectorAll('.bar')[1]; const fill = bar.firstElementChild;"
        'return [bar.dataset.level, bar.getAttribute("aria-valuenow"), fill.style.left, '
        'fill.style.width]'
    )
    assert bar == ['near', '-90.0', '5%', '45%']


def test_a_machine_that_is_silent(page, fake):
    assert page.seen()['noData'] == ''
    cause = 'no data for 12 s: temperature_acquisition has ended; start it again'
    seen = first_seen(page, fake, view(silent=cause), 1000)
    assert 'NO DATA' in seen['noData']
    assert cause in seen['noData']
    # It lies over the numbers, and not over the ways to another machine.
    over = page.run(
        'const at = (selector) => { const box = document.querySelector(selector)'
        '.getBoundingClientRect(); return document.elementFromPoint(box.x + box.width / 2, '
        'box.y + box.height / 2).closest("#no-data, header").id; };'
        "return [at('.axis .offset'), at('#state'), at('#actions'), at('#tab-shop')]"
    )
    assert over == ['no-data'] * 3 + ['']
    assert page.run("return document.querySelector('#main').inert")
    page.one('#tab-temperatures').click()
    page.until(lambda: page.seen()['rows'] > 100, 'the past')
    assert 'NO DATA' in page.seen()['noData']
    assert not page.run("return document.querySelector('#main').inert"), 'the past can be read'
    assert first_seen(page, fake, view(), 2000)['noData'] == ''


def test_a_server_that_hangs(page, fake):
    fake.mute = True
    page.until(lambda: 'Nothing from the server' in page.seen()['noData'], 'NO DATA')
    assert page.seen()['link'] == 'open'
    fake.mute = False
    page.until(lambda: page.seen()['noData'] == '', 'data')


def test_a_server_that_is_gone_and_comes_back(page, fake):
    page.one('#tab-bags').click()
    fake.refusing = True
    page.until(lambda: 'The server does not answer' in page.seen()['noData'], 'NO DATA')
    seen = page.seen()
    assert 'Connecting again' in seen['noData']
    assert seen['link'] == 'lost'
    fake.refusing = False
    fake.show(view(spindle=0.0))
    page.until(lambda: page.seen()['noData'] == '' and page.seen()['link'] == 'open', 'data')
    page.one('#tab-operator').click()
    page.until(lambda: page.seen()['fields'].get('spindle') == '0\u00a0rpm', 'the new view')


def test_a_machine_that_nobody_knows(page, fake):
    page.driver.get(f'{fake.url}#mil/operator')
    page.until(lambda: 'knows no machine mil' in page.seen()['noData'], 'NO DATA')


def test_machines_that_come_and_go(page, fake):
    def names():
        return page.run(
            "return [...document.querySelectorAll('#machine option')].map((o) => o.text)"
        )

    assert not page.one('#machine').is_displayed(), 'one machine needs no choice'
    fake.show(view(), view('lathe'))
    page.until(lambda: names() == ['mill', 'lathe'], 'two machines')
    assert page.one('#machine').is_displayed()
    fake.show(view('lathe'))
    page.until(lambda: 'knows no machine mill' in page.seen()['noData'], 'NO DATA')


def test_data_grow_old_while_nothing_arrives(page, fake):
    document = view(age=75.0)
    first_seen(page, fake, document, 1000)
    assert page.seen()['age'] == '1\u00a0min'
    first_seen(page, fake, view(age=None, stamp=None), 2000)
    page.until(lambda: page.seen()['age'] == '\u2013', 'no age')
    first_seen(page, fake, view(age=3.0, stamp=STAMP), 3000)
    fake.mute = True
    page.until(lambda: float(page.seen()['age'].split('\u00a0')[0]) > 4.0, 'an age that grows')
