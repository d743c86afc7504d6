# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Deformation of soft material: the T-S fuzzy neural network, and paths compensated by it.

The names below are loaded when they are first used: a model runs without the estimator.
"""

from typing import TYPE_CHECKING

from fuzzycnc_ros.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fuzzycnc_ros.core.deformation.compensation import (
        CompensatedPath,
        CompensationConfig,
        compensate_path,
    )
    from fuzzycnc_ros.core.deformation.features import FEATURE_SETS
    from fuzzycnc_ros.core.deformation.gain import AxisGain
    from fuzzycnc_ros.core.deformation.gate import Gate
    from fuzzycnc_ros.core.deformation.iterative import learn_offsets
    from fuzzycnc_ros.core.deformation.model import DeformationModel
    from fuzzycnc_ros.core.deformation.model_file import read_model, write_model
    from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
    from fuzzycnc_ros.core.deformation.relaxation import identify_relaxation
    from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial, StitchPath

__all__ = [
    'FEATURE_SETS',
    'AxisGain',
    'CompensatedPath',
    'CompensationConfig',
    'DeformationModel',
    'Gate',
    'SheetMaterial',
    'StitchPath',
    'TSFuzzyNetwork',
    'compensate_path',
    'identify_relaxation',
    'learn_offsets',
    'read_model',
    'write_model',
]

_MODULES = {
    'compensation': ('CompensatedPath', 'CompensationConfig', 'compensate_path'),
    'features': ('FEATURE_SETS',),
    'gain': ('AxisGain',),
    'gate': ('Gate',),
    'iterative': ('learn_offsets',),
    'model': ('DeformationModel',),
    'model_file': ('read_model', 'write_model'),
    'network': ('TSFuzzyNetwork',),
    'relaxation': ('identify_relaxation',),
    'stitch_path': ('SheetMaterial', 'StitchPath'),
}

__getattr__ = lazy_names(__name__, _MODULES)
