# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Record the golden runs of `bags/` anew; `bags/README.md` says what each is for.

Run it only when a change of behaviour is meant: `test/replay` holds every component to what
these bags say.
"""

import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from fuzzycnc_ros.core.thermal.fit import train_model  # noqa: E402
from fuzzycnc_ros.studies.evaluated_graph import judged_graph  # noqa: E402
from fuzzycnc_ros.studies.published_bag import PublishedBag  # noqa: E402
from fuzzycnc_ros.studies.shift.axis_days import (  # noqa: E402
    CALIBRATION,
    WORK,
    day_parameters,
    machine_parameters,
)
from fuzzycnc_ros.studies.shift.shift_log import ShiftLog  # noqa: E402
from fuzzycnc_ros.studies.shift.thermal_shift import (  # noqa: E402
    record_calibration,
    run_shift,
    shift_components,
)

HOUR = 3600.0
GOLDEN = {
    'mill_warm_up': ((), HOUR),
    'mill_lost_sensors': (('{0}:dead:1200', '{1}:open:1800', '{2}:stuck:600'), HOUR),
}
"""Sensor faults of each run, by number of the chosen sensor, and how long it lasts [s]."""
ALONG = 'mill_axis'
"""The run whose error slopes along the axes."""
EXAMPLE = 'mill_warm_up'
"""The one that `examples/` holds too: a link would dangle in a copy of that folder."""


def along_the_axes() -> None:
    """Record an hour in which ball screws warm up, compensated along the axes."""
    screws = {
        **machine_parameters(('Y:fixed_free',)),
        'sensors': ('T5', 'T36', 'Y_bearing', 'Y_nut', 'Y_table'),
        'tick_period': 12.0,
    }
    calibration = record_calibration(CALIBRATION, 7, parameters={'simulated_machine': screws})
    model = train_model(calibration.runs, candidates=('static_ridge', 'lag_ridge'))
    given = day_parameters((WORK,), 7, probed=True, cautious=False)
    given['temperature_acquisition'] = {}
    given['simulated_machine'] |= {
        **screws,
        'duty_duration': HOUR,
        'displacement_interval': 1200.0,
    }
    machine, acquisition, _, predictor, compensator = shift_components(
        (WORK,), 7, parameters=given
    )
    path = ROOT / 'bags' / ALONG
    shutil.rmtree(path, ignore_errors=True)
    with PublishedBag(path) as bag:
        graph = judged_graph(machine, [acquisition, predictor, compensator], ShiftLog(), bag)
        graph.request('thermal_predictor', 'use_model', model=model.to_json())
        graph.request('compensator', 'activate')
        graph.run()
    size = sum(file.stat().st_size for file in path.iterdir())
    print(f'{path.relative_to(ROOT)}: {size / 1024:.0f} KiB')


def main() -> None:
    """Record all golden runs."""
    calibration = record_calibration(seed=7)
    model = train_model(calibration.runs)
    for name, (faults, duration) in GOLDEN.items():
        path = ROOT / 'bags' / name
        shutil.rmtree(path, ignore_errors=True)
        with PublishedBag(path) as bag:
            run_shift(
                model.to_json(),
                duties=('T2',),
                seed=7,
                faults=[text.format(*model.inputs) for text in faults],
                parameters={'simulated_machine': {'duty_duration': duration}},
                sink=bag,
            )
        size = sum(file.stat().st_size for file in path.iterdir())
        print(f'{path.relative_to(ROOT)}: {size / 1024:.0f} KiB')
    along_the_axes()
    shutil.copytree(ROOT / 'bags' / EXAMPLE, ROOT / 'examples' / EXAMPLE, dirs_exist_ok=True)


if __name__ == '__main__':
    main()
