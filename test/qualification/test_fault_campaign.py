# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Every scenario of `make faults` on a live graph, judged by its bag.

The scenarios of a stage share a graph: the first test of a stage runs all of them.
"""

import pytest
from campaign.scenarios import STAGES
from campaign.stage import run_stage

QUICK = ('strangers', 'compensation')
"""Stages that `make test-all` runs; all of them take ten minutes."""

pytestmark = [pytest.mark.ros, pytest.mark.realtime]


def cases():
    """Yield stage and name of each scenario."""
    for stage in STAGES:
        marks = [pytest.mark.slow if stage.name in QUICK else pytest.mark.qualify]
        for scenario in stage.scenarios:
            yield pytest.param(stage, scenario.name, id=scenario.name, marks=marks)


@pytest.fixture(scope='module')
def verdicts():
    """Verdicts of all stages that have been run, by scenario."""
    return {}


@pytest.mark.parametrize(('stage', 'name'), list(cases()))
def test_ends_in_a_safe_state(stage, name, verdicts, domain, model_file, tmp_path, monkeypatch):
    """Within its stated time, and never beyond clamp or slew limit, in not one sample."""
    if name not in verdicts:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        found = run_stage(
            [scenario.name for scenario in stage.scenarios],
            lambda stage, scenario, done, total: None,
            model=model_file,
            folder=tmp_path / 'campaign',
            seed=1,
            domain=domain,
        )
        verdicts.update({verdict.name: verdict for verdict in found})
    verdict = verdicts[name]
    assert verdict.safe, vars(verdict)
    assert verdict.time_to_safe_s <= verdict.stated_s
