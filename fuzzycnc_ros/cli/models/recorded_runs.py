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
    from fuzzycnc_ros.core.thermal.turned import Turned

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
    )
    from fuzzycnc_ros.core.thermal.turned import turned_channels

    lines = offset_lines(runs)
    for run in runs:
        for names, values, step, scale, unit in (
            (run.sensor, run.temperature, TEMPERATURE_STEP, 1.0, 'degC'),
            (run.channel, run.displacement, DISPLACEMENT_STEP, 1e6, 'µm'),
        ):
            found = sorted(lone_values(values, step))
            lines += [
                f'{run.name}: {names[item.column]} is {item.value * scale:.4g} {unit} at '
                f'{run.time[item.row]:.6g} s, alone {item.neighbours(scale)}; if nothing of the '
                'kind happened, import the run without this value'
                for item in found[:DOUBTS_NAMED]
            ]
            if len(found) > DOUBTS_NAMED:
                more = len(found) - DOUBTS_NAMED
                lines.append(f'{run.name}: {more} more values in {unit} stand alone like these')
    for sensor, start, off in shifted_sensors(runs):
        seen = ', '.join(f'{value:.3g}' for value in start.values())
        lines.append(
            f'{", ".join(start)}: {sensor} begins at {seen} degC, against the other sensors '
            f'{abs(off):.0f} K {"above" if off > 0.0 else "below"} what it is in the other '
            f'{len(runs) - len(start)} of {len(runs)} runs, and stays so; if it is broken there, '
            f'leave it out with --drop-sensor {shlex.quote(sensor)}, or these runs'
        )
    lines += [_turned_line(item, len(runs[0].channel)) for item in turned_channels(runs)]
    return lines


def offset_lines(runs: 'Sequence[ThermalRun]') -> list[str]:
    """Return in which runs displacements do not begin at zero, in a sentence with the remedy."""
    from fuzzycnc_ros.core.thermal.plausibility import offset_channels
    from fuzzycnc_ros.core.thermal.spacing import reference_rows

    said = []
    for run in runs:
        found = offset_channels(run.displacement, reference_rows(run.time))
        if found:
            column, first, span = max(found, key=lambda item: abs(item[1]) / max(item[2], 1e-9))
            said.append(
                f'{run.name} ({run.channel[column]} at {first * 1e6:.3g} µm of a range of '
                f'{span * 1e6:.3g} µm)'
            )
    if not said:
        return []
    return [
        f'displacements do not begin at zero in {", ".join(said)}, while temperatures count from '
        'their first minutes; if the machine was cold then, import anew with '
        'fuzzycnc import-csv --zero'
    ]


def _turned_line(item: 'Turned', channels: int) -> str:
    """Return which runs have the other sign, how sure that is, and what to do."""
    what = 'all channels' if 1 < channels == len(item.channel) else ', '.join(item.channel)
    what += ' moves' if len(item.channel) == 1 else ' move'
    which = ', '.join(item.run)
    if len(item.run) == len(item.others):
        which += f' or {", ".join(item.others)}'
    return (
        f'{which}: {what} against what the other runs predict (correlation '
        f'{item.correlation:+.2f}); with the other sign the temperatures explain '
        f'{100.0 * (1.0 - item.left):.0f} % of the motion of all runs, as recorded '
        f'{100.0 * (1.0 - item.unexplained):.0f} %; if a probe was turned round or a sign '
        f'changed, import {which} anew with the other sign of the axis'
    )
