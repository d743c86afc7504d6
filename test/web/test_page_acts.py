# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Acts are confirmed, signed, sent as they are meant, and answered by what the server says."""

import pytest
from fake_dashboard import view

LEARNING = {
    'due': False,
    'reason': '',
    'due_in': None,
    'age': 600.0,
    'changes': [{'channel': 'Y', 'change': -1.54e-6}],
    'cycle': None,
}


def begin(page, act):
    """Open the question about an act; return its text."""
    page.until(lambda: page.one(f'[data-act="{act}"]').is_enabled(), act)
    page.one(f'[data-act="{act}"]').click()
    return page.one('dialog.act[open]').text


def confirm(page, name='Ada'):
    """Sign and confirm; return what is said."""
    if not page.one('#act-by').get_attribute('value'):
        page.one('#act-by').send_keys(name)
    page.one('dialog button[type="submit"]').click()
    return page.say()


def node(lifecycle):
    """Return a view whose compensator is in a state of its lifecycle."""
    document = view()
    document['nodes'][0]['lifecycle'] = lifecycle
    return document


@pytest.mark.parametrize(
    ('act', 'document', 'effect', 'body'),
    [
        ('reference', view(), 'become its thermal zero', {'force': False}),
        ('activate', node('inactive'), 'add offsets to its axes', {'node': 'compensator'}),
        ('deactivate', view(), 'ramp to zero', {'node': 'compensator'}),
        ('record', view(), 'into a new bag', {'start': True}),
        ('record', view(recording={'active': True, 'bag': 'run_2'}), 'run_2 is closed',
         {'start': False}),
    ],
)  # fmt: skip
def test_an_act_is_confirmed_and_sent(page, fake, act, document, effect, body):
    fake.show(document)
    page.until(lambda: page.seen()['sequence'] is not None, 'a view')
    wanted = 'Stop' if body == {'start': False} else ''
    page.until(lambda: wanted in page.one(f'[data-act="{act}"]').text, 'the button')
    text = begin(page, act)
    assert 'mill' in text
    assert effect in text
    assert fake.acted == [], 'nothing is done before it is confirmed'
    assert confirm(page) == f'✓ {act} is done'
    assert fake.acted == [('mill', act, {**body, 'by': 'Ada'}, '')]
    page.one('dialog button').click()
    page.until(lambda: not page.driver.find_elements('css selector', 'dialog'), 'its end')


def test_what_is_in_force_and_what_is_wanted_is_named(page, fake):
    assert 'Y \u22121.2 µm, Z +23.5 µm' in begin(page, 'deactivate')


def test_a_name_is_needed_once(page, fake):
    begin(page, 'reference')
    page.one('dialog button[type="submit"]').click()
    assert 'Your name is needed' in page.say()
    assert fake.acted == []
    assert confirm(page, 'Grace') == '✓ reference is done'
    page.open(fake.url)
    begin(page, 'deactivate')
    assert page.one('#act-by').get_attribute('value') == 'Grace'


def test_a_question_can_be_left(page, fake):
    begin(page, 'deactivate')
    page.run("document.activeElement.dispatchEvent(new KeyboardEvent('keydown', {key: 'a'}))")
    page.driver.switch_to.active_element.send_keys('\ue00c')  # Escape
    page.until(lambda: not page.driver.find_elements('css selector', 'dialog'), 'its end')
    begin(page, 'deactivate')
    page.one('dialog button.quiet').click()
    page.until(lambda: not page.driver.find_elements('css selector', 'dialog'), 'its end')
    assert fake.acted == []


def test_a_refusal_is_shown_as_it_is_said(page, fake):
    says = 'compensator refuses to activate; <b>its log</b> says why'
    fake.show(node('inactive'))
    page.until(lambda: page.one('[data-act="activate"]').is_enabled(), 'an inactive compensator')
    fake.answers['activate'] = [(409, {'done': False, 'says': says})]
    begin(page, 'activate')
    assert confirm(page) == f'✕ {says}'
    assert page.run("return document.querySelectorAll('dialog b').length") == 0
    page.one('dialog button[type="submit"]').click()  # it may be tried again
    page.until(lambda: page.say() == '✓ activate is done', 'the second answer')


def test_a_server_that_breaks_is_told(page, fake):
    fake.answers['deactivate'] = [(500, {'fault': 'no field says'})]
    begin(page, 'deactivate')
    assert '500' in confirm(page)


def test_a_reference_with_offsets_in_force_is_asked_twice(page, fake):
    says = 'offsets are in force: Y -1.2 µm; with force they would stand against a new zero'
    fake.answers['reference'] = [(409, {'done': False, 'says': says, 'needs': 'force'})]
    begin(page, 'reference')
    page.one('#act-by').send_keys('Ada')
    page.one('dialog button[type="submit"]').click()
    # In one look: the first dialog may go between two.
    seen = "return document.querySelector('dialog.act[open]')?.textContent ?? ''"
    page.until(lambda: says in page.run(seen), 'the second question')
    assert 'mill' in page.one('dialog[open] h2').text
    assert [body['force'] for _, _, body, _ in fake.acted] == [False]
    assert confirm(page) == '✓ reference is done'
    assert [body['force'] for _, _, body, _ in fake.acted] == [False, True]


def test_a_probe(page, fake):
    begin(page, 'probe')
    assert 'at least one' in confirm(page)
    y, z, deviation = (page.one(f'[data-probe="{name}"]') for name in ('Y', 'Z', 'deviation'))
    y.send_keys('three')
    page.one('dialog button[type="submit"]').click()
    assert page.say() == 'Y: expected a number in µm but found "three".'
    y.clear()
    y.send_keys('\u22123,25')  # as the page writes it, or as Germans do
    deviation.send_keys('0')
    page.one('dialog button[type="submit"]').click()
    page.until(lambda: 'expected a positive number' in page.say(), 'a refusal')
    deviation.clear()
    z.send_keys('1e3')
    page.one('dialog button[type="submit"]').click()
    page.until(lambda: page.say().startswith('Z: expected'), 'a refusal')
    z.clear()
    assert fake.acted == []
    page.one('dialog button[type="submit"]').click()
    page.until(lambda: page.say() == '✓ probe is done', 'the answer')
    ((machine, action, body, _),) = fake.acted
    assert (machine, action) == ('mill', 'probe')
    assert body.pop('values') == {'Y': pytest.approx(-3.25e-6)}
    assert body == {'deviation': None, 'by': 'Ada'}


def test_forgetting_needs_a_mode_and_a_reason(page, fake):
    assert page.one('[data-act="forget"]').get_attribute('disabled'), 'nothing is learnt'
    fake.show(view(probing=LEARNING))
    assert 'offsets do not step' in begin(page, 'forget')
    assert 'Choose what is forgotten' in confirm(page)
    page.one('[data-mode="undo"]').click()
    page.one('dialog button[type="submit"]').click()
    page.until(lambda: 'A reason is needed' in page.say(), 'a refusal')
    page.one('[data-why]').send_keys(' chip under the probe ')
    assert fake.acted == []
    page.one('dialog button[type="submit"]').click()
    page.until(lambda: page.say() == '✓ forget is done', 'the answer')
    body = {'mode': 'undo', 'why': 'chip under the probe', 'by': 'Ada'}
    assert fake.acted == [('mill', 'forget', body, '')]


def test_a_token_is_asked_for_once(page, fake):
    fake.needs_token = True
    fake.answers['deactivate'] = [(401, {'done': False, 'says': 'acting needs the token'})]
    page.open(fake.url)
    begin(page, 'deactivate')
    assert 'The token is needed' in confirm(page)
    page.one('#act-token').send_keys('wrong')
    page.one('dialog button[type="submit"]').click()
    page.until(lambda: page.say() == '✕ acting needs the token', 'the refusal')
    assert page.one('#act-token').get_attribute('value') == ''
    page.one('#act-token').send_keys('right')
    page.one('dialog button[type="submit"]').click()
    page.until(lambda: page.say() == '✓ deactivate is done', 'the answer')
    page.one('dialog button').click()
    begin(page, 'reference')
    assert not page.driver.find_elements('css selector', '#act-token')
    assert confirm(page) == '✓ reference is done'
    tokens = [token for _, _, _, token in fake.acted]
    assert tokens == ['Bearer wrong', 'Bearer right', 'Bearer right']


def test_who_may_only_look_sees_no_buttons(page, fake):
    fake.writable = False
    page.open(fake.url)
    assert not page.one('#actions').is_displayed()


def test_without_a_folder_for_bags_the_page_says_so_beforehand(page, fake):
    assert not page.one('#no-recording').is_displayed()
    fake.recordable = False
    page.open(fake.url)
    page.until(lambda: page.one('#no-recording').is_displayed(), 'the hint')
    assert 'set the parameter bags' in page.one('#no-recording').text
    assert not page.one('[data-act="record"]').is_enabled()
    fake.show(view(recording={'active': True, 'bag': 'run_2'}))
    page.until(lambda: page.one('[data-act="record"]').is_enabled(), 'a recording to stop')


def test_only_what_makes_sense_is_offered(page, fake):
    page.until(lambda: page.one('[data-act="deactivate"]').is_enabled(), 'an active compensator')
    assert not page.one('[data-act="activate"]').is_enabled()
    fake.show(node('inactive'))
    page.until(lambda: page.one('[data-act="activate"]').is_enabled(), 'an inactive one')
    assert not page.one('[data-act="deactivate"]').is_enabled()


def test_a_question_ends_with_its_machine(page, fake):
    fake.show(view(), view('lathe'))
    page.until(lambda: page.one('#machine').is_displayed(), 'two machines')
    begin(page, 'deactivate')
    page.run("location.hash = 'lathe/operator'")
    page.until(lambda: not page.driver.find_elements('css selector', 'dialog'), 'its end')
