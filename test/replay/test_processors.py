# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of all scenarios replay identical, and are the same anew, on any processor."""

from pathlib import Path

import processors
import pytest
import recorded_scenarios
from kept import kept
from processors import OLDEST, SETTINGS, result_under
from recorded_scenarios import FORMS, GOLDEN, SCENARIOS, golden_model, record, replayed

from fuzzycnc_ros.cli.demo.contour import PATHS, TOLERANCE
from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.core.deformation.model import write_model
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
from fuzzycnc_ros.studies.contour.contouring import SETTLE, run_contouring
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.shift.learnt_days import learn_days
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration

SCRIPT = Path(recorded_scenarios.__file__)

pytestmark = pytest.mark.replay


@kept
def foam_model():
    return write_model(TSFuzzyNetwork().fit(*foam_samples(1000)).model_)


@kept
def thermal_model(name):
    runs = record_calibration(('D0', 'D0b', 'T1')).runs
    return train_model(runs, model=name, candidates=(name,)).to_json()


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """The models of all scenarios, and their bags with the hashes of what is in them."""
    models = tmp_path_factory.mktemp('scenarios')
    (models / 'golden.json').write_text(golden_model())
    (models / 'foam.json').write_text(foam_model())
    for name in FORMS:
        (models / f'{name}.json').write_text(thermal_model(name))
    made = {name: record(name, models, models / 'here' / name) for name in SCENARIOS}
    return models, made


@pytest.fixture(scope='module')
def expected(recorded):
    """Verdict and hash of the replay of each bag on this computer as it is."""
    models, made = recorded
    return {name: list(replayed(models / 'here' / name)) for name in made}


@pytest.mark.slow
def test_all_that_a_replay_needs_is_recorded(expected):
    for name, (identical, _) in expected.items():
        assert identical, name


@pytest.mark.slow
@pytest.mark.parametrize('settings', SETTINGS)
def test_every_bag_replays_identical(recorded, expected, settings):
    models, made = recorded
    bags = [str(models / 'here' / name) for name in made]
    found = result_under(SETTINGS[settings], SCRIPT, 'replay', *bags)
    assert dict(zip(made, found, strict=True)) == expected


@pytest.mark.slow
@pytest.mark.parametrize('settings', ['C library without FMA', 'oldest'])
def test_every_scenario_is_the_same_anew(recorded, settings):
    """Machines too, which no replay recomputes."""
    models, made = recorded
    folder = models / settings
    found = result_under(SETTINGS[settings], SCRIPT, 'record', str(folder), *made)
    assert dict(zip(made, found, strict=True)) == made


def test_a_bag_replays_identical_on_the_oldest_processor(tmp_path):
    """One of them all, in all settings at once; `slow` has the others."""
    bag = tmp_path / 'positioning'
    record('ballscrew', tmp_path, bag)
    expected = [list(replayed(bag)), list(replayed(GOLDEN))]
    assert expected[0][0]
    assert result_under(OLDEST, SCRIPT, 'replay', str(bag), str(GOLDEN)) == expected


def contour_of_the_demo(sink):
    scheduler = FeedrateSchedulerConfig(tolerance=TOLERANCE, settle=SETTLE)
    run_contouring(PATHS, scheduler, SimulatedMachineConfig(), sink=sink)


@pytest.mark.slow
@pytest.mark.parametrize('run', [contour_of_the_demo, lambda sink: learn_days(sink=sink)])
def test_the_hash_on_the_first_page_is_that_of_any_processor(tmp_path, run):
    """The demo over DDS gives the same as a run in one process."""
    bag = tmp_path / 'bag'
    with PublishedBag(bag) as sink:
        run(sink)
    ((identical, found),) = result_under(OLDEST, SCRIPT, 'replay', str(bag))
    assert identical
    page = Path(__file__).parents[2] / 'docs' / 'tutorials' / 'try-it.md'
    assert f'hash {found[:16]}\n' in page.read_text(encoding='utf-8')


def test_settings_change_how_this_computer_computes():
    """Else the matrix would compare one processor with itself."""
    script = Path(processors.__file__)
    usual = result_under({}, script)
    for kind, settings in (('C library', 'C library without FMA'), ('BLAS', 'BLAS for Prescott')):
        found = result_under(SETTINGS[settings], script)
        assert found[kind] != usual[kind], settings
