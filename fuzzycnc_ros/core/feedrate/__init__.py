# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feedrate along a path: curves, part programs, curvature, schedulers, limits.

The names below are loaded when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.fuzzy_scheduler import FuzzyScheduler, LogFuzzyScheduler
    from fuzzycnc_ros.core.feedrate.limits import MotionLimits
    from fuzzycnc_ros.core.feedrate.nurbs import NurbsCurve
    from fuzzycnc_ros.core.feedrate.path_curvature import curvature
    from fuzzycnc_ros.core.feedrate.path_geometry import PathGeometry
    from fuzzycnc_ros.core.feedrate.program import ProgramError, read_program, write_program
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
    'PathGeometry',
    'ProgramError',
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


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f'{__name__}.{module}'), name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
