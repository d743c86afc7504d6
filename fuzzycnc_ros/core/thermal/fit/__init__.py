# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Learning of thermal models: sensors, estimators, choice by held-out runs, comparison."""

from fuzzycnc_ros.core.thermal.fit.anfis import Anfis, GreyAnfis
from fuzzycnc_ros.core.thermal.fit.evaluation import Evaluation, evaluate
from fuzzycnc_ros.core.thermal.fit.grey import GreyModel
from fuzzycnc_ros.core.thermal.fit.hybrid import HybridFilterNetwork
from fuzzycnc_ros.core.thermal.fit.linear import LagRidge, LeastSquares, StaticRidge
from fuzzycnc_ros.core.thermal.fit.selection import SensorCount, select_sensors, sensor_count_curve
from fuzzycnc_ros.core.thermal.fit.training import train_model

__all__ = [
    'Anfis',
    'Evaluation',
    'GreyAnfis',
    'GreyModel',
    'HybridFilterNetwork',
    'LagRidge',
    'LeastSquares',
    'SensorCount',
    'StaticRidge',
    'evaluate',
    'select_sensors',
    'sensor_count_curve',
    'train_model',
]
