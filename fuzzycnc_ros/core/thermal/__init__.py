# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal error: sensor selection, grey and lagged linear models, model files."""

from fuzzycnc_ros.core.thermal.candidates import CANDIDATES, Candidate
from fuzzycnc_ros.core.thermal.evaluation import Evaluation, evaluate
from fuzzycnc_ros.core.thermal.grey import GreyModel
from fuzzycnc_ros.core.thermal.linear import LagRidge, LeastSquares, StaticRidge
from fuzzycnc_ros.core.thermal.model import ModelMismatchError, ThermalModel
from fuzzycnc_ros.core.thermal.model_document import ModelFileError
from fuzzycnc_ros.core.thermal.model_file import load_model
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun
from fuzzycnc_ros.core.thermal.selection import (
    SensorCluster,
    SensorCount,
    SensorSelection,
    select_sensors,
    sensor_count_curve,
)
from fuzzycnc_ros.core.thermal.training import train_model

__all__ = [
    'CANDIDATES',
    'Candidate',
    'Evaluation',
    'GreyModel',
    'LagRidge',
    'LeastSquares',
    'ModelFileError',
    'ModelMismatchError',
    'SensorCluster',
    'SensorCount',
    'SensorSelection',
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
