# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import re
import sys
from html.parser import HTMLParser
from subprocess import run as start

import numpy as np
import pytest
from thermal_reports import mill_run, report

from fuzzycnc_ros import __version__
from fuzzycnc_ros.studies.thermal.report_data import ReportData
from fuzzycnc_ros.studies.thermal.report_page import report_page

pytest.importorskip('jinja2', reason='jinja2 is not installed')

from fuzzycnc_ros.studies.page.html import render_page
from fuzzycnc_ros.studies.thermal import report_page as plots


class Outline(HTMLParser):
    """Collects ids, links and open elements, and refuses what is not closed in order."""

    VOID = frozenset({'meta', 'br', 'hr', 'img', 'link', 'input'})

    def __init__(self, text):
        super().__init__()
        self.ids, self.links, self.tags, self.open = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        attributes = dict(attrs)
        self.ids += [attributes['id']] if 'id' in attributes else []
        self.links += [v for k, v in attrs if k in ('href', 'src', 'xlink:href')]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope='module')
def page():
    return render_page(report_page(report()))


def test_page_is_well_formed_and_self_contained(page):
    outline = Outline(page)
    assert outline.open == []
    assert len(outline.ids) == len(set(outline.ids))
    assert outline.links
    assert all(link.startswith('#') for link in outline.links)
    assert {link[1:] for link in outline.links} <= set(outline.ids)
    assert not {'link', 'img', 'iframe'} & set(outline.tags)
    assert 'url(http' not in page
    assert '@import' not in page


def test_every_figure_is_numbered_listed_and_explained(page):
    outline = Outline(page)
    assert outline.tags.count('figure') == 6
    assert re.findall(r'<b>Figure (\d)\.', page) == list('123456')
    for number in range(1, 7):
        assert f'href="#figure-{number}"' in page


def test_text_is_escaped(page):
    assert 'A shift of &lt;mill_1&gt;' in page
    assert 'One run &amp; its figures.' in page
    assert '<mill_1>' not in page


def test_figures_on_the_page_are_those_of_the_scores(page):
    run = mill_run()
    largest = 1e6 * np.abs(run.measured).max(axis=0)
    for channel, value in zip(run.channel, largest, strict=True):
        assert f'T2 {channel}, largest remaining error' in page
        assert f'of {value:.1f} µm' in page
        assert f'{0.1 * value:.1f} <small>µm</small>' in page
    assert 'sha256:abc' in page
    assert 'No safety function.' in page
    assert 'median 2.00 ms' in page


@pytest.mark.slow
def test_same_data_same_page(page):
    assert render_page(report_page(report())) == page


def test_optional_parts_may_be_missing():
    bare = mill_run(
        standard_deviation=None,
        in_domain=None,
        offset=None,
        applied=None,
        offset_limit=None,
        spindle_speed=None,
    )
    page = render_page(report_page(ReportData('Bare', [bare])))
    assert Outline(page).tags.count('figure') == 3
    assert 'Provenance' not in page
    assert f'<dt>fuzzycnc</dt><dd>{__version__}</dd>' in page
    with pytest.raises(ValueError, match='expected commanded offsets'):
        plots.compensation_chart(bare)


def test_gaps_and_divergence_do_not_break_the_page():
    measured = mill_run().measured.copy()
    measured[:, 1] = np.nan
    measured[10:20, 0] = np.nan
    diverged = np.full_like(measured, np.inf)
    run = mill_run(
        measured=measured, predicted={'classical_grey': diverged, 'lag_ridge': measured}
    )
    page = render_page(report_page(ReportData('Gaps', [run])))
    assert 'diverged' in page
    assert '<div class="from">of - µm</div>' in page
    lost = mill_run(predicted={'lag_ridge': diverged}, offset=None, applied=None)
    assert 'diverged <small>' in render_page(report_page(ReportData('Lost', [lost])))


def test_many_channels_get_rows_of_two():
    names = [f'ch{i}' for i in range(1, 6)]
    measured = np.tile(mill_run().measured[:, :1], (1, 5))
    run = mill_run(
        channel=names,
        measured=measured,
        predicted={'lag_ridge': measured},
        standard_deviation=None,
        offset=None,
        applied=None,
    )
    chart = plots.prediction_chart(run)
    assert (len(chart.panels), chart.columns) == (5, 2)


def test_temperatures_have_a_panel_per_cluster_and_one_for_the_speed():
    panels = plots.temperatures_chart(mill_run()).panels
    assert [panel.title for panel in panels] == [
        'Cluster 1: 32 sensors, T18 chosen',
        'Cluster 2: 29 sensors, T55 chosen',
        'Cluster 3: 12 sensors, T63 chosen',
        'Left out: 3 sensors',
        'Spindle speed',
    ]
    assert sum(len(panel.series) for panel in panels[:4]) == 76
    assert [s.name for panel in panels for s in panel.series if not s.quiet] == [
        'T18',
        'T55',
        'T63',
        'spindle speed',
    ]


def test_scale_is_set_by_what_was_measured():
    measured = mill_run().measured
    run = mill_run(predicted={'classical_grey': 1e6 * measured, 'lag_ridge': measured})
    assert plots.prediction_chart(run).panels[0].y_axis.high < 60.0


def test_one_sample_out_of_domain_shows():
    flag = plots.residual_chart(mill_run()).panels[0].series[-1]
    assert (flag.kind, np.flatnonzero(flag.y).tolist()) == ('flag', [100])


@pytest.mark.parametrize(
    ('seconds', 'label', 'last'),
    [(7200.0, 'min', 120.0), (7260.0, 'h', 7260 / 3600)],
)
def test_time_axis_reads_in_minutes_or_hours(seconds, label, last):
    values, text = plots.time_axis(np.array([100.0, 100.0 + seconds]))
    assert (values[0], text) == (0.0, label)
    assert values[1] == pytest.approx(last)


def test_importing_the_report_loads_neither_matplotlib_nor_jinja2():
    code = (
        'import sys, fuzzycnc_ros.studies.thermal.report_page;'
        "print([m for m in ('matplotlib', 'jinja2', 'rich') if m in sys.modules])"
    )
    answer = start([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == '[]'
