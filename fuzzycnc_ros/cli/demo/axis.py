# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `axis` of the demo: a day whose largest error lies along the axes, live over DDS."""

from pathlib import Path

from fuzzycnc_ros.cli.demo.live_run import day_specs, run_live
from fuzzycnc_ros.cli.demo.steps import Outcome, Steps

CANDIDATES = ('least_squares', 'static_ridge', 'lag_ridge', 'lag_ridge_speed')
"""Candidates of the demo: quick, and as good here as the rest."""


def axis(out: Path, seed: int, progress: Steps) -> Outcome:
    """Run the scenario; its replay is to be identical."""
    from fuzzycnc_ros.core.thermal.fit import train_model
    from fuzzycnc_ros.studies.shift.axis_days import (
        INTERVAL,
        PROBE_EVERY,
        SCREWS,
        WORK,
        axis_days,
        axis_line,
        axis_page,
        axis_table,
        calibrated,
        day_parameters,
    )
    from fuzzycnc_ros.studies.shift.shift_log import ShiftLog

    with progress.step('recorded two calibration runs, measured at both ends and the middle'):
        calibration = calibrated(seed)
    with progress.step('trained offset and slope of each axis'):
        model = train_model(calibration.runs, candidates=CANDIDATES, interval=INTERVAL)
        file = out / 'model.json'
        file.write_text(model.to_json(), encoding='utf-8')
    given = day_parameters((WORK,), seed, probed=True, cautious=False)
    given['thermal_predictor'] |= {'model': str(file)}
    given['compensator'] |= {'autostart': True}
    run = run_live(day_specs(given), f'ran the day {WORK}', out, progress)
    days = axis_days(ShiftLog.from_bag(out / 'bag'), (WORK,), SCREWS)
    result = {
        'axes': {item.axis: item.figures() for day in days for item in day},
        'model': dict(zip(model.channel, model.default, strict=True)),
        'wall_s': 0.0,
        **run._asdict(),
        'seed': seed,
    }
    facts = {
        'Machine': f'simulated mill with ball screws on Y and Z, duty {WORK}, noise seed {seed}',
        'Model': 'trained on two calibration runs; offset and slope of each axis',
        'Probes': f'at both ends of each axis, every {PROBE_EVERY / 60.0:g} min',
        **run.facts(),
    }
    return Outcome(
        result,
        lambda: axis_page(days, facts),
        (axis_table(days),),
        (axis_line(days), *run.lines()),
        run.problem(),
    )
