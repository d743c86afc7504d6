# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a comparison of scheduling methods found: time against contour error."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fuzzycnc_ros.studies.page.document import shown_as


@dataclass(frozen=True)
class ParetoPoint:
    """A schedule: its largest contour error [m] and its time [s]."""

    error: float = field(metadata=shown_as('error_mm', 1e3))
    duration: float = field(metadata=shown_as('time_s'))


@dataclass(frozen=True)
class MethodCurve:
    """What a method can do.

    Attributes
    ----------
    points : tuple of ParetoPoint
        Schedules, by increasing error.
    at_error : mapping of float to float or None
        Time at each compared error [s]; None where it cannot be reached.
    reasons : mapping of float to str
        Why it cannot.
    """

    points: tuple[ParetoPoint, ...]
    at_error: Mapping[float, float | None]
    reasons: Mapping[float, str]


@dataclass(frozen=True)
class Pareto:
    """Time against contour error of all methods on a path.

    Attributes
    ----------
    path : str
        Which path.
    errors : tuple of float
        Errors at which the methods are compared [m].
    methods : mapping of str to MethodCurve
        Curves by method.
    limits : ParetoPoint
        Full feed everywhere: what the machine's acceleration along the path alone allows.
    """

    path: str
    errors: tuple[float, ...]
    methods: Mapping[str, MethodCurve]
    limits: ParetoPoint
