# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feedrate along a path: curves, part programs, curvature, schedulers, limits.

The names below are loaded when they are first used.
"""

from typing import TYPE_CHECKING

from fuzzycnc_ros.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
    from fuzzycnc_ros.core.feedrate.motion.trajectory import limit_motion
    from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
    from fuzzycnc_ros.core.feedrate.path.path_curvature import curvature
    from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry
    from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
    from fuzzycnc_ros.core.feedrate.program.lexer import ProgramError
    from fuzzycnc_ros.core.feedrate.program.reader import read_program
    from fuzzycnc_ros.core.feedrate.program.writer import write_program
    from fuzzycnc_ros.core.feedrate.reference.reference_path import PathBuilder, ReferencePath
    from fuzzycnc_ros.core.feedrate.schedulers.fuzzy import FuzzyScheduler
    from fuzzycnc_ros.core.feedrate.schedulers.log_fuzzy import LogFuzzyScheduler
    from fuzzycnc_ros.core.feedrate.schedulers.plain import (
        ChordErrorFeed,
        ConstantFeed,
        ConstantNormalAcceleration,
        JerkLimitedFeed,
        LookAheadFeed,
    )
    from fuzzycnc_ros.core.feedrate.schedulers.refinement import refine

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
    'schedulers.fuzzy': ('FuzzyScheduler',),
    'schedulers.log_fuzzy': ('LogFuzzyScheduler',),
    'motion.limits': ('MotionLimits',),
    'path.nurbs': ('NurbsCurve',),
    'path.path_curvature': ('curvature',),
    'path.path_geometry': ('PathGeometry',),
    'program': ('ProgramError', 'read_program', 'write_program'),
    'reference.reference_path': ('PathBuilder', 'ReferencePath'),
    'schedulers.refinement': ('refine',),
    'path.sampled_path': ('SampledPath',),
    'schedulers.plain': (
        'ChordErrorFeed',
        'ConstantFeed',
        'ConstantNormalAcceleration',
        'JerkLimitedFeed',
        'LookAheadFeed',
    ),
    'motion.trajectory': ('limit_motion',),
}

__getattr__ = lazy_names(__name__, _MODULES)
