# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a shop: which machine drifts, which model is stale, which sensor fails."""

from collections.abc import Callable, Sequence
from datetime import datetime, timezone
from math import isfinite, isnan
from typing import Any

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.studies.fleet.condition import (
    BAGS_MIN,
    CONFIDENCE,
    DOMAIN_MIN,
    FAILING,
    MONTH,
    STALE_RATIO,
    MissingHistory,
    ResidualHistory,
    ShopCondition,
    SlopeEstimate,
)
from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Rule, Series
from fuzzycnc_ros.studies.page.drawing import AFTER, INK, LIMIT, MUTED, WARNING
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table, case_table

SHOWN = 40
"""Rows of a table that a page and a terminal show; the JSON file has all."""

DRAWN = 6
"""Panels of a figure."""

DATED = 10**18
"""Time from which on a stamp is a date [ns]; simulated machines count from their start."""

_DAY = 86_400e9
_SURE = f'{CONFIDENCE:.0%}'.replace('%', ' %')


def shop_page(condition: ShopCondition, table: str) -> Page:
    """Return the page of a shop; `table` is the name of the file that it comes from."""
    drifts, stale, sensors, unjudged = shop_tables(condition)
    return Page(
        title='The machines of a shop',
        summary=summary_text(condition),
        sections=[
            Section(
                'Which machine drifts',
                tables=[drifts],
                remarks=[
                    'The trend is that of the residual, bag by bag: the slope of Theil '
                    f'and Sen, with an interval that holds at {_SURE} for all rows together. A '
                    'machine drifts where all of the interval is above zero. Bags that the model '
                    'was trained on do not count.',
                    *_cut(len(condition.drifts)),
                ],
                figures=_figures(
                    'What the model leaves, over time',
                    'A dot per bag. The line is the trend, red where it rises beyond chance; '
                    'dashed is the residual expected from training.',
                    [item for item in condition.drifts if len(item.rms)],
                    lambda item: _residual_panel(item, condition),
                    condition,
                ),
            ),
            Section(
                'Which model is stale',
                tables=[stale],
                remarks=[
                    'The newest bags are the newest quarter. A model is stale where their '
                    f'residual exceeds {STALE_RATIO:g} times that on held-out training '
                    f'samples, beyond chance; where less than {100 * DOMAIN_MIN:.0f} % of their '
                    'samples are in its domain and the share falls; or where it diverged. Then '
                    'train it anew on newer bags.',
                    *_cut(len(condition.stale)),
                ],
                figures=_figures(
                    'Share of the samples in the domain of the training, over time',
                    'A dot per bag. Where dots sink, the machine works outside the range of '
                    'the training.',
                    _one_per_model(condition.stale),
                    lambda item: _domain_panel(item, condition),
                    condition,
                ),
            ),
            Section(
                'Which sensor fails',
                tables=[sensors],
                remarks=[
                    f'A sensor fails where more than {100 * FAILING:.0f} % of its samples are '
                    'missing in the newest quarter of its bags. Other sensors stand in for it as '
                    'long as the model knows some that can; else a straight line bridges up to '
                    '20 min.',
                    *_cut(len(condition.sensors)),
                ],
                figures=_figures(
                    'Share of the samples that are missing, over time',
                    'A dot per bag, of the sensors that are missing most.',
                    [item for item in condition.sensors if item.missing.any()],
                    lambda item: _sensor_panel(item, condition),
                    condition,
                ),
            ),
            Section(
                'Bags that could not be judged',
                texts=[] if unjudged.rows else ['All bags were judged.'],
                tables=[unjudged] if unjudged.rows else [],
                remarks=_cut(len(condition.unjudged)),
            ),
        ],
        facts={
            'Recorded': _span(condition),
            'Machine': _listed(condition.machines),
            'Judged': f'{condition.bags} bags',
            'Table': table,
            'Computed by': 'fuzzycnc ' + ', '.join(condition.versions),
        },
    )


def summary_text(condition: ShopCondition) -> str:
    """Return how many machines drift, models are stale and sensors fail."""
    drifting = {item.machine for item in condition.drifts if item.trend.rises}
    stale = {(item.machine, item.model) for item in condition.stale if item.stale}
    models = {(item.machine, item.model) for item in condition.stale}
    failing = [item for item in condition.sensors if item.fails]
    bags = {item.bag for item in condition.unjudged}
    return (
        f'{len(drifting)} of {len(condition.machines)} machines drift beyond chance, '
        f'{len(stale)} of {len(models)} models are stale, {len(failing)} of '
        f'{len(condition.sensors)} sensors fail, {len(bags)} of {condition.bags} bags could not '
        'be judged. The most urgent comes first.'
    )


def shop_tables(condition: ShopCondition) -> tuple[Table, Table, Table, Table]:
    """Return the tables of drifts, models, sensors, and bags that could not be judged."""
    return (
        _drift_table(condition.drifts[:SHOWN]),
        _stale_table(condition.stale[:SHOWN]),
        _sensor_table(condition.sensors[:SHOWN]),
        _unjudged_table(condition),
    )


def shop_document(condition: ShopCondition) -> dict[str, Any]:
    """Return all figures.

    Returns
    -------
    dict
        `drifts`, `models`, `sensors`, `left_out`: lists, the most urgent first.
    """
    return {
        'bags': condition.bags,
        'machines': condition.machines,
        'drifts': [
            {
                'machine': item.machine,
                'model': item.model,
                'channel': item.channel,
                'bags': len(item.rms),
                'verdict': _drift_verdict(item),
                'slope_um_per_30_days': item.trend.slope,
                'low_um_per_30_days': item.trend.low,
                'high_um_per_30_days': item.trend.high,
                'newest_rms_um': item.newest_rms,
                'held_out_rms_um': item.held_out,
            }
            for item in condition.drifts
        ],
        'models': [
            {
                'machine': item.machine,
                'model': item.model,
                'channel': item.channel,
                'stale': item.stale,
                'ratio': item.ratio,
                'ratio_low': item.ratio_low,
                'newest_in_domain': item.newest_in_domain,
                'in_domain_per_30_days': item.domain_trend.slope,
                'diverged': item.diverged,
                'trained_on': item.trained,
            }
            for item in condition.stale
        ],
        'sensors': [
            {
                'machine': item.machine,
                'sensor': item.sensor,
                'fails': item.fails,
                'newest_missing': item.newest_missing,
                'missing': float(item.missing.mean()),
                'substituted': float(item.substituted.mean()),
                'bridged': float(item.bridged.mean()),
                'missing_per_30_days': item.trend.slope,
            }
            for item in condition.sensors
        ],
        'left_out': [
            {'machine': item.machine, 'bag': item.bag, 'reason': item.problem}
            for item in condition.unjudged
        ],
    }


def _drift_table(courses: Sequence[ResidualHistory]) -> Table:
    month = f'per {MONTH:.0f} days'
    return case_table(
        'Drift of the residual error',
        zip(courses),
        {
            Column('Machine', numeric=False): lambda item: item.machine,
            Column('Model', numeric=False): lambda item: item.model,
            Column('Channel', numeric=False): lambda item: item.channel,
            Column('Verdict', numeric=False): _drift_verdict,
            Column('bags'): lambda item: str(len(item.rms)),
            Column('days'): lambda item: f'{item.days:.0f}',
            Column('uncompensated [µm]', 'newest bags'): lambda item: _number(item.newest_bare, 1),
            Column('rms [µm]', 'newest bags'): lambda item: _number(item.newest_rms, 1),
            Column('trend [µm]', month): lambda item: _signed(item.trend.slope, 2),
            Column('interval [µm]', month): lambda item: _interval(item.trend, 2),
        },
        lambda item: (0, 3, 8) if item.trend.rises else (),
        warning_means='rises beyond chance',
    )


def _stale_table(courses: Sequence[ResidualHistory]) -> Table:
    in_domain, month = 'in domain', f'per {MONTH:.0f} days [%]'
    return case_table(
        'Residuals expected from training, and those of the newest bags',
        zip(courses),
        {
            Column('Machine', numeric=False): lambda item: item.machine,
            Column('Model', numeric=False): lambda item: item.model,
            Column('Channel', numeric=False): lambda item: item.channel,
            Column('Verdict', numeric=False): lambda item: 'stale' if item.stale else 'fits',
            Column('held out [µm]', 'rms'): lambda item: _number(item.held_out, 1),
            Column('newest [µm]', 'rms'): lambda item: _number(item.newest_rms, 1),
            Column('ratio', 'rms'): lambda item: _number(item.ratio, 2),
            Column('newest [%]', in_domain): lambda item: _number(
                100.0 * item.newest_in_domain, 0
            ),
            Column(month, in_domain): lambda item: _signed(100.0 * item.domain_trend.slope, 1),
            Column('diverged'): lambda item: str(item.diverged),
        },
        _stale_cells,
        warning_means='no longer fits',
    )


def _stale_cells(item: ResidualHistory) -> list[int]:
    told = {0: item.stale, 3: item.stale, 6: item.leaves_more, 7: item.leaves_domain}
    return [column for column, warns in {**told, 9: bool(item.diverged)}.items() if warns]


def _sensor_table(sensors: Sequence[MissingHistory]) -> Table:
    def percent(value: Any) -> str:
        return _number(100.0 * float(value), 1)

    month = f'per {MONTH:.0f} days [%]'
    return case_table(
        'Share of the samples of each sensor',
        zip(sensors),
        {
            Column('Machine', numeric=False): lambda item: item.machine,
            Column('Sensor', numeric=False): lambda item: item.sensor,
            Column('Verdict', numeric=False): lambda item: 'fails' if item.fails else 'works',
            Column('bags'): lambda item: str(len(item.missing)),
            Column('newest [%]', 'missing'): lambda item: percent(item.newest_missing),
            Column('all [%]', 'missing'): lambda item: percent(item.missing.mean()),
            Column(month, 'missing'): lambda item: _signed(100.0 * item.trend.slope, 1),
            Column('substituted [%]'): lambda item: percent(item.substituted.mean()),
            Column('bridged [%]'): lambda item: percent(item.bridged.mean()),
        },
        lambda item: (0, 2, 4) if item.fails else (),
        warning_means='missing in the newest bags',
    )


def _unjudged_table(condition: ShopCondition) -> Table:
    return case_table(
        f'Not judged: {len(condition.unjudged)}',
        zip(condition.unjudged[:SHOWN]),
        {
            Column('Machine', numeric=False): lambda item: item.machine,
            Column('Bag', numeric=False): lambda item: item.bag,
            Column('Reason', numeric=False): lambda item: item.problem,
        },
    )


def _drift_verdict(item: ResidualHistory) -> str:
    if isnan(item.trend.slope):
        return f'fewer than {BAGS_MIN} bags'
    if item.trend.rises:
        return 'drifts'
    return 'gets better' if item.trend.falls else 'steady'


def _figures(
    title: str,
    caption: str,
    courses: Sequence[Any],
    panel: Callable[[Any], Panel],
    condition: ShopCondition,
) -> list[Figure]:
    """Return a figure of the most urgent courses; none where there are none."""
    shown = courses[:DRAWN]
    if not shown:
        return []
    chart = Chart(
        Axis(f'time since {_start(condition)}', 'd'),
        [panel(item) for item in shown],
        columns=min(2, len(shown)),
        height=2.6,
    )
    return [Figure(title, caption, chart)]


def _residual_panel(item: ResidualHistory, condition: ShopCondition) -> Panel:
    days = _days(item.begin, condition)
    series = [
        Series('with the model', item.rms, AFTER, kind='dots'),
    ]
    known = np.isfinite(item.rms)
    if isfinite(item.trend.slope):
        slope = item.trend.slope / MONTH
        middle = float(np.median(item.rms[known])) - slope * float(np.median(days[known]))
        ends = days[[0, -1]]
        colour = LIMIT if item.trend.rises else INK
        series.append(Series('trend', middle + slope * ends, colour, 2.0, x=ends))
    rules = [Rule(item.held_out, MUTED, 'promised', (4.0, 3.0))]
    axis = Axis('rms', 'µm', low=0.0, high=_top(item.rms[known], item.held_out))
    return Panel(days, axis, series, title=_title(item), rules=rules)


def _domain_panel(item: ResidualHistory, condition: ShopCondition) -> Panel:
    colour = WARNING if item.newest_in_domain < DOMAIN_MIN else AFTER
    return Panel(
        _days(item.begin, condition),
        Axis('in domain', '%', low=0.0, high=105.0),
        [Series('samples in the domain', 100.0 * item.in_domain, colour, kind='dots')],
        title=f'{item.machine}, {item.model}',
        rules=[Rule(100.0 * DOMAIN_MIN, MUTED, '', (4.0, 3.0))],
    )


def _sensor_panel(item: MissingHistory, condition: ShopCondition) -> Panel:
    colour = LIMIT if item.fails else AFTER
    return Panel(
        _days(item.begin, condition),
        Axis('missing', '%', low=0.0, high=_top(100.0 * item.missing, 1.0)),
        [Series('samples that are missing', 100.0 * item.missing, colour, kind='dots')],
        title=f'{item.machine}, {item.sensor}',
    )


def _one_per_model(courses: Sequence[ResidualHistory]) -> list[ResidualHistory]:
    """Return the first course of each model: all channels share the domain."""
    first: dict[tuple[str, str], ResidualHistory] = {}
    for item in courses:
        if len(item.rms):
            first.setdefault((item.machine, item.model), item)
    return list(first.values())


def _title(item: ResidualHistory) -> str:
    return f'{item.machine}, {item.model}, {item.channel}: {_drift_verdict(item)}'


def _top(values: Array, least: float) -> float:
    """Return the end of an axis that a few odd bags may leave."""
    high = float(np.percentile(values, 99.0)) if len(values) else 0.0
    return 1.25 * max(high, least)


def _days(begin: Array, condition: ShopCondition) -> Array:
    return np.asarray((begin - float(condition.first)) / _DAY)


def _start(condition: ShopCondition) -> str:
    return _date(condition.first) if condition.first >= DATED else 'the first bag'


def _span(condition: ShopCondition) -> str:
    if condition.first < DATED:
        return 'in machine time, without a date'
    return f'{_date(condition.first)} to {_date(condition.last)}'


def _date(stamp: int) -> str:
    return datetime.fromtimestamp(stamp // 10**9, timezone.utc).strftime('%Y-%m-%d')


def _listed(names: Sequence[str]) -> str:
    if len(names) <= DRAWN:
        return ', '.join(names)
    return f'{", ".join(names[:DRAWN])} and {len(names) - DRAWN} more'


def _cut(count: int) -> list[str]:
    """Return that a table shows not all, where it does."""
    return [f'The {SHOWN} most urgent of {count} are shown.'] if count > SHOWN else []


def _number(value: float, digits: int) -> str:
    return f'{value:.{digits}f}' if isfinite(value) else '-'


def _signed(value: float, digits: int) -> str:
    return f'{value:+.{digits}f}' if isfinite(value) else '-'


def _interval(found: SlopeEstimate, digits: int) -> str:
    if isnan(found.low):
        return '-'
    return f'{found.low:+.{digits}f} to {found.high:+.{digits}f}'
