# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reports as a person sees them: in a browser, wide and narrow, light and dark."""

import numpy as np
import pytest
from report_browser import browser, check
from thermal_reports import day_run, report

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
    'schedule': ('schedule', 'part.ngc', '--tolerance', '20um', '--out', 'out.ngc'),
    'advise': ('advise', 'part.ngc', '--tolerance', '20um'),
    'pareto': ('pareto', 'butterfly'),
    'position': ('position', '--to', '-50mm'),
    'servo': ('servo', 'compare', '--moves', '0', '--controllers', 'variable_universe,pid'),
    'stability': ('servo', 'stability'),
    'foam': ('foam', 'demo', '--runs', '1'),
    'samples': ('foam', 'train', 'samples.csv', '--out', 'foam.json'),
    'thermal test': ('report', 'thermal', 'shift_calibration/D0'),
}
"""A command of each kind of report."""

OUT = {'thermal test': '--out'}
"""Option that names the page, where it is another one than --report."""

BARS_ONLY = {'grinder'}
"""Reports without curves: they have data, but nothing to zoom into."""


@pytest.fixture(scope='module')
def reader(tmp_path_factory):
    with browser(tmp_path_factory.mktemp('browser')) as found:
        yield found


@pytest.fixture(scope='module')
def run():
    return day_run()


@pytest.fixture(scope='module')
def day(run, tmp_path_factory):
    page = tmp_path_factory.mktemp('day') / 'day.html'
    facts = {'Recorded': '2026-03-02 06:00 UTC', 'Machine': 'mill', 'Bag': 'monday'}
    page.write_text(render_page(report_page(report(runs=[run], facts=facts))), encoding='utf-8')
    return page


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
    live = reader.driver.find_elements('css selector', 'figure.live')
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
