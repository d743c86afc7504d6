# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page that a shift is reported on."""

from collections.abc import Mapping, Sequence

import numpy as np

from fuzzycnc_ros import __version__
from fuzzycnc_ros.core.text_hash import text_hash
from fuzzycnc_ros.core.thermal import ThermalModel, ThermalRun, sensor_count_curve
from fuzzycnc_ros.report import (
    CompensationRun,
    Latency,
    ReportData,
    SensorCountCurve,
    candidate_label,
)

SENSOR_COUNTS = (1, 2, 3, 5, 8, 10, 15)
"""Numbers of sensors on the sensor-count curve, method sheet 001 section 8.B."""


def shift_report(
    runs: Sequence[CompensationRun],
    model: ThermalModel,
    model_text: str,
    *,
    title: str = 'A thermal shift, compensated',
    summary: str = '',
    notes: Sequence[str] = (),
    calibration: Sequence[ThermalRun] = (),
    facts: Mapping[str, str] | None = None,
    latency: Latency | None = None,
) -> ReportData:
    """Return what the report of a shift shows.

    Parameters
    ----------
    runs : sequence of CompensationRun
        Compensated duties.
    model : ThermalModel
        Model that predicted.
    model_text : str
        Text of its file.
    title : str
        Headline.
    summary : str
        Sentence below it; what was trained on and judged if empty.
    notes : sequence of str
        Remarks, shown before those on the candidates.
    calibration : sequence of ThermalRun
        Training runs, for the sensor-count curve; without them there is none.
    facts : mapping, optional
        Further rows of provenance, shown first.
    latency : Latency, optional
        Time from temperatures to compensation of a live run.
    """
    in_use = ', '.join(
        f'{channel}: {candidate_label(name)}'
        for channel, name in zip(model.channel, model.default, strict=True)
    )
    judged = ', '.join(run.name for run in runs)
    return ReportData(
        title=title,
        runs=runs,
        summary=summary or f'Trained on {", ".join(model.runs)}; judged on {judged}.',
        sensor_count_curve=count_curve(calibration, runs, len(model.inputs)),
        latency=latency,
        facts={
            **(facts or {}),
            'Training runs': ', '.join(model.runs),
            'Sensors that the model reads': ', '.join(model.inputs),
            'Model in use': in_use,
            'Sampling interval': f'{model.interval:g} s',
            'Model hash': text_hash(model_text)[:16],
            'fuzzycnc': __version__,
        },
        notes=[
            *notes,
            *(
                f'{candidate_label(name)}: {problem}.'
                for name, item in model.candidates.items()
                for problem in item.problems
            ),
        ],
    )


def count_curve(
    calibration: Sequence[ThermalRun], runs: Sequence[CompensationRun], chosen_count: int
) -> SensorCountCurve | None:
    """Return the sensor-count curve on the first run, None where it cannot be had.

    It needs calibration runs, and a held-out run whose sensors all read to the end.
    """
    held_out = next((run for run in runs if np.isfinite(run.temperature).all()), None)
    if not calibration or held_out is None:
        return None
    counts = tuple(n for n in SENSOR_COUNTS if n <= len(held_out.sensor))
    unseen = ThermalRun(
        name=held_out.name,
        time=held_out.time,
        sensor=held_out.sensor,
        temperature=held_out.temperature,
        channel=held_out.channel,
        axis=calibration[0].axis,
        displacement=held_out.measured,
    )
    points = sensor_count_curve(calibration, unseen, counts=counts)
    return SensorCountCurve(
        count=counts,
        channel=held_out.channel,
        residual_max=np.array([point.largest for point in points]),
        run=held_out.name,
        chosen_count=chosen_count,
    )
