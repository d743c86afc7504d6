# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a table says of a shop: drifts beyond chance, stale models, failing sensors, the page."""

from math import inf, isnan

import numpy as np
import pytest
from fleet_bags import DAY, FIRST_DAY

from fuzzycnc_ros.studies.fleet.condition import STRETCHES, shop_condition, trend
from fuzzycnc_ros.studies.fleet.shop_page import shop_document, shop_page, shop_tables
from fuzzycnc_ros.studies.page.html import render_page


def rows_of(machine, rms, **cells):
    """Return the rows of a machine, a bag a day; a cell may differ by bag."""
    found = []
    for day, value in enumerate(rms):
        row = {
            'bag': f'{machine}/{day}', 'path': f'archive/{machine}/{day}', 'machine': machine,
            'begin': FIRST_DAY + day * DAY, 'model': 'mill', 'model_hash': 'a', 'channel': 'y',
            'rms_um': float(value), 'uncompensated_rms_um': 12.0, 'held_out_rms_um': 2.0,
            'in_domain': 0.98, 'trained_on': 0.0, 'sensors': [], 'version': '0.1.0+a',
            'problem': None,
        }  # fmt: skip
        own = {key: item[day] if isinstance(item, list) else item for key, item in cells.items()}
        found.append(row | own)
    return found


def noise(seed, count=60):
    return 2.0 + 0.2 * np.random.default_rng(seed).standard_normal(count)


def shares(missing):
    return [{'sensor': 'rear', 'missing': missing, 'substituted': missing, 'bridged': 0.0}]


def test_a_trend_holds_the_true_slope_and_stands_odd_bags():
    days = np.arange(200)
    begin = FIRST_DAY + days * float(DAY)
    values = 2.0 + 0.01 * days + 0.2 * np.random.default_rng(3).standard_normal(200)
    values[[20, 90, 91]] = 80.0
    found = trend(begin, values)
    assert found.low < 0.3 < found.high
    assert found.slope == pytest.approx(0.3, abs=0.08)
    assert found.rises
    assert not found.falls
    assert trend(begin, -values).falls
    wide = trend(begin, values, 100)
    assert wide.low < found.low
    assert wide.high > found.high


def test_intervals_hold_for_all_machines_together():
    """Of shops in which nothing drifts at most one in twenty raises an alarm, give or take."""
    begin = FIRST_DAY + np.arange(40) * float(DAY)
    alarms = 0
    for seed in range(60):
        values = np.random.default_rng(seed).standard_normal((10, 40))
        found = [trend(begin, own, 10) for own in values]
        alarms += any(item.rises or item.falls for item in found)
    assert alarms <= 8


def test_many_bags_are_pooled():
    count = 10 * STRETCHES
    begin = FIRST_DAY + np.arange(count) * float(DAY)
    found = trend(begin, 1e-3 * np.arange(count))
    assert found.slope == pytest.approx(0.03)


@pytest.mark.parametrize('count', [0, 1, 7])
def test_few_bags_have_no_trend(count):
    begin = FIRST_DAY + np.arange(count) * float(DAY)
    assert isnan(trend(begin, np.arange(float(count))).slope)
    assert isnan(trend(np.full(20, float(FIRST_DAY)), np.arange(20.0)).slope)


@pytest.fixture
def shop():
    """A shop with one of each trouble."""
    days = np.arange(60)
    domain = list(np.clip(1.0 - 0.01 * days, 0.0, 1.0))
    failing = [shares(0.3 if day > 45 else 0.0) for day in days]
    broken = rows_of('mill_6', [0.0], channel=None, rms_um=None, problem='mill: too <slow>')
    return shop_condition(
        [
            *rows_of('mill_1', noise(1)),
            *rows_of('mill_2', noise(2) + 0.05 * days),
            *rows_of('mill_3', noise(3), in_domain=domain),
            *rows_of('mill_4', noise(4), sensors=failing),
            *rows_of('mill_5', [2.0] * 9 + [inf]),
            *broken,
        ]
    )


def test_the_most_urgent_comes_first(shop):
    assert shop.drifts[0].machine == 'mill_2'
    assert [item.machine for item in shop.drifts if item.trend.rises] == ['mill_2']
    assert shop.drifts[0].trend.slope == pytest.approx(1.5, abs=0.2)
    stale = [item.machine for item in shop.stale if item.stale]
    assert stale == ['mill_5', 'mill_2', 'mill_3']
    assert [item.machine for item in shop.sensors if item.fails] == ['mill_4']
    assert shop.sensors[0].newest_missing == pytest.approx(0.28)
    assert [(item.machine, item.problem) for item in shop.unjudged] == [
        ('mill_6', 'mill: too <slow>')
    ]
    assert (shop.bags, len(shop.machines)) == (251, 6)


def test_bags_that_the_model_was_trained_on_tell_no_drift():
    days = np.arange(40)
    rms = np.where(days < 12, 0.5, noise(5, 40))
    seen = [1.0 if day < 12 else 0.0 for day in days]
    (course,) = shop_condition(rows_of('mill_1', rms, trained_on=seen)).drifts
    assert (course.trained, len(course.rms)) == (12, 28)
    assert not course.trend.rises
    (course,) = shop_condition(rows_of('mill_1', rms)).drifts
    assert course.trend.rises
    (course,) = shop_condition(rows_of('mill_1', rms, trained_on=1.0)).drifts
    assert (len(course.rms), course.stale) == (0, False)


def test_tables_and_document_say_the_same(shop):
    drifts, stale, sensors, unjudged = shop_tables(shop)
    assert drifts.rows[0][:4] == ('mill_2', 'mill', 'y', 'drifts')
    assert stale.rows[0][0] == 'mill_5'
    assert sensors.rows[0][:3] == ('mill_4', 'rear', 'fails')
    assert unjudged.rows == (('mill_6', 'mill_6/0', 'mill: too <slow>'),)
    document = shop_document(shop)
    assert document['drifts'][0]['slope_um_per_30_days'] == shop.drifts[0].trend.slope
    assert [item['stale'] for item in document['models']] == [True] * 3 + [False] * 2


@pytest.mark.slow
def test_the_page_says_how_many(shop):
    pytest.importorskip('jinja2', reason='jinja2 is not installed')
    text = render_page(shop_page(shop, 'shop.parquet'))
    assert '1 of 6 machines drift beyond chance, 3 of 5 models are stale' in text
    assert '1 of 1 sensors fail, 1 of 251 bags could not be judged' in text
    assert 'too &lt;slow&gt;' in text
    assert '2026-01-05 to 2026-03-05' in text


def test_sensors_come_in_counting_order_and_nothing_unjudged_is_no_table():
    names = ('t10', 't2', 't1')
    sensors = [
        [{'sensor': name, 'missing': 0.1, 'substituted': 0.0, 'bridged': 0.0} for name in names]
        for _ in range(60)
    ]
    found = shop_condition(rows_of('mill', noise(1), sensors=sensors))
    page = shop_page(found, 'shop.parquet')
    assert [row[1] for row in page.sections[2].tables[0].rows] == ['t1', 't2', 't10']
    assert not page.sections[3].tables
    assert page.sections[3].texts == ['All bags were judged.']


def test_an_empty_table_is_refused():
    with pytest.raises(ValueError, match='expected rows'):
        shop_condition([])
