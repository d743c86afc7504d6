# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The fault campaign as tables."""

from collections.abc import Sequence

from campaign.scenario import Kind
from campaign.scenarios import chosen
from campaign.verdict import Verdict
from fuzzycnc_ros.studies.page.table import Column, Table

_FIGURES = {
    Kind.OFFSETS: ('Thermal compensation', 'largest offset', 'its largest step'),
    Kind.PATH: ('Axes on a path', 'off the path', 'largest step of the axes'),
    Kind.DRIVE: ('Driven axes', 'beyond their stretch', 'largest step of the axes'),
    Kind.PATTERN: ('Patterns', 'largest offset', 'its largest step'),
}
"""Title, worst distance and worst change of each kind; all are in docs/explanation/faults.md."""


def listing(names: Sequence[str]) -> Table:
    """Return the scenarios and what they state, all if none is named.

    Raises
    ------
    ValueError
        If a name is unknown.
    """
    columns = (
        Column('Scenario', numeric=False),
        Column('safe within [s]'),
        Column('ends', numeric=False),
        Column('What is done', numeric=False),
    )
    rows = tuple(
        (scenario.name, f'{scenario.stated:.3g}', scenario.ends.value, scenario.what)
        for stage in chosen(names)
        for scenario in stage.scenarios
    )
    return Table('Scenarios, times of the machine', columns, rows)


def result_tables(verdicts: Sequence[Verdict]) -> tuple[Table, ...]:
    """Return what came of scenarios, a table for each kind of machine."""
    return tuple(
        _result_table(kind, found)
        for kind in Kind
        if (found := [item for item in verdicts if item.kind == kind.value])
    )


def _result_table(kind: Kind, verdicts: Sequence[Verdict]) -> Table:
    title, distance, change = _FIGURES[kind]
    columns = (
        Column('Scenario', numeric=False),
        Column('safe', numeric=False),
        Column(f'{distance} [um]'),
        Column(f'{change} [um]'),
        Column('to safe [s]'),
        Column('stated [s]'),
        Column('lost'),
        Column('warnings'),
        Column('What the machine was told', numeric=False),
    )
    rows = tuple(
        (
            item.name,
            'yes' if item.safe else 'NO',
            f'{item.worst_offset_um:.2f}',
            f'{item.worst_step_um:.2f}',
            f'{item.time_to_safe_s:.3g}',
            f'{item.stated_s:.3g}',
            str(item.lost_messages),
            str(len(item.diagnostics)),
            _short(item.told),
        )
        for item in verdicts
    )
    unsafe = frozenset(row for row, item in enumerate(verdicts) if not item.safe)
    return Table(f'{title}: what came of faults', columns, rows, highlight=unsafe)


def _short(told: str, states: int = 5) -> str:
    words = told.split(' > ')
    return ' > '.join(words if len(words) <= states else [*words[: states - 1], '...', words[-1]])
