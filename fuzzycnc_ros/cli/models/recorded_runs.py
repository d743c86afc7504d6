# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors of recorded runs: which are left out, and what became of readings that are missing."""

import shlex
from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fuzzycnc_ros.cli.console import words
from fuzzycnc_ros.studies.thermal.missing_readings import LINE, MATES, Bridged

if TYPE_CHECKING:
    from collections.abc import Callable

    from fuzzycnc_ros.core.thermal.run import ThermalRun

IN_WORDS = {LINE: 'straight lines bridge them', MATES: 'other sensors stand in'}

DOUBTS_NAMED = 3
"""Single values of a run that are named."""


def sensors_but(drop: list[str] | None, bags: Sequence[Path]) -> 'Callable[[str], bool] | None':
    """Return what `read_run` asks of each sensor; None if all are kept.

    Parameters
    ----------
    drop : list of str, optional
        What --drop-sensor says.
    bags : sequence of Path
        All bags of the command; a sensor that one of them lacks may be dropped from the others.

    Raises
    ------
    ValueError
        If none of the bags has such a sensor.
    """
    from fuzzycnc_ros.bags.errors import BagError
    from fuzzycnc_ros.bags.runs import sensor_names

    names = words(drop or [])
    if not names:
        return None
    known: dict[str, None] = {}
    for bag in bags:
        try:
            known |= dict.fromkeys(sensor_names(bag))
        except BagError:
            continue  # whoever reads it for its run says why it cannot be read
    unknown = [name for name in names if name not in known]
    if unknown and known:
        raise ValueError(
            f'--drop-sensor: expected some of the sensors {", ".join(known)} but found '
            f'{", ".join(unknown)}'
        )
    return partial(_is_outside, frozenset(names))


def _is_outside(names: Collection[str], name: str) -> bool:
    return name not in names


def bridged_gaps(run: 'ThermalRun', interval: float) -> tuple[Bridged, ...]:
    """Return the gaps that are bridged where a run is brought to an interval [s]."""
    return tuple(Bridged(*gap, by=LINE) for gap in run.averaged(interval).gaps())


def gap_lines(run: str, gaps: Sequence[Bridged], interval: float) -> list[str]:
    """Return what was missing in a run and what stands for it, a line for each kind."""
    lines = []
    for by, stands in IN_WORDS.items():
        own = [gap for gap in gaps if gap.by == by]
        if not own:
            continue
        longest = max(own, key=lambda gap: gap.samples)
        number = '1 gap' if len(own) == 1 else f'{len(own)} gaps, the longest'
        sensors = ', '.join(dict.fromkeys(gap.sensor for gap in own))
        lines.append(
            f'{run}: {sensors} read nothing in {number} of '
            f'{longest.samples * interval / 60.0:.3g} min after {longest.start_s:.6g} s; '
            f'{stands}, as in the predictor'
        )
    return lines


def doubt_lines(runs: 'Sequence[ThermalRun]') -> list[str]:
    """Return what looks like a mistake in recorded runs, a sentence each with the remedy."""
    from fuzzycnc_ros.core.thermal.plausibility import (
        DISPLACEMENT_STEP,
        TEMPERATURE_STEP,
        lone_values,
        shifted_sensors,
        turned_channels,
    )

    lines = []
    for run in runs:
        for names, values, step, scale, unit in (
            (run.sensor, run.temperature, TEMPERATURE_STEP, 1.0, 'degC'),
            (run.channel, run.displacement, DISPLACEMENT_STEP, 1e6, 'um'),
        ):
            found = sorted(lone_values(values, step))
            lines += [
                f'{run.name}: {names[item.column]} is {item.value * scale:.4g} {unit} at '
                f'{run.time[item.row]:.6g} s, alone between {item.before * scale:.4g} and '
                f'{item.behind * scale:.4g}; if nothing of the kind happened, import the run '
                'without this value'
                for item in found[:DOUBTS_NAMED]
            ]
            if len(found) > DOUBTS_NAMED:
                more = len(found) - DOUBTS_NAMED
                lines.append(f'{run.name}: {more} more values in {unit} stand alone like these')
    for sensor, start, off in shifted_sensors(runs):
        seen = ', '.join(f'{value:.3g}' for value in start.values())
        lines.append(
            f'{", ".join(start)}: {sensor} begins at {seen} degC, against the other sensors '
            f'{abs(off):.0f} K {"above" if off > 0.0 else "below"} what it is in other runs; if '
            f'it is broken there, leave it out with --drop-sensor {shlex.quote(sensor)}, or '
            'these runs'
        )
    for channel, against, others in turned_channels(runs):
        odd = ', '.join(against)
        lines.append(
            f'{odd}: {channel} moves {_way(against)} the temperatures '
            f'({_least(against):+.2f}), but {_way(others)} them in {", ".join(others)} '
            f'({_least(others):+.2f}); if a probe was turned round or a sign changed, import '
            f'{odd if len(against) < len(others) else "some of them"} anew with the other sign of '
            'the axis'
        )
    return lines


def _way(correlation: dict[str, float]) -> str:
    return 'with' if _least(correlation) > 0.0 else 'against'


def _least(correlation: dict[str, float]) -> float:
    return min(correlation.values(), key=abs)
