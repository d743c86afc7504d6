# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What is left along the travel of axes whose ball screws warm up.

python benchmarks/axis_travel.py        about two minutes
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.studies.shift.axis_days import (
    INTERVAL,
    WORK,
    calibrated,
    run_axis_days,
)

CANDIDATES = ('least_squares', 'static_ridge', 'lag_ridge', 'lag_ridge_speed')
SETTLED = 9000.0
"""Time from which figures of learning from nothing count [s]."""


def say(name: str, days: list, since: float = 0.0) -> None:
    """Print the figures of each axis and day."""
    for number, day in enumerate(days, 1):
        for item in day:
            values = item.figures(since)
            print(
                f'| {name}, day {number} | {item.axis} | {values["uncompensated_max_um"]:.1f} '
                f'| {values["best_line_max_um"]:.1f} | {values["left_max_um"]:.1f} '
                f'| {values["beyond_best_line_max_um"]:.1f} | {100 * values["in_band"]:.0f} '
                f'| {values["line_leaves_told_um"]:.1f} |',
                flush=True,
            )


def main() -> None:
    """Run all cases."""
    print(
        '| case | axis | uncompensated | best line | left | beyond it | in band % '
        '| best line, as told |'
    )
    print('|---|---|---|---|---|---|---|---|')
    for name, screws in (
        ('two calibration runs', ('Y:fixed_free', 'Z:fixed_free')),
        ('linear scales', ('Y:linear_scale', 'Z:linear_scale')),
    ):
        runs = calibrated(0, screws).runs
        model = train_model(runs, candidates=CANDIDATES, interval=INTERVAL)
        say(name, run_axis_days((WORK,), 3, model=model.to_json(), screws=screws))
        print(f'{name}: {dict(zip(model.channel, model.default, strict=True))}', file=sys.stderr)
    days = run_axis_days((WORK, WORK, WORK), 3, cautious=False)
    say('from nothing, two places an hour', days, SETTLED)
    places = (-0.5, -0.25, 0.0)
    short = run_axis_days(('axis_short',) * 2, 3, places=places, cautious=False)
    say('short stroke, three places an hour', short, SETTLED)


if __name__ == '__main__':
    main()
