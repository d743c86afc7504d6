# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What is said beside settings that `fuzzycnc servo tune` found."""

import warnings

from fuzzycnc_ros.core.machine import LatheAxis
from fuzzycnc_ros.core.servo import position_many, stability_report
from fuzzycnc_ros.core.servo.tuning import move_costs, production, tuning_moves

SPREAD = (0.5, 1.0, 1.5)
"""Gains of the axis, as multiples of the nominal one, that settings are to do for."""


def swinging(settings: dict[str, float]) -> list[str]:
    """Return at what gains the loop with some settings swings, which friction may have hidden."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        controller = production(LatheAxis().linear(), settings)
    radius = stability_report(controller, gains=SPREAD).spectral_radius
    return [
        f"note: at x{gain:g} of the axis' gain the loop swings, spectral radius {size:.4f}; "
        'friction hid it'
        for gain, size in radius.items()
        if size >= 1.0
    ]


def default_cost() -> float:
    """Return what the default settings cost on the moves of the search."""
    moves, axis = tuning_moves(), LatheAxis().linear()
    batch = position_many([production(axis, {}) for _ in moves], moves, 1.5)
    return float(move_costs(batch).sum())
