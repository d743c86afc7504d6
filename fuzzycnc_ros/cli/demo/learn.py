# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `learn` of the demo: three days from no model at all, with a probe an hour."""

from pathlib import Path

from fuzzycnc_ros.cli.demo.live_run import day_specs, run_live
from fuzzycnc_ros.cli.demo.steps import Outcome, Steps


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
    run = run_live(day_specs(given), f'ran the days {", ".join(DAYS)}', out, progress)
    days = learnt_days(ShiftLog.from_bag(out / 'bag'), DAYS)
    result = {
        'days': {day.name: day.figures() for day in days},
        'probe_every_s': EVERY,
        'wall_s': 0.0,
        **run._asdict(),
        'seed': seed,
    }
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
