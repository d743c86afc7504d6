# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The past: fetched once, continued by views, fetched anew where somebody looks closer."""

import pytest
from fake_dashboard import STAMP, view
from selenium.webdriver.common.action_chains import ActionChains


@pytest.fixture
def plots(page, fake):
    """The tab of offsets, with its past."""
    page.open(fake.url, tab='offsets')
    page.until(lambda: page.seen()['rows'] > 300, 'an hour')
    return page


def test_an_hour_is_fetched_once(plots, fake):
    assert fake.asked == [('mill', 'compensation', STAMP - 3600.0, STAMP)]
    for at in range(1, 4):
        document = view(stamp=STAMP + at)
        document['axes'][0]['offset'] = at * 1e-6
        fake.show(document)
        wanted = f'{at}.00\u00a0µm'
        plots.until(lambda w=wanted: plots.seen()['legends']['Y applied'] == w, 'the newest row')
    assert plots.seen()['rows'] == 363, 'an hour in rows of 10 s less the first, and three more'
    assert len(fake.asked) == 1


def test_live_rows_are_appended_and_old_ones_dropped(plots, fake):
    fake.show(view(stamp=STAMP + 1800.0))
    # The half hour in between is not known here: it is a pause, no line is drawn across it.
    plots.until(lambda: plots.seen()['rows'] == 182, 'half an hour less, one row more')
    assert plots.seen()['fields']['range'].endswith('1\u00a0h')


DRAWN = """
const [chart, colour] = arguments;
const plot = document.querySelectorAll('.chart')[chart];
const over = plot.querySelector('.u-over');
const canvas = plot.querySelector('canvas');
const probe = document.body.appendChild(document.createElement('i'));
probe.style.color = `var(--${colour})`;
const wanted = getComputedStyle(probe).color.match(/\\d+/g).map(Number);
probe.remove();
const {offsetLeft: left, offsetTop: top, clientWidth: width, clientHeight: height} = over;
const {data} = canvas.getContext('2d').getImageData(left, top, width, height);
const parts = new Array(20).fill(false);
for (let at = 0; at < data.length; at += 4) {
  const near = wanted.every((value, part) => Math.abs(value - data[at + part]) < 12);
  if (near) parts[Math.min(19, Math.floor((at / 4 % width) / width * 20))] = true;
}
return parts.map((part) => (part ? '#' : '.')).join('');
"""
"""In which twentieths of a plot there is a line of a colour."""


def past(columns, times):
    """Return a past of columns, whose values are told at some of the times."""

    def answer(series, begin, end, points, newest):
        told = {
            name: [-2e-6 if known(at) else None for at in range(len(times))]
            for name, known in columns.items()
        }
        columns_ = {name: dict.fromkeys(('min', 'mean', 'max'), v) for name, v in told.items()}
        return {'time': [newest + time for time in times], 'columns': columns_, 'flags': {}}

    return answer


def drawn(page, fake, columns, times, tab='offsets', colour='line-1'):
    """Return where a line is drawn of a past."""
    fake.past = past(columns, times)
    fake.show(view(axes=[]))
    page.open(fake.url, tab=tab)
    page.until(lambda: page.seen()['rows'] >= len(times), 'the past')
    return page.run(DRAWN, 0, colour)


HOUR = range(-3600, 1)


def test_rows_of_other_topics_are_no_gaps(page, fake):
    columns = {
        'Y applied': lambda at: at % 2 == 0,
        'Y requested': lambda at: at % 2 == 1,
        'Y limit': lambda at: at % 2 == 1,
    }
    times = HOUR[::60]
    assert drawn(page, fake, columns, times) == '#' * 20
    assert '.' not in page.run(DRAWN, 0, 'error'), 'dashes of the limit'


def test_a_pause_is_no_line(page, fake):
    columns = {'Y applied': lambda at: True, 'Y requested': lambda at: True}
    times = [time for time in HOUR[::60] if not -2700 < time < -900]
    assert drawn(page, fake, columns, times) == '#' * 5 + '.' * 10 + '#' * 5
    # What was told meanwhile on another topic does not close the gap.
    columns['Y applied'] = lambda at: not -2700 < HOUR[::60][at] < -900
    assert drawn(page, fake, columns, HOUR[::60]) == '#' * 5 + '.' * 10 + '#' * 5


def test_a_past_that_is_coarser_is_no_pause(page, fake):
    columns = {'Y applied': lambda at: True, 'Y requested': lambda at: True}
    times = [*HOUR[:-900:60], *HOUR[-900:]]
    assert drawn(page, fake, columns, times) == '#' * 20


def test_a_prediction_that_was_invalid_is_a_gap(page, fake):
    columns = dict.fromkeys(('Y predicted', 'Y band'), lambda at: not 20 < at < 40)
    found = drawn(page, fake, columns, HOUR[::60], tab='error')
    assert found == '#' * 7 + '.' * 6 + '#' * 7


def test_a_stretch_that_is_drawn_with_the_mouse_is_fetched(plots, fake):
    over = plots.driver.find_elements('css selector', '.u-over')[0]
    width = over.size['width']
    ActionChains(plots.driver).move_to_element_with_offset(over, -width // 4, 0).click_and_hold(
    ).move_by_offset(width // 4, 0).move_by_offset(width // 4, 0).release().perform()  # fmt: skip
    plots.until(lambda: len(fake.asked) == 2, 'another stretch')
    _, _, begin, end = fake.asked[1]
    assert begin == pytest.approx(STAMP - 2700.0, abs=40.0)
    assert end == pytest.approx(STAMP - 900.0, abs=40.0)
    plots.until(lambda: plots.seen()['fields']['range'].endswith('stands still'), 'a fixed range')
    assert (
        plots.one('#panel-offsets [aria-label^="Live"]').get_attribute('aria-pressed') == 'false'
    )
    rows = plots.seen()['rows']
    fake.show(view(stamp=STAMP + 10.0))
    sequence = plots.seen()['sequence']
    plots.until(lambda: plots.seen()['sequence'] != sequence, 'a view')
    assert plots.seen()['rows'] == rows, 'nothing is appended to a stretch that stands still'
    ActionChains(plots.driver).double_click(over).perform()
    plots.until(lambda: fake.asked[-1][3] == STAMP + 10.0, 'back to live')


@pytest.mark.parametrize(
    ('button', 'begin', 'end'),
    [
        ('Earlier', -5400.0, -1800.0),
        ('Later', -1800.0, 1800.0),
        ('Zoom in', -2700.0, -900.0),
        ('Zoom out', -5400.0, 1800.0),
    ],
)
def test_buttons_do_what_the_mouse_does(plots, fake, button, begin, end):
    plots.one(f'#panel-offsets button[aria-label="{button}"]').send_keys(' ')
    plots.until(lambda: len(fake.asked) == 2, 'another stretch')
    assert fake.asked[1] == ('mill', 'compensation', STAMP + begin, STAMP + end)
    plots.one('#panel-offsets [aria-label^="Live"]').send_keys(' ')
    plots.until(lambda: len(fake.asked) == 3, 'the newest hour')
    assert fake.asked[2][2:] == (STAMP - 3600.0, STAMP)


def test_a_longer_span_and_all_tabs_share_it(plots, fake):
    plots.one('#panel-offsets select').send_keys('2')  # a pause before a 4 would choose 4 h
    plots.until(lambda: fake.asked[-1][2] == STAMP - 86400.0, 'a day')
    plots.one('#tab-error').click()
    plots.until(lambda: fake.asked[-1][1] == 'error', 'the error')
    assert fake.asked[-1][2:] == (STAMP - 86400.0, STAMP)
    assert plots.one('#panel-error select').get_attribute('value') == '86400'


def test_only_the_tab_that_is_seen_asks(plots, fake):
    assert {series for _, series, _, _ in fake.asked} == {'compensation'}


def test_another_machine_has_its_own_past(plots, fake):
    fake.show(view(), view('lathe', stamp=STAMP + 7.0))
    plots.until(lambda: plots.one('#machine').is_displayed(), 'two machines')
    plots.one('#machine').send_keys('lathe')
    plots.until(lambda: fake.asked[-1][0] == 'lathe', 'its past')
    assert fake.asked[-1] == ('lathe', 'compensation', STAMP - 3593.0, STAMP + 7.0)


def test_a_clock_that_was_set_back_begins_anew(plots, fake):
    fake.show(view(stamp=STAMP - 50000.0))
    plots.until(lambda: fake.asked[-1][3] == STAMP - 50000.0, 'the past of then')


def test_lines_can_be_left_out(plots, fake):
    key = plots.driver.find_elements('css selector', '.keys button')[0]
    key.send_keys(' ')
    assert key.get_attribute('aria-pressed') == 'false'
    key.send_keys(' ')
    assert key.get_attribute('aria-pressed') == 'true'


def test_the_legend_tells_what_is_under_the_cursor(plots, fake):
    newest = plots.seen()['legends']['Z applied']
    over = plots.driver.find_elements('css selector', '.u-over')[1]
    ActionChains(plots.driver).move_to_element_with_offset(over, -100, 0).perform()
    plots.until(lambda: plots.seen()['legends']['Z applied'] != newest, 'an older value')


def test_a_past_that_cannot_be_read_is_told(page, fake):
    page.open(fake.url, tab='temperatures')
    page.until(lambda: page.seen()['rows'] > 300, 'the past')
    mill = fake.views.pop('mill')
    page.one('#panel-temperatures button[aria-label="Earlier"]').click()
    page.until(lambda: 'no machine mill' in page.seen()['trouble'], 'the refusal')
    fake.views['mill'] = mill
    page.one('#panel-temperatures [aria-label^="Live"]').click()
    page.until(lambda: page.seen()['trouble'] == '', 'the past again')


def test_recordings_are_listed_and_can_be_taken(page, fake):
    page.open(fake.url, tab='bags')
    page.until(lambda: len(page.seen()['sheets']['Recordings of this server']) == 2, 'two bags')
    first, second = page.seen()['sheets']['Recordings of this server']
    assert first[0] == 'run_1'
    assert first[2:] == [
        '1\u00a0h\u00a030\u00a0min',
        '12.3\u00a0MB',
        '✓ complete',
        'download · report',
    ]
    assert second[2:5] == ['12\u00a0s', '900\u00a0B', '▲ not closed']
    links = [
        link.get_attribute('href') for link in page.driver.find_elements('css selector', 'td a')
    ]
    assert links[0] == f'{fake.url}bags/run_1'
    assert links[2] == f'{fake.url}bags/a%20run%2F%3Cb%3E%26'
    page.driver.find_elements('css selector', 'td a')[3].click()
    page.until(lambda: 'no report of that bag; write one' in page.seen()['trouble'], 'a refusal')
    page.driver.find_elements('css selector', 'td a')[1].click()
    page.until(lambda: len(page.driver.window_handles) == 2, 'the report')
    own, report = page.driver.window_handles
    page.driver.switch_to.window(report)
    page.until(lambda: page.driver.title == 'Report of run_1', 'the report')
    page.driver.close()
    page.driver.switch_to.window(own)
