# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reports as a person sees them: in a browser, wide and narrow, light and dark."""

import re
from functools import partial

import numpy as np
import pytest
from processes import wait_for
from report_browser import Reader, check
from thermal_reports import day_run, report

from fuzzycnc_ros.studies.contour.contouring_page import path_chart
from fuzzycnc_ros.studies.page.chart import ROWS_MAX, Axis, Chart, Panel, Rule, Series
from fuzzycnc_ros.studies.page.drawing import AFTER, LIMIT
from fuzzycnc_ros.studies.page.html import Figure, Page, Section, render_page
from fuzzycnc_ros.studies.thermal.report_page import report_page

SIZE_MAX = 1.5e6
"""Size of the report on a day [bytes]."""

RUNS = ('shift_calibration/D0', 'shift_calibration/D0b', 'shift_calibration/T1')

COMMANDS = {
    'simulate': ('simulate', '--duties', 'T2'),
    'evaluate': (
        'evaluate',
        'shift_calibration/D0b',
        '--model',
        'm.json',
        '--probe-every',
        '1h',
    ),
    'compare': ('compare', *RUNS, '--models', 'static_ridge,lag_ridge'),
    'grinder': ('compare', '--machine', 'grinder', '--models', 'lag_ridge,static_ridge'),
    'curve': ('curve', *RUNS, '--counts', '1,2'),
    'schedule': (
        'schedule',
        'part.ngc',
        '--tolerance',
        '20um',
        '--blend',
        '0mm',
        '--out',
        'out.ngc',
    ),
    'advise': ('advise', 'part.ngc', '--tolerance', '20um'),
    'pareto': ('pareto', 'part.ngc'),
    'position': ('position', '--to', '-50mm'),
    'servo': ('servo', 'compare', '--moves', '0', '--controllers', 'variable_universe,pid'),
    'stability': ('servo', 'stability'),
    'foam': ('soft', 'demo', '--runs', '1'),
    'samples': ('soft', 'train', 'samples.csv', '--out', 'foam.json'),
    'thermal test': ('report', 'thermal', 'shift_calibration/D0'),
}
"""A command of each kind of report."""

OUT = {'thermal test': '--out'}
"""Option that names the page, where it is another one than --report."""

TABLES_ONLY = {'grinder'}
"""Reports without figures."""


class Keys:
    """Keys without a character, as WebDriver has them."""

    ARROW_LEFT, ARROW_RIGHT = '\ue012', '\ue014'


@pytest.fixture(scope='session')
def reader(browser, tmp_path_factory):
    return Reader(browser, tmp_path_factory.mktemp('downloads'))


@pytest.fixture(scope='module')
def run():
    return day_run()


@pytest.fixture(scope='module')
def day(run, tmp_path_factory):
    page = tmp_path_factory.mktemp('day') / 'day.html'
    facts = {'Recorded': '2026-03-02 06:00 UTC', 'Machine': 'mill', 'Bag': 'monday'}
    page.write_text(render_page(report_page(report(runs=[run], facts=facts))), encoding='utf-8')
    return page


DOTS = Series('found', [5.0, 2.0, 4.0], AFTER, kind='dots')


@pytest.mark.slow
def test_the_report_of_a_day_is_small_and_fits_all_screens(reader, day):
    assert day.stat().st_size <= SIZE_MAX
    check(reader, day)
    head = reader.run("return document.querySelector('header dl').innerText")
    assert [part in head for part in ('2026-03-02', 'mill', 'monday')] == [True] * 3


def test_dragging_zooms_all_panels_of_a_figure_and_a_double_click_goes_back(reader, day):
    reader.open(day)
    whole = reader.ends(3)
    assert whole == pytest.approx([0.0, 24.0 - 10.0 / 3600.0], abs=0.01)
    reader.drag(reader.plot(3), 0.25, 0.5)
    for panel in range(5):
        assert reader.ends(3, panel) == pytest.approx([6.0, 12.0], abs=0.2)
    reader.double_click(reader.plot(3))
    assert reader.ends(3) == reader.ends(3, 4) == whole
    assert reader.complaints() == []


def test_values_under_the_cursor_are_read_out_with_their_units(reader, day, run):
    reader.open(day)
    read = reader.point_at(reader.plot(3), 0.5)
    hour = float(read['time'].removesuffix(' h'))
    assert hour == pytest.approx(12.0, abs=0.2)
    row = round(hour * 360.0)
    near = 1e6 * run.measured[row - 3 : row + 4, 0]  # hours have two decimals
    value = float(read['before: uncompensated'].removesuffix(' µm'))
    assert np.abs(near - value).min() < 0.05
    assert read['outside the training domain'] == 'no'
    assert read['band of two standard deviations'] == '-2.00 to 2.00 µm'


def test_the_csv_file_holds_the_recording_with_every_extreme(reader, day, run):
    reader.open(day)
    rows = reader.data(3)
    name = next(key for key in rows[0] if key.startswith('Y:') and 'before' in key)
    assert name.endswith(' [µm]')
    kept = [(float(row['time [h]']), float(row[name])) for row in rows if row[name]]
    assert len(kept) <= ROWS_MAX
    time, values = np.array(kept).T
    at = np.round(360.0 * time).astype(int)
    np.testing.assert_allclose(values, 1e6 * run.measured[at, 1], atol=0.02)
    assert values.max() == pytest.approx(200.0, abs=0.02)
    latency = [float(row['latency [ms]']) for row in reader.data(6)]
    assert latency == pytest.approx(np.linspace(1.0, 3.0, 101), abs=1e-3)


def test_what_is_printed_is_drawn_for_paper_and_again_for_the_screen(reader, day):
    reader.open(day, theme='dark')
    ink = """const [{data}] = [document.querySelector('#figure-3 canvas').getContext('2d')]
        .map(canvas => canvas.getImageData(0, 0, 400, 400));
        return Math.max(...data.filter((_, i) => i % 4 === 0 && data[i + 3] === 255))"""
    dark = reader.run(ink)
    media = [{'name': 'prefers-color-scheme', 'value': 'dark'}]
    emulate = partial(reader.driver.execute_cdp_cmd, 'Emulation.setEmulatedMedia')
    emulate({'media': 'print', 'features': media})
    wait_for(lambda: reader.run(ink) < dark, 'the colours of paper')
    assert not reader.run("return document.querySelector('.tools').checkVisibility()")
    emulate({'media': '', 'features': media})
    wait_for(lambda: reader.run(ink) == dark, 'the colours of the screen')


def test_points_on_logarithmic_axes_are_zoomed_and_read(reader, tmp_path):
    error, time = np.array([0.005, 0.02, 0.1]), np.array([40.0, 12.0, 7.0])
    axis = Axis('largest contour error', 'mm', 'log')
    panel = Panel(
        np.empty(0),
        Axis('time', 's', 'log'),
        [Series('method', time, AFTER, kind='both', x=error)],
        rules=[Rule(0.05, LIMIT, 'tolerance', upright=True)],
    )
    page = tmp_path / 'points.html'
    figure = Figure('Points', 'Three of them.', Chart(axis, [panel], height=4.0))
    page.write_text(render_page(Page('Points', '', [Section('All', figures=[figure])])))
    check(reader, page, themes=('light',))
    reader.open(page)
    read = reader.point_at(reader.plot(1), 0.02)
    assert read == {'largest contour error': '0.0050 mm', 'method': '40.00 s'}
    before = reader.ends(1)
    reader.drag(reader.plot(1), 0.3, 0.6)
    low, high = reader.ends(1)
    assert before[0] < low < high < before[1]
    rows = reader.data(1)
    assert [list(map(float, row.values())) for row in rows] == [
        pytest.approx(pair, rel=1e-3) for pair in zip(error, time, strict=True)
    ]


@pytest.fixture(scope='module')
def drawn(tmp_path_factory):
    """A page with a path, with points whose names need room, and a plane at true scale."""
    turn = np.linspace(0.0, 2.0 * np.pi, 201)
    point = 1e-3 * np.column_stack([40.0 * np.cos(turn), 30.0 * np.sin(turn)])
    error = 1e-6 * np.linspace(1.0, 30.0, 201)
    axis = Axis('count', ticks=(1.0, 2.0, 3.0))
    x, y = 1e3 * point.T
    true = Panel([], Axis('Y', 'mm'), [Series('ring', y, AFTER, x=x)], plane=1.0, true_scale=True)
    points = Panel(np.array([1.0, 2.0, 3.0]), Axis('error', 'µm'), [DOTS])
    figures = [
        Figure('Path', 'A ring.', path_chart(point, error, 'XY', 20e-6)),
        Figure('Points', 'Three.', Chart(axis, [points])),
        Figure('True scale', 'A ring.', Chart(Axis('X', 'mm'), [true])),
    ]
    page = tmp_path_factory.mktemp('drawn') / 'drawn.html'
    page.write_text(render_page(Page('Drawn', '', [Section('All', figures=figures)])))
    return page


def test_a_path_is_zoomed_by_hand_keys_and_fingers(reader, drawn):
    reader.open(drawn)
    ring = reader.plot(1)
    assert reader.shown(1) == {}
    reader.drag(ring, 0.25, 0.5)
    (low, high), (bottom, top) = reader.shown(1).values()
    assert low < high < 0.5
    scale = ring.size['width'] / ring.size['height']
    assert high - low == pytest.approx(scale * (top - bottom), rel=0.02)
    reader.double_click(ring)
    assert reader.shown(1) == {}
    reader.press(ring, '+', '+', Keys.ARROW_RIGHT)
    right = reader.shown(1)['X']
    reader.press(ring, Keys.ARROW_LEFT)
    assert reader.shown(1)['X'][0] < right[0]
    reader.press(ring, '0')
    assert reader.shown(1) == {}
    reader.wheel(ring, -240.0)
    once = reader.shown(1)['X']
    assert once == pytest.approx([-once[1], once[1]], abs=0.02 * once[1])
    reader.wheel(ring, 240.0)
    assert reader.shown(1) == {}
    reader.pinch(ring, (0.45, 0.55), (0.3, 0.7))
    assert np.ptp(reader.shown(1)['X']) == pytest.approx(0.5 * np.ptp(once), rel=0.03)
    before = reader.shown(1)['X']
    reader.pinch(ring, (0.3, 0.7), (0.4, 0.8))
    moved = reader.shown(1)['X']
    assert before[0] - moved[0] == pytest.approx(0.1 * np.ptp(before), rel=0.05)
    reader.tap(ring, 2)
    assert reader.shown(1) == {}
    assert reader.complaints() == []


SPY = """
const words = window.words = [];
const write = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
  const {e, f} = this.getTransform();
  const box = this.measureText(text);
  const {width} = box;
  const at = {center: -width / 2, right: -width, end: -width}[this.textAlign] ?? 0;
  words.push({
    text, left: x + e + at, right: x + e + at + width,
    top: y + f - box.actualBoundingBoxAscent, bottom: y + f + box.actualBoundingBoxDescent,
    width: this.canvas.width, height: this.canvas.height,
  });
  return write.apply(this, arguments);
};
"""
"""Notes all words that are drawn, with their boxes [px]."""


def test_no_word_of_a_figure_is_cut_and_names_keep_apart(reader, tmp_path):
    limit = Rule(50.0, LIMIT, 'limit ±50 µm')
    late = Rule(0.98, LIMIT, 'the last moment', upright=True)
    names = Series('found', [20.0, 21.0, 22.0], AFTER, x=[0.5, 0.5, 0.51], kind='dots', text='123')
    x = np.linspace(0.0, 1.0, 50)
    line = Series('y', x, AFTER)
    jerk = Series('jerk', 9e3 * np.sin(9.0 * x), AFTER)
    panels = [
        Panel(x, Axis('offset', 'µm', high=51.0), [line, names], rules=[limit, late]),
        Panel(x, Axis('jerk', 'm/s³'), [jerk], share=0.2),
    ]
    figures = [Figure('Words', 'Some.', Chart(Axis('time', 's'), panels, height=1.7))]
    page = tmp_path / 'words.html'
    page.write_text(render_page(Page('Words', '', [Section('All', figures=figures)])))
    spy = reader.driver.execute_cdp_cmd('Page.addScriptToEvaluateOnNewDocument', {'source': SPY})
    reader.open(page, 400)
    words = reader.run('return window.words')
    reader.driver.execute_cdp_cmd('Page.removeScriptToEvaluateOnNewDocument', spy)
    for word in words:
        assert 0.0 <= word['left'] < word['right'] <= word['width'] + 1.0, word
        assert 0.0 <= word['top'] < word['bottom'] <= word['height'] + 1.0, word
    texts = [word['text'] for word in words]
    assert {'limit ±50 µm', 'the last moment', '1', '2', '3'} <= set(texts)
    assert texts.count('5000') == 1
    one, two, three = (next(word for word in words if word['text'] == name) for name in '123')
    for a, b in ((one, two), (two, three), (one, three)):
        beside = a['right'] <= b['left'] or b['right'] <= a['left']
        assert beside or a['bottom'] <= b['top'] or b['bottom'] <= a['top'], (a, b)
    heads = reader.run("return [...document.querySelectorAll('.head')].map(p => p.textContent)")
    assert heads == ['offset [µm]', 'jerk [m/s³]']
    read = "return [...document.querySelectorAll('.u-legend .u-value')].map(v => v.innerText)"
    assert not any(reader.run(read))  # where no cursor is


@pytest.mark.slow
def test_the_nearest_place_of_a_path_is_read(reader, drawn):
    reader.open(drawn)
    reader.wheel(reader.plot(1), -240.0)
    reader.hover(reader.plot(1), 0.3)
    said = reader.read(1)
    assert re.fullmatch(r'nearest: X \S+ mm, Y \S+ mm, contour error \S+ µm', said)
    rows = reader.data(1)
    assert len(rows) == 201
    assert float(rows[-1]['contour error [µm]']) == pytest.approx(30.0)
    assert (float(rows[50]['X [mm]']), float(rows[50]['Y [mm]'])) == pytest.approx((0.0, 30.0))


@pytest.mark.slow
def test_a_plane_keeps_its_scale_and_its_true_size(reader, drawn):
    reader.open(drawn)
    size = """const {width, height} = document.querySelector('#figure-3 .u-over')
        .getBoundingClientRect(); return [width, height]"""
    width, height = reader.run(size)
    reader.press(reader.plot(3), '+')
    x, y = reader.shown(3).values()
    pixels = width / (1.5 * np.ptp(x))
    assert pixels == pytest.approx(96.0 / 25.4, rel=5e-3)
    assert pixels == pytest.approx(height / (1.5 * np.ptp(y)), rel=0.02)


@pytest.mark.slow
def test_curves_are_zoomed_by_keys_wheel_and_fingers_and_one_finger_scrolls(reader, day):
    reader.open(day, width=400)
    plot = reader.plot(3)
    whole = reader.ends(3)
    reader.press(plot, '+')
    nearer = reader.ends(3)
    assert np.ptp(nearer) == pytest.approx(np.ptp(whole) / 1.5, rel=0.02)
    assert reader.ends(3, 4) == nearer  # panels go together
    reader.press(plot, Keys.ARROW_RIGHT)
    assert reader.ends(3)[0] > nearer[0]
    reader.press(plot, *5 * [Keys.ARROW_RIGHT])
    assert reader.ends(3)[1] == whole[1]
    reader.press(plot, '0')
    assert reader.ends(3) == reader.ends(3, 4) == whole
    plot = reader.plot(3)
    reader.wheel(plot, -240.0)
    assert np.ptp(reader.ends(3)) == pytest.approx(0.5 * np.ptp(whole), rel=0.02)
    reader.press(plot, '-', '-', '-')
    assert reader.ends(3) == whole
    reader.pinch(plot, (0.4, 0.6), (0.2, 0.8))
    assert np.ptp(reader.ends(3)) == pytest.approx(np.ptp(whole) / 3.0, rel=0.03)
    before = reader.ends(3)
    reader.pinch(plot, (0.3, 0.7), (0.5, 0.9))
    assert reader.ends(3)[0] < before[0]
    reader.tap(plot)
    reader.tap(plot)
    assert reader.ends(3)[0] < before[0]
    reader.tap(plot, 2)
    assert reader.ends(3) == reader.ends(3, 4) == whole
    assert reader.run('return visualViewport.scale') == 1  # the page itself was not zoomed
    for scroll in (lambda: reader.wheel(plot, 200.0, control=False), lambda: reader.swipe(plot)):
        before = reader.run('return scrollY')
        scroll()
        wait_for(lambda at=before: reader.run('return scrollY') > at, 'the page scrolls')
        assert reader.ends(3) == whole


@pytest.mark.slow
def test_points_are_zoomed_along_both_axes(reader, drawn):
    reader.open(drawn)
    plot = reader.plot(2)
    whole = reader.ends(2)
    reader.press(plot, '+', '+')
    low, high = reader.ends(2)
    assert whole[0] < low < high < whole[1]
    reader.press(plot, '0')
    assert reader.ends(2) == whole


@pytest.fixture(scope='module')
def recordings(tmp_path_factory, root):
    """A folder with runs of the simulated mill, a model, a program and samples."""
    from fuzzycnc_ros.cli.main import run

    folder = tmp_path_factory.mktemp('recordings')
    for name in ('part.ngc', 'samples.csv'):
        (folder / name).write_bytes((root / 'examples' / name).read_bytes())
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        simulate = (*COMMANDS['simulate'], '--report', 'simulate.html')
        assert run([*simulate, '--out', 'shift']) == 0
        assert run(['train', *RUNS, '--out', 'm.json']) == 0
    return folder


@pytest.mark.slow
@pytest.mark.parametrize('name', COMMANDS)
def test_each_kind_of_report_fits_all_screens(reader, recordings, name, monkeypatch):
    from fuzzycnc_ros.cli.main import run

    monkeypatch.chdir(recordings)
    page = recordings / f'{name}.html'
    if not page.is_file():
        assert run([*COMMANDS[name], OUT.get(name, '--report'), str(page)]) == 0
    assert page.stat().st_size <= SIZE_MAX
    check(reader, page)
    reader.open(page)
    for number in range(1, 1 + len(reader.driver.find_elements('css selector', 'figure'))):
        assert reader.data(number)
    live = reader.driver.find_elements('css selector', 'figure:has(.u-legend)')
    planes = 'figure:has(.u-over):not(:has(.u-legend))'
    for place in reader.driver.find_elements('css selector', planes):
        figure = int(place.get_attribute('id').removeprefix('figure-'))
        reader.press(reader.plot(figure), '+')
        assert reader.shown(figure)
    assert bool(live) == (name not in TABLES_ONLY)
    if not live:
        return
    figure = int(live[0].get_attribute('id').removeprefix('figure-'))
    low, high = reader.ends(figure)
    reader.drag(reader.plot(figure), 0.3, 0.7)
    nearer, farther = reader.ends(figure)
    assert low < nearer < farther < high
    read = reader.point_at(reader.plot(figure), 0.5)
    assert any(character.isdigit() for value in read.values() for character in value)
