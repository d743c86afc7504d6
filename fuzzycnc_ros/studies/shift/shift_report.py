# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page that a shift is reported on."""

from collections.abc import Mapping, Sequence

import numpy as np

from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.core.thermal.band import (
    WIDTH,
    band_ratio,
    coverage,
    independent_residuals,
    mean_of_square,
)
from fuzzycnc_ros.core.thermal.candidate import DEFAULT, UNCOMPENSATED
from fuzzycnc_ros.core.thermal.fingerprint import recognised_in
from fuzzycnc_ros.core.thermal.fit import evaluate, train_model
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.core.thermal.sensor_limits import JUDGED
from fuzzycnc_ros.studies.page.html import Remark, Section
from fuzzycnc_ros.studies.thermal.comparison import by_channel
from fuzzycnc_ros.studies.thermal.judged import (
    band_remark,
    loss_remarks,
    span_text,
    training_remark,
)
from fuzzycnc_ros.studies.thermal.report_data import (
    CompensationRun,
    Latency,
    ReportData,
    SensorCountCurve,
)
from fuzzycnc_ros.studies.thermal.summary import candidate_label

SENSOR_COUNTS = (1, 2, 3, 5, 8, 10, 15)
"""Numbers of sensors on the sensor-count curve."""


def shift_report(
    runs: Sequence[CompensationRun],
    model: ThermalModel,
    model_text: str,
    *,
    title: str = 'A thermal shift, compensated',
    summary: str = '',
    notes: Sequence[str] = (),
    calibration: Sequence[ThermalRun] = (),
    judged: Sequence[Remark] | None = None,
    facts: Mapping[str, str] | None = None,
    latency: Latency | None = None,
    sections: Sequence[Section] = (),
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
    judged : sequence of Remark, optional
        What was judged and whether the model was trained on it; found from the runs if absent.
    facts : mapping, optional
        Further rows of provenance, shown first.
    latency : Latency, optional
        Time from temperatures to compensation of a live run.
    sections : sequence of Section, optional
        Further parts of the page.
    """
    in_use = by_channel(dict(zip(model.channel, model.default, strict=True)))
    spans = '; '.join(_span(run) for run in runs)
    return ReportData(
        title=title,
        runs=runs,
        summary=summary or f'Trained on duties {", ".join(model.runs)}; judged on {spans}.',
        sensor_count_curve=count_curve(calibration, runs, model),
        latency=latency,
        judged=[item for run in runs for item in judged_remarks(run, model)]
        if judged is None
        else judged,
        facts={
            'Judged': spans,
            **(facts or {}),
            'Training runs': ', '.join(model.runs),
            'Sensors that the model reads': ', '.join(model.inputs),
            'Model in use': in_use,
            'Sampling interval': f'{model.interval:g} s',
            'Model hash': text_hash(model_text)[:16],
        },
        notes=[
            *notes,
            *(
                f'{candidate_label(name)}: {problem}.'
                for name, item in model.candidates.items()
                for problem in item.problems
            ),
        ],
        sections=sections,
    )


def judged_remarks(run: CompensationRun, model: ThermalModel) -> list[Remark]:
    """Return what of a compensated run was judged, and whether the model was trained on it."""
    measured = np.isfinite(run.measured)
    window = span_text(run.name, run.time, run.channel, measured.sum(axis=0).tolist())
    trained_on, recognised = recognised_in(model.fingerprints, _recorded(run, model.axis))
    left = {
        name: np.array([score.rms for score in scores])
        for name, scores in (
            (UNCOMPENSATED, run.scores()[UNCOMPENSATED]),
            (DEFAULT, run.scores_in_use()),
        )
    }
    return [
        *_false_band(run),
        Remark(window),
        training_remark(run.name, trained_on, recognised, model.runs),
        *loss_remarks(run.name, run.channel, left),
    ]


def _false_band(run: CompensationRun) -> list[Remark]:
    """Return that the band of what was predicted is false, nothing if it is not."""
    if run.standard_deviation is None:
        return []
    residual = run.measured - run.prediction()
    deviation = np.where(np.isfinite(residual), run.standard_deviation, np.nan)
    residual = np.where(np.isfinite(deviation), residual, np.nan)
    found = band_remark(
        run.name,
        run.channel,
        coverage(residual, deviation),
        WIDTH * np.sqrt(mean_of_square(deviation)),
        band_ratio(residual, deviation),
        independent_residuals(residual, deviation),
    )
    return [found] if found.warning else []


def _span(run: CompensationRun) -> str:
    return f'{run.name} from {run.time[0]:,.0f} to {run.time[-1]:,.0f} s'


def _recorded(run: CompensationRun, axis: Sequence[str]) -> ThermalRun:
    return ThermalRun(
        name=run.name,
        time=run.time,
        sensor=run.sensor,
        temperature=run.temperature,
        channel=run.channel,
        axis=tuple(axis),
        displacement=run.measured,
        spindle_speed=run.spindle_speed,
        limits=JUDGED,
    )


def count_curve(
    calibration: Sequence[ThermalRun], runs: Sequence[CompensationRun], model: ThermalModel
) -> SensorCountCurve | None:
    """Return the sensor-count curve on the first run, None where it cannot be had.

    It needs calibration runs, and a held-out run whose sensors all read to the end.  Each point
    is the kind of model that is in use, trained anew on so many sensors; a channel that stays
    uncompensated has none.
    """
    held_out = next((run for run in runs if np.isfinite(run.temperature).all()), None)
    in_use = [name for name in dict.fromkeys(model.default) if name != UNCOMPENSATED]
    if not calibration or held_out is None or not in_use:
        return None
    counts = tuple(n for n in SENSOR_COUNTS if n <= len(held_out.sensor))
    unseen = _recorded(held_out, model.axis)
    points = [_largest(calibration, unseen, model, in_use, count) for count in counts]
    return SensorCountCurve(
        count=counts,
        channel=held_out.channel,
        residual_max=np.array(points),
        run=held_out.name,
        model=by_channel(dict(zip(model.channel, model.default, strict=True))),
        chosen_count=len(model.inputs),
    )


def _largest(
    calibration: Sequence[ThermalRun],
    unseen: ThermalRun,
    model: ThermalModel,
    in_use: Sequence[str],
    count: int,
) -> list[float]:
    """Return the largest residual of each channel with so many sensors [m]."""
    trained = train_model(
        calibration,
        model=in_use[0],
        interval=model.interval,
        sensors='clusters',
        n_clusters=count,
        candidates=in_use,
    )
    largest = evaluate(trained, unseen).largest
    return [
        float(largest[name][c]) if name in largest and name != UNCOMPENSATED else np.nan
        for c, name in enumerate(model.default)
    ]
