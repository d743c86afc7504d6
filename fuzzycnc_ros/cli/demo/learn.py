# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `learn` of the demo: three days from no model at all, with a probe an hour."""

from dataclasses import dataclass
from pathlib import Path

from fuzzycnc_ros.cli.demo.steps import Outcome, Steps
from fuzzycnc_ros.cli.demo.whole_days import run_days


@dataclass
class LearnResult:
    """Figures of the demo, as written to `summary.json`."""

    days: dict[str, dict[str, dict[str, float]]]
    probe_every_s: float
    wall_s: float
    hash: str
    replay_identical: bool
    degraded: bool
    ticks: int
    ticks_per_second: float
    seed: int


def learn(out: Path, seed: int, progress: Steps) -> Outcome:
    """Run the scenario; its replay is to be identical."""
    from fuzzycnc_ros.studies.shift.learnt_days import (
        DAYS,
        EVERY,
        NOISE,
        days_line,
        days_page,
        days_table,
        learning_parameters,
        learnt_days,
    )
    from fuzzycnc_ros.studies.shift.shift_log import ShiftLog

    given = learning_parameters(DAYS, seed)
    given['compensator'] |= {'autostart': True}
    run = run_days(given, f'days {", ".join(DAYS)}', out, progress)
    days = learnt_days(ShiftLog.from_bag(out / 'bag'), DAYS)
    result = LearnResult(
        days={day.name: day.figures() for day in days},
        probe_every_s=EVERY,
        wall_s=0.0,
        seed=seed,
        **run._asdict(),
    )
    facts = {
        'Machine': f'simulated mill, duties {", ".join(DAYS)}, noise seed {seed}',
        'Model': 'none; all of the error is learnt',
        'Probes': f'every {EVERY / 60.0:g} min, {1e6 * NOISE:g} µm of noise',
        **run.facts(),
    }
    return Outcome(
        result,
        lambda: days_page(days, facts),
        (days_table(days),),
        (days_line(days), *run.lines()),
        run.problem(),
    )
