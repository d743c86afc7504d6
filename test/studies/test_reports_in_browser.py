# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reports as a person sees them: in a browser, wide and narrow, light and dark."""

import re

import numpy as np
import pytest
from processes import wait_for
from report_browser import Reader, check
from thermal_reports import day_run, report

from fuzzycnc_ros.studies.contour.contouring_page import path_picture
from fuzzycnc_ros.studies.page.chart import ROWS_MAX, Axis, Chart, Panel, Rule, Series
from fuzzycnc_ros.studies.page.drawing import AFTER, LIMIT
from fuzzycnc_ros.studies.page.html import Figure, Page, Section, render_page
from fuzzycnc_ros.studies.thermal.comparison_page import residuals_picture
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
    'pareto': ('pareto', 'butterfly'),
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

BARS_ONLY = {'grinder'}
"""Reports without curves."""


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


BARS = {'a': 1e-6, 'b': 3e-6, 'c': 2e-6}
"""Residual of each model [m]."""

BESIDE = """
const group = document.querySelector('#figure-2 .screen [id$=view-1]');
const bar = group.querySelector(':scope > svg path').getBoundingClientRect();
const word = [...group.children].find(part => part.textContent.trim() === '2.0');
return word.getBoundingClientRect().left - bar.right;
"""
"""Asks how far the number of the first bar stands beside it."""

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
    # what is no chart has its numbers too
    latency = [float(row['latency [ms]']) for row in reader.data(6)]
    assert latency == pytest.approx(np.linspace(1.0, 3.0, 101))


def test_paper_and_readers_without_scripts_get_the_drawing(reader, day):
    reader.open(day)
    shown = """return ['.screen', '.paper'].map(
        part => document.querySelector(`#figure-3 ${part}`).checkVisibility())"""
    assert reader.run(shown) == [True, False]
    reader.driver.execute_cdp_cmd('Emulation.setEmulatedMedia', {'media': 'print'})
    assert reader.run(shown) == [False, True]
    reader.driver.execute_cdp_cmd('Emulation.setEmulatedMedia', {'media': ''})


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
    svg = reader.run("return document.querySelector('svg').textContent")
    assert '0.005' in svg
    assert '0.00\n' not in svg
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
    """A page with a path, with bars, and with a curve that is no course over x."""
    turn = np.linspace(0.0, 2.0 * np.pi, 201)
    point = 1e-3 * np.column_stack([40.0 * np.cos(turn), 30.0 * np.sin(turn)])
    error = 1e-6 * np.linspace(1.0, 30.0, 201)
    rows = {name: np.array([value, 2.0 * value]) for name, value in BARS.items()}
    axis = Axis('count', ticks=(1.0, 2.0, 3.0))
    points = Panel(np.array([1.0, 2.0, 3.0]), Axis('error', 'µm'), [DOTS])
    figures = [
        Figure('Path', 'A ring.', path_picture(point, error, 'XY', 20e-6)),
        Figure(
            'Bars', 'Three.', residuals_picture(['Y', 'Z'], rows, {name: name for name in BARS})
        ),
        Figure('Points', 'Three.', Chart(axis, [points])),
    ]
    page = tmp_path_factory.mktemp('drawn') / 'drawn.html'
    page.write_text(render_page(Page('Drawn', '', [Section('All', figures=figures)])))
    return page


def test_a_picture_is_zoomed_by_hand_keys_and_fingers(reader, drawn):
    reader.open(drawn)
    ring = reader.view(1)
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


@pytest.mark.slow
def test_a_picture_reads_the_nearest_place(reader, drawn):
    reader.open(drawn)
    reader.wheel(reader.view(1), -240.0)
    reader.hover(reader.view(1), 0.99)
    said = reader.read(1)
    assert re.fullmatch(r'nearest: X \S+ mm, Y \S+ mm, contour error \S+ µm', said)
    bars = reader.view(2, 1)
    reader.hover(bars, 0.7)
    assert reader.read(2) == 'nearest: model b, rmse 6 µm'
    beside = reader.run(BESIDE)
    reader.drag(bars, 0.2, 0.6)
    assert list(reader.shown(2)) == ['rmse']  # names stay
    assert reader.run(BESIDE) == pytest.approx(beside, abs=1.0)
    ticks = 'return [...document.querySelectorAll(`#figure-2 .screen [id*=ytick] text`)].length'
    assert reader.run(ticks) == len(BARS)


@pytest.mark.slow
def test_a_picture_keeps_widths_and_sizes_when_zoomed(reader, drawn):
    reader.open(drawn)
    bars = """const bar = document.querySelector('#figure-2 .screen svg svg path');
        return [getComputedStyle(bar).vectorEffect, bar.getBoundingClientRect().width]"""
    line = """const path = [...document.querySelectorAll('#figure-1 .screen svg svg path')].at(-1);
        const {vectorEffect, strokeWidth} = getComputedStyle(path);
        return [vectorEffect, strokeWidth, path.getBoundingClientRect().width]"""
    _, before = reader.run(bars)
    effect, width, length = reader.run(line)
    reader.press(reader.view(2), '+')
    reader.press(reader.view(1), '+')
    assert reader.run(bars)[1] > 1.4 * before
    assert reader.run(line)[:2] == [effect, width] == ['non-scaling-stroke', width]
    assert reader.run(line)[2] == pytest.approx(1.5 * length, rel=0.05)


@pytest.mark.slow
def test_paper_keeps_the_whole_picture(reader, drawn):
    reader.open(drawn)
    paper = "return document.querySelector('#figure-1 .paper svg').outerHTML"
    whole = reader.run(paper)
    reader.drag(reader.view(1), 0.25, 0.5)
    assert reader.run(paper) == whole
    reader.driver.execute_cdp_cmd('Emulation.setEmulatedMedia', {'media': 'print'})
    seen = """return ['.screen', '.paper'].map(
        part => document.querySelector(`#figure-1 ${part}`).checkVisibility())"""
    assert reader.run(seen) == [False, True]
    reader.driver.execute_cdp_cmd('Emulation.setEmulatedMedia', {'media': ''})


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
    plot = reader.plot(3)
    whole = reader.ends(3)
    reader.press(plot, '+', '+')
    low, high = reader.ends(3)
    assert whole[0] < low < high < whole[1]
    reader.press(plot, '0')
    assert reader.ends(3) == whole


@pytest.fixture(scope='module')
def recordings(tmp_path_factory, root):
    """A folder with runs of the simulated mill, a model, a program and samples."""
    from fuzzycnc_ros.cli.main import run

    folder = tmp_path_factory.mktemp('recordings')
    for name in ('part.ngc', 'samples.csv'):
        (folder / name).write_bytes((root / 'examples' / name).read_bytes())
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run(['simulate', '--duties', 'T2', '--out', 'shift']) == 0
        assert run(['train', *RUNS, '--out', 'm.json']) == 0
    return folder


@pytest.mark.slow
@pytest.mark.parametrize('name', COMMANDS)
def test_each_kind_of_report_fits_all_screens(reader, recordings, name, monkeypatch):
    from fuzzycnc_ros.cli.main import run

    monkeypatch.chdir(recordings)
    page = recordings / f'{name}.html'
    assert run([*COMMANDS[name], OUT.get(name, '--report'), str(page)]) == 0
    assert page.stat().st_size <= SIZE_MAX
    check(reader, page)
    reader.open(page)
    for number in range(1, 1 + len(reader.driver.find_elements('css selector', 'figure'))):
        assert reader.data(number)
    for picture in reader.driver.find_elements('css selector', 'figure:has(.over)'):
        figure = int(picture.get_attribute('id').removeprefix('figure-'))
        reader.press(reader.view(figure), '+')
        assert reader.shown(figure)
    live = reader.driver.find_elements('css selector', 'figure:has(.u-over)')
    assert bool(live) == (name not in BARS_ONLY)
    if not live:
        return
    figure = int(live[0].get_attribute('id').removeprefix('figure-'))
    low, high = reader.ends(figure)
    reader.drag(reader.plot(figure), 0.3, 0.7)
    nearer, farther = reader.ends(figure)
    assert low < nearer < farther < high
    read = reader.point_at(reader.plot(figure), 0.5)
    assert any(character.isdigit() for value in read.values() for character in value)
