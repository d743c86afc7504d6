# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rules learnt from the published recording and from our own [long2014]."""

from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.params import VariableUniverseParams
from fuzzycnc_ros.core.servo.pid_cascade import PidController
from fuzzycnc_ros.core.servo.rule_learning import learn_rules, records_of_run
from fuzzycnc_ros.core.servo.rule_table import SETS, RuleTableWarning, published_rules
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.simulation.servo.axes import LatheAxis
from fuzzycnc_ros.simulation.servo.positioning import position

pytestmark = pytest.mark.paper

# Table 1 of the source: e, ec, rho for references of -190, -50, 50 and 190 mm, every 0.1 s
TABLE_1 = """
-1.000 0.000 0.000 -0.264 0.000 0.000 0.264 0.000 0.000 1.000 0.000 0.000
-0.932 0.497 1.000 -0.208 0.423 0.343 0.211 0.420 -0.345 0.932 0.497 -1.000
-0.801 0.965 0.921 -0.152 0.412 0.332 0.149 0.419 -0.330 0.808 0.959 -0.925
-0.670 0.956 0.735 -0.119 0.253 0.257 0.110 0.259 -0.249 0.672 0.952 -0.738
-0.554 0.857 0.721 -0.084 0.255 0.156 0.080 0.251 -0.159 0.561 0.855 -0.724
-0.448 0.773 0.702 -0.060 0.179 0.127 0.060 0.174 -0.128 0.451 0.775 -0.706
-0.352 0.699 0.662 -0.038 0.161 0.084 0.036 0.164 -0.082 0.348 0.695 -0.670
-0.289 0.463 0.509 -0.025 0.096 0.073 0.021 0.099 -0.071 0.292 0.465 -0.511
-0.224 0.470 0.326 -0.014 0.081 0.062 0.010 0.082 -0.061 0.217 0.475 -0.318
-0.168 0.412 0.287 -0.008 0.044 0.036 0.005 0.034 -0.032 0.161 0.414 -0.282
-0.118 0.368 0.234 -0.005 0.022 0.031 0.002 0.021 -0.029 0.122 0.370 -0.233
-0.075 0.316 0.143 -0.002 0.021 0.022 0.001 0.009 -0.012 0.069 0.326 -0.131
-0.056 0.142 0.112 -0.001 0.007 0.013 0.000 0.002 0.000 0.051 0.141 -0.107
-0.038 0.132 0.086 0.000 0.001 0.000 0.000 0.001 0.000 0.035 0.124 -0.088
-0.023 0.113 0.070 0.000 0.000 0.000 0.000 0.000 0.000 0.021 0.110 -0.068
-0.011 0.086 0.052 0.000 0.001 0.000 0.000 0.001 0.000 0.010 0.081 -0.054
-0.006 0.038 0.033 0.000 0.000 0.000 0.000 0.000 0.000 0.005 0.035 -0.032
-0.002 0.031 0.021 0.000 0.001 0.000 0.000 0.001 0.000 0.002 0.027 -0.018
-0.001 0.007 0.009 0.000 0.000 0.000 0.000 0.000 0.000 0.001 0.006 -0.008
0.000 0.001 0.000 0.000 0.000 0.000 0.000 0.001 0.000 0.000 0.000 0.000
0.000 0.000 0.000 0.000 0.001 0.000 0.000 0.000 0.000 0.000 0.000 0.000
"""


def table_1(*, signs_restored=True):
    """Records of Table 1, one reference after the other, shape (84, 3)."""
    table = np.array(TABLE_1.split(), dtype=float).reshape(21, 4, 3)
    if signs_restored:
        table[:, 2:, 1] *= -1.0  # the rate's sign is lost for positive references
    return table.transpose(1, 0, 2).reshape(-1, 3)


def agreeing(rules):
    known = np.isfinite(rules.values)
    return int((np.abs(rules.values - np.array(published_rules().values)) < 0.02)[known].sum())


def test_wang_mendel_on_table_1():
    rules = learn_rules(table_1())
    assert rules.used == 59
    found = {
        (SETS[i], SETS[j]): (round(rules.values[i, j], 2), round(rules.strength[i, j], 3))
        for i, j in np.argwhere(rules.count)
    }
    assert found == {
        ('NB', 'PS'): (1.0, 0.404),
        ('NM', 'PB'): (0.67, 0.696),
        ('NS', 'PS'): (0.33, 0.570),
        ('NS', 'PM'): (0.67, 0.833),
        ('PS', 'NM'): (-0.67, 0.875),
        ('PS', 'NS'): (-0.33, 0.576),
        ('PM', 'NB'): (-0.67, 0.674),
        ('PB', 'NS'): (-1.0, 0.404),
    }
    assert rules.coverage == 8 / 36
    assert agreeing(rules) == 6
    winners = [
        divmod(int(rules.winner[cell]), 21) for cell in np.ndindex(6, 6) if rules.count[cell]
    ]
    assert winners == [(0, 1), (0, 3), (1, 1), (0, 6), (3, 6), (2, 1), (3, 3), (3, 1)]


def test_wang_mendel_on_the_signs_as_printed():
    rules = learn_rules(table_1(signs_restored=False))
    assert np.count_nonzero(rules.count) == 8
    assert agreeing(rules) == 5


def test_least_squares_reproduces_table_1_better_than_the_published_rules():
    records = table_1()
    error, rate, duty = records.T

    def rms(table):
        return np.sqrt(np.mean((table.surface(error, rate) - duty) ** 2))

    with pytest.warns(RuleTableWarning, match='never rise'):
        learnt = learn_rules(records, 'lsq').table()
    assert learnt.is_odd
    assert rms(learnt) < 0.03  # 0.024 in a prototype
    assert rms(learnt) < rms(published_rules()) / 5.0


def test_rules_learnt_from_a_recorded_pid_position_as_fast():
    axis = LatheAxisConfig().linear()
    target_of = VariableUniverseController(axis)
    records = []
    for seed, target in enumerate((-0.19, -0.05, 0.05, 0.19)):
        run = position(PidController(axis), LatheAxis(LatheAxisConfig(seed=seed)), target, 1.5)
        records.append(records_of_run(run.reference, run.measured, run.duty, target_of))
    rules = learn_rules(np.concatenate(records), 'lsq').complete()
    assert 0.2 < rules.coverage < 0.8
    with pytest.warns(RuleTableWarning, match='never rise'):
        params = replace(VariableUniverseParams(), rules=rules.table())
    for seed, target in enumerate((-0.05, 0.17, -0.01, 1e-3), start=10):
        config = LatheAxisConfig(seed=seed)
        learnt, pid = (
            position(controller, LatheAxis(config), target, 2.0).settle()
            for controller in (
                VariableUniverseController(axis, params),
                PidController(axis),
            )
        )
        assert learnt <= 1.5 * pid < 2.0
