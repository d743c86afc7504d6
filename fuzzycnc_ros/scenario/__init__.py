# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios: whole runs of the simulated machine in one process, and what came of them."""

from fuzzycnc_ros.scenario.contouring import SETTLE, run_contouring
from fuzzycnc_ros.scenario.contouring_log import ContouringLog, FollowedPath
from fuzzycnc_ros.scenario.published_bag import PublishedBag
from fuzzycnc_ros.scenario.shift_log import ShiftLog, compensation_runs
from fuzzycnc_ros.scenario.shift_report import shift_report
from fuzzycnc_ros.scenario.thermal_shift import (
    CALIBRATION_DUTIES,
    SHIFT_DUTIES,
    Calibration,
    record_calibration,
    run_shift,
)

__all__ = [
    'CALIBRATION_DUTIES',
    'SETTLE',
    'SHIFT_DUTIES',
    'Calibration',
    'ContouringLog',
    'FollowedPath',
    'PublishedBag',
    'ShiftLog',
    'compensation_runs',
    'record_calibration',
    'run_contouring',
    'run_shift',
    'shift_report',
]
