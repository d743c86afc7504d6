# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal error at run time: models, their files and runs; `fit` learns them."""

from fuzzycnc_ros.core.document import ModelFileError
from fuzzycnc_ros.core.thermal.candidate import CANDIDATES, Candidate
from fuzzycnc_ros.core.thermal.model import ModelMismatchError, ThermalModel, load_model
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun
from fuzzycnc_ros.core.thermal.sensor_watch import SensorCluster, SensorSelection

__all__ = [
    'CANDIDATES',
    'Candidate',
    'ModelFileError',
    'ModelMismatchError',
    'SensorCluster',
    'SensorSelection',
    'ThermalDataError',
    'ThermalModel',
    'ThermalRun',
    'load_model',
]
