# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal error: sensor selection, linear, grey, fuzzy and network models, choice, model files.

The names below are loaded when they are first used.  A node that only runs a model then starts
without the estimators, whose base, scikit-learn's, takes a second to load.
"""

from typing import TYPE_CHECKING

from fuzzycnc_ros.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal.anfis import Anfis, GreyAnfis
    from fuzzycnc_ros.core.thermal.baselines import GaussianProcess, Mlp
    from fuzzycnc_ros.core.thermal.candidate import CANDIDATES, Candidate
    from fuzzycnc_ros.core.thermal.document import ModelFileError
    from fuzzycnc_ros.core.thermal.evaluation import Evaluation, evaluate
    from fuzzycnc_ros.core.thermal.grey import GreyModel
    from fuzzycnc_ros.core.thermal.linear import LagRidge, LeastSquares, StaticRidge
    from fuzzycnc_ros.core.thermal.model import ModelMismatchError, ThermalModel
    from fuzzycnc_ros.core.thermal.model_file import load_model
    from fuzzycnc_ros.core.thermal.networks import (
        Arma,
        DynamicNetwork,
        HybridFilterNetwork,
        LinearNetwork,
        StaticNetwork,
    )
    from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun
    from fuzzycnc_ros.core.thermal.selected import SensorCluster, SensorSelection
    from fuzzycnc_ros.core.thermal.selection import SensorCount, select_sensors, sensor_count_curve
    from fuzzycnc_ros.core.thermal.training import train_model

__all__ = [
    'CANDIDATES',
    'Anfis',
    'Arma',
    'Candidate',
    'DynamicNetwork',
    'Evaluation',
    'GaussianProcess',
    'GreyAnfis',
    'GreyModel',
    'HybridFilterNetwork',
    'LagRidge',
    'LeastSquares',
    'LinearNetwork',
    'Mlp',
    'ModelFileError',
    'ModelMismatchError',
    'SensorCluster',
    'SensorCount',
    'SensorSelection',
    'StaticNetwork',
    'StaticRidge',
    'ThermalDataError',
    'ThermalModel',
    'ThermalRun',
    'evaluate',
    'load_model',
    'select_sensors',
    'sensor_count_curve',
    'train_model',
]

_MODULES = {
    'anfis': ('Anfis', 'GreyAnfis'),
    'baselines': ('GaussianProcess', 'Mlp'),
    'candidate': (
        'CANDIDATES',
        'Candidate',
    ),
    'evaluation': (
        'Evaluation',
        'evaluate',
    ),
    'grey': ('GreyModel',),
    'linear': (
        'LagRidge',
        'LeastSquares',
        'StaticRidge',
    ),
    'networks': (
        'Arma',
        'DynamicNetwork',
        'HybridFilterNetwork',
        'LinearNetwork',
        'StaticNetwork',
    ),
    'model': (
        'ModelMismatchError',
        'ThermalModel',
    ),
    'document': ('ModelFileError',),
    'model_file': ('load_model',),
    'run': (
        'ThermalDataError',
        'ThermalRun',
    ),
    'selected': (
        'SensorCluster',
        'SensorSelection',
    ),
    'selection': (
        'SensorCount',
        'select_sensors',
        'sensor_count_curve',
    ),
    'training': ('train_model',),
}

__getattr__ = lazy_names(__name__, _MODULES)
