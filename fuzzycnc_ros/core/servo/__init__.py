# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position control of an axis: variable-universe controller, observer, rule learning, baselines.

The names below are loaded when they are first used.
"""

from typing import TYPE_CHECKING

from fuzzycnc_ros.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fuzzycnc_ros.core.servo.ballscrew import BallscrewController
    from fuzzycnc_ros.core.servo.baselines import (
        CascadeController,
        FixedUniverseController,
        PidController,
    )
    from fuzzycnc_ros.core.servo.controller import AxisController, ControllerStatus
    from fuzzycnc_ros.core.servo.controllers import CONTROLLERS, make_controller
    from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
    from fuzzycnc_ros.core.servo.observer import DisturbanceObserver, ObserverNoise
    from fuzzycnc_ros.core.servo.params import VariableUniverseParams
    from fuzzycnc_ros.core.servo.profile import (
        Profile,
        ProfileLimits,
        Reference,
        point_to_point,
    )
    from fuzzycnc_ros.core.servo.rule_learning import LearnedRules, learn_rules
    from fuzzycnc_ros.core.servo.rule_table import RuleTable, published_rules, rules_with_zero
    from fuzzycnc_ros.core.servo.stability import StabilityReport, stability_report
    from fuzzycnc_ros.core.servo.stick_slip import StickSlipParams
    from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController

__all__ = [
    'CONTROLLERS',
    'AxisController',
    'BallscrewController',
    'CascadeController',
    'ControllerStatus',
    'DisturbanceObserver',
    'FeedbackLimits',
    'FixedUniverseController',
    'LearnedRules',
    'ObserverNoise',
    'PidController',
    'Profile',
    'ProfileLimits',
    'Reference',
    'RuleTable',
    'StabilityReport',
    'StickSlipParams',
    'VariableUniverseController',
    'VariableUniverseParams',
    'learn_rules',
    'make_controller',
    'point_to_point',
    'published_rules',
    'rules_with_zero',
    'stability_report',
]

_MODULES = {
    'ballscrew': ('BallscrewController',),
    'baselines': ('CascadeController', 'FixedUniverseController', 'PidController'),
    'controller': ('AxisController', 'ControllerStatus'),
    'controllers': ('CONTROLLERS', 'make_controller'),
    'feedback_watch': ('FeedbackLimits',),
    'observer': ('DisturbanceObserver', 'ObserverNoise'),
    'params': ('VariableUniverseParams',),
    'profile': ('Profile', 'ProfileLimits', 'Reference', 'point_to_point'),
    'rule_learning': ('LearnedRules', 'learn_rules'),
    'rule_table': ('RuleTable', 'published_rules', 'rules_with_zero'),
    'stability': ('StabilityReport', 'stability_report'),
    'stick_slip': ('StickSlipParams',),
    'variable_universe': ('VariableUniverseController',),
}

__getattr__ = lazy_names(__name__, _MODULES)
