# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""All scenarios that record a bag, and their hashes, for processes with other settings.

As a script, with JSON to standard output: `replay BAG...` gives verdict and hash of the replay of
each bag, `record FOLDER NAME...` the canonical hash of each scenario, recorded anew with the
models in a folder.
"""

import json
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from benches.positioning_run import PositioningError, run_positioning

from fuzzycnc_ros.bags.canonical import combined_hash, topic_hashes
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.servo.servo_controller_config import ServoControllerConfig
from fuzzycnc_ros.core.servo.axis_control import FOR_USE
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.runtime.graph import Sink
from fuzzycnc_ros.studies.contour.contouring import run_contouring
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.shift.axis_days import run_axis_days
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration, run_shift
from fuzzycnc_ros.studies.shift.whole_shift import ShiftSettings, run_whole_shift
from fuzzycnc_ros.studies.soft.pattern import run_patterns

PATTERNS = ('parallelogram:45:base=0.024:side=0.018', 'calibration:2')
GOLDEN = Path(__file__).parents[2] / 'bags' / 'mill_warm_up'
HOUR = {'simulated_machine': {'duty_duration': 3600.0}}
PROBED = {'learn': True, 'probe_interval_min': 600.0}

Scenario = Callable[[Path, Sink], object]
"""Runs with the models in a folder and tells everything to a sink."""


def golden_model() -> str:
    """Return the text of the model in a golden bag, which nothing has to train."""
    with BagReader(GOLDEN) as reader:
        events = [item.message for item in reader.messages(['/mill/node_event'])]
    (request,) = (event.request for event in events if event.name == 'use_model')
    return str(json.loads(request)['model'])


def _contour(method: str) -> Scenario:
    scheduler = FeedrateSchedulerConfig(tolerance=1e-4, settle=0.25, method=method)
    machine = SimulatedMachineConfig(path_timeout=2.0)
    return lambda models, sink: run_contouring(('trident',), scheduler, machine, sink=sink)


def _positioning(controller: str) -> Scenario:
    servo = ServoControllerConfig(controller=controller)

    def run(models: Path, sink: Sink) -> None:
        # Two of them, as published, stop short of the place: their bags are as good.
        with suppress(PositioningError):
            run_positioning(('X:-0.01',), servo, sink=sink)

    return run


def _ballscrew(models: Path, sink: Sink) -> object:
    servo = ServoControllerConfig(axes=('Z:ballscrew',))
    return run_positioning(('Z:0.01',), servo, sink=sink)


def _pattern(models: Path, sink: Sink) -> object:
    return run_patterns(PATTERNS, (models / 'foam.json').read_text(), sink=sink)


def _thermal(model: str) -> Scenario:
    parameters = {**HOUR, 'thermal_predictor': PROBED}

    def run(models: Path, sink: Sink) -> object:
        text = (models / f'{model}.json').read_text()
        faults = ('T1:dead:1200', 'T5:open:1800')
        return run_shift(text, duties=('T2',), faults=faults, parameters=parameters, sink=sink)

    return run


def _selection(models: Path, sink: Sink) -> object:
    folder = models / 'calibration'
    calibration = record_calibration(('D0', 'T1'), folder=folder if not folder.exists() else None)
    bags = tuple(str(folder / name) for name in ('D0', 'T1'))
    text = (models / 'golden.json').read_text()
    found = type(calibration)(calibration.runs, bags)
    return run_shift(text, found, ('T2',), parameters=HOUR, sink=sink)


def _shift(models: Path, sink: Sink) -> object:
    jobs = ('1200:path:trident', '1800:move:X:0.01,Z:-0.005')
    settings = ShiftSettings(jobs=jobs, duration=2400.0)
    return run_whole_shift((models / 'golden.json').read_text(), settings, sink=sink)


def _learnt(models: Path, sink: Sink) -> object:
    """Learn from probes alone: offset and slope of each axis and the growth of its screw."""
    return run_axis_days(('axis_work',), cautious=False, sink=sink)


METHODS = ('log_fuzzy', 'fuzzy', 'constant', 'normal_acceleration', 'chord_error')
FORMS = ('lag_ridge', 'stable_grey', 'grey_anfis', 'hybrid_network_speed')

SCENARIOS: dict[str, Scenario] = {
    'thermal golden': _thermal('golden'),
    'contour log_fuzzy': _contour('log_fuzzy'),
    'positioning suited': _positioning('suited'),
    'pattern': _pattern,
    'selection': _selection,
    'shift': _shift,
    'ballscrew': _ballscrew,
    'learnt along axes': _learnt,
    **{f'contour {method}': _contour(method) for method in METHODS},
    **{f'positioning {name}': _positioning(name) for name in FOR_USE},
    **{f'thermal {form}': _thermal(form) for form in FORMS},
}


def record(name: str, models: Path, bag: Path) -> str:
    """Record a scenario; return the hash of all that is in its bag."""
    with PublishedBag(bag) as sink:
        SCENARIOS[name](models, sink)
    return combined_hash(topic_hashes(bag))


def replayed(bag: Path | str) -> tuple[bool, str]:
    """Return whether a bag is recomputed as it is, and the hash."""
    report = replay(bag)
    return report.identical, report.hash


if __name__ == '__main__':
    if sys.argv[1] == 'replay':
        print(json.dumps([replayed(bag) for bag in sys.argv[2:]]))
    else:
        folder = Path(sys.argv[2])
        made = [record(name, folder.parent, folder / name) for name in sys.argv[3:]]
        print(json.dumps(made))
