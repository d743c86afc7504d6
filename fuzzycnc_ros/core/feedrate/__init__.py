# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feedrate along a path: curves, part programs, curvature, schedulers, limits.

The names below are loaded when they are first used.
"""

from typing import TYPE_CHECKING

from fuzzycnc_ros.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.fuzzy_scheduler import FuzzyScheduler, LogFuzzyScheduler
    from fuzzycnc_ros.core.feedrate.limits import MotionLimits
    from fuzzycnc_ros.core.feedrate.nurbs import NurbsCurve
    from fuzzycnc_ros.core.feedrate.path_curvature import curvature
    from fuzzycnc_ros.core.feedrate.path_geometry import PathGeometry
    from fuzzycnc_ros.core.feedrate.program import ProgramError, read_program, write_program
    from fuzzycnc_ros.core.feedrate.reference_path import PathBuilder, ReferencePath
    from fuzzycnc_ros.core.feedrate.refinement import refine
    from fuzzycnc_ros.core.feedrate.sampled_path import SampledPath
    from fuzzycnc_ros.core.feedrate.schedulers import (
        ChordErrorFeed,
        ConstantFeed,
        ConstantNormalAcceleration,
        JerkLimitedFeed,
        LookAheadFeed,
    )
    from fuzzycnc_ros.core.feedrate.trajectory import limit_motion

__all__ = [
    'ChordErrorFeed',
    'ConstantFeed',
    'ConstantNormalAcceleration',
    'FuzzyScheduler',
    'JerkLimitedFeed',
    'LogFuzzyScheduler',
    'LookAheadFeed',
    'MotionLimits',
    'NurbsCurve',
    'PathBuilder',
    'PathGeometry',
    'ProgramError',
    'ReferencePath',
    'SampledPath',
    'curvature',
    'limit_motion',
    'read_program',
    'refine',
    'write_program',
]

_MODULES = {
    'fuzzy_scheduler': ('FuzzyScheduler', 'LogFuzzyScheduler'),
    'limits': ('MotionLimits',),
    'nurbs': ('NurbsCurve',),
    'path_curvature': ('curvature',),
    'path_geometry': ('PathGeometry',),
    'program': ('ProgramError', 'read_program', 'write_program'),
    'reference_path': ('PathBuilder', 'ReferencePath'),
    'refinement': ('refine',),
    'sampled_path': ('SampledPath',),
    'schedulers': (
        'ChordErrorFeed',
        'ConstantFeed',
        'ConstantNormalAcceleration',
        'JerkLimitedFeed',
        'LookAheadFeed',
    ),
    'trajectory': ('limit_motion',),
}

__getattr__ = lazy_names(__name__, _MODULES)
