# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Effect of occasional probing on a run, with the model and without: tables and figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.thermal.predictor_stream import ProbedError, ProbeSource
from fuzzycnc_ros.components.thermal.probe_learning import ProbeLearning
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.band import WIDTH, coverage
from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.core.thermal.fit import Evaluation
from fuzzycnc_ros.core.thermal.fit.training import at_interval
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.run import (
    JITTER_MAX,
    REFERENCE_SAMPLES,
    ThermalDataError,
    ThermalRun,
)
from fuzzycnc_ros.runtime.records import Displacement, Stamp, nanoseconds
from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Rule, Series
from fuzzycnc_ros.studies.page.drawing import AFTER, FAINT, MUTED, OTHER, time_axis
from fuzzycnc_ros.studies.page.html import Figure, Section
from fuzzycnc_ros.studies.page.table import Table
from fuzzycnc_ros.studies.thermal.comparison import LEFT, residual_document, residual_table
from fuzzycnc_ros.studies.thermal.many_runs import overall_document, overall_table
from fuzzycnc_ros.studies.thermal.report_data import Score
from fuzzycnc_ros.studies.thermal.summary import candidate_label, micrometres

UNPROBED, HELD, LEARNT = 'unprobed', 'held', 'learnt'
"""Rows: the default alone, the last probe without any model, the default with what was learnt."""

Counts = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ProbedEvaluation:
    """Residuals of a run that was probed now and then.

    A channel's samples count once it has been probed, all rows on the same ones.  Each is judged
    against what was known before it: a probe acts from the next sample on, never on its own.

    Parameters
    ----------
    run : str
        Name of the run.
    every : float
        Least time between two probes of a channel [s].
    channel : tuple of str, length c
        Channels.
    samples, probes, doubted : ndarray of int, shape (c,)
        Samples that count, probes taken, and those of them that were not believed.
    rms, largest : mapping of str to ndarray, shape (c,)
        Root mean square and largest absolute residual [m] of 'uncompensated', of the default
        'unprobed', of the last probe 'held' without a model, and of the default with what the
        probes have taught, 'learnt'; infinite if it diverged, NaN if nothing counts.
    covered : ndarray, shape (c,)
        Share of the samples within the band of 'learnt' [-].
    half_width : ndarray, shape (c,)
        Half width of that band in the median [m].
    time : ndarray, shape (n,)
        Time of each sample between the bounds of the evaluation [s].
    residual : mapping of str to ndarray, shape (n, c)
        Measured minus predicted error behind each row [m]; NaN where it does not count.
    """

    run: str
    every: float
    channel: tuple[str, ...]
    samples: Counts
    probes: Counts
    doubted: Counts
    rms: Mapping[str, Array]
    largest: Mapping[str, Array]
    covered: Array
    half_width: Array
    time: Array
    residual: Mapping[str, Array]


def evaluate_probed(
    model: ThermalModel, run: ThermalRun, judged: Evaluation, every: float
) -> ProbedEvaluation:
    """Correct the default's predictions by probes, and judge what is left.

    Parameters
    ----------
    model : ThermalModel
        Trained model.
    run : ThermalRun
        Run from its thermal start, as recorded.
    judged : Evaluation
        What `evaluate` found of both; it says between which times is probed and judged.
    every : float
        Least time between two probes of a channel [s].  The first is the first displacement
        of what is judged; where none was measured when one is due, the next is taken.

    Returns
    -------
    ProbedEvaluation
        Root mean square and largest residual per channel, beside those of plainer ways.

    Raises
    ------
    ThermalDataError
        If `every` is shorter than the model's interval or longer than what is judged, or nothing
        was measured after the first probe.
    """
    check_every(every, model.interval, 'the model')
    first, last = float(judged.time[0]), float(judged.time[-1])
    if every > last - first:
        raise ThermalDataError(
            f'run {run.name!r}: expected at most {last - first:g} s between two probes, as long '
            f'as what is judged, but found {every:g} s; probe more often, or judge a longer run'
        )
    even = at_interval(run, model.interval)
    inside = even.inside(first, last)
    track = _Track(model, even, every)
    track.follow(_probes(run, even, every, run.inside(first, last)))
    counted = np.isfinite(track.predicted[HELD][inside]) & np.isfinite(judged.measured)
    if not counted.any():
        raise ThermalDataError(
            f'run {run.name!r}: expected measured displacements after the first probe, but found '
            'none; judge a longer run'
        )
    residual = {
        name: np.where(counted, judged.measured - values[inside], np.nan)
        for name, values in track.predicted.items()
    }
    deviation = track.deviation[inside]
    scores = {
        name: [Score.of(*pair) for pair in zip(values.T, judged.measured.T, strict=True)]
        for name, values in residual.items()
    }
    return ProbedEvaluation(
        run=judged.run,
        every=every,
        channel=judged.channel,
        samples=counted.sum(axis=0),
        probes=track.probes,
        doubted=track.learning.doubted,
        rms={name: np.array([score.rms for score in own]) for name, own in scores.items()},
        largest={name: np.array([score.max for score in own]) for name, own in scores.items()},
        covered=coverage(residual[LEARNT], deviation),
        half_width=WIDTH * np.median(deviation, axis=0),
        time=judged.time,
        residual=residual,
    )


def check_every(every: float, interval: float, owner: str) -> None:
    """Refuse a time between two probes [s] that is shorter than the sampling interval [s] of one.

    Raises
    ------
    ThermalDataError
        If it is shorter.
    """
    if every < interval * (1.0 - JITTER_MAX):
        raise ThermalDataError(
            f'probing: expected at least {interval:g} s between two probes, the sampling interval '
            f'of {owner}, but found {every:g} s; a probe acts from the next sample on'
        )


class _Track:
    """The ways to use a probe, side by side along a run at the model's interval."""

    def __init__(self, model: ThermalModel, even: ThermalRun, every: float) -> None:
        rise = model.rises(even)
        alone = model.recursion().run(rise)
        # A diverged prediction counts as infinitely wrong, as where nothing is probed.
        self._alone = np.where(np.isnan(alone), np.inf, alone)
        self._rise, self._expected = rise[:, : len(model.inputs)], model.standard_deviation(rise)
        known = even.spindle_speed
        self._speed = np.full(len(alone), np.nan) if known is None else known
        self._drives = even.drives
        self._channel, self._axis = model.channel, model.axis
        config = ThermalPredictorConfig(learn=True, probe_interval_min=every)
        self.learning = ProbeLearning(model, config)
        self.learning.begin(nanoseconds(even.time[REFERENCE_SAMPLES - 1]), None)
        self.probes: Counts = np.zeros(len(model.channel), dtype=np.int64)
        self.predicted = {UNCOMPENSATED: np.zeros_like(alone), UNPROBED: self._alone}
        for name in (HELD, LEARNT):
            self.predicted[name] = np.full_like(alone, np.nan)
        self.deviation = np.full_like(alone, np.nan)

    def follow(self, samples: Iterator[tuple[Stamp, tuple[ProbedError, ...]]]) -> None:
        """Predict each sample, then take the probes that came with it."""
        held = np.full(len(self._channel), np.nan)
        for row, (stamp, probes) in enumerate(samples):
            self.predicted[HELD][row] = held
            self._learn(row, stamp, probes)
            for probe in probes:
                nothing = np.zeros(len(held))
                error, _, _ = probe.of_channels(self._channel, self._axis, nothing, nothing + 1.0)
                held = np.where(np.isfinite(error), error, held)
                self.probes += np.isfinite(error)

    def _learn(self, row: int, stamp: Stamp, probes: tuple[ProbedError, ...]) -> None:
        """Predict a sample from the probes before it."""
        drives = {name: float(values[row]) for name, values in self._drives.items()}
        self.learning.step(self._rise[row], float(self._speed[row]), stamp, drives)
        if not np.isfinite(self._alone[row]).all():
            self.learning.pause()
            self.predicted[LEARNT][row] = self._alone[row]
            return
        self.predicted[LEARNT][row], self.deviation[row] = self.learning.apply(
            stamp, self._alone[row], self._expected[row], probes
        )


def _probes(
    run: ThermalRun, even: ThermalRun, every: float, usable: NDArray[np.bool_]
) -> Iterator[tuple[Stamp, tuple[ProbedError, ...]]]:
    """Yield the stamp of each sample [ns] and the probes that come with it.

    Only displacements that are `usable`, shape (rows of the run,), are offered as probes.
    """
    source = ProbeSource(ThermalPredictorConfig(learn=True, probe_interval_min=every))
    reference = nanoseconds(even.time[REFERENCE_SAMPLES - 1])
    noise = np.full(len(run.channel), np.nan)  # not recorded: the least one of a probe
    waiting = iter(np.flatnonzero(usable))
    row = next(waiting, None)
    for stamp in map(nanoseconds, even.time):
        while row is not None and (measured_at := nanoseconds(run.time[row])) <= stamp:
            source.add(
                Displacement(
                    stamp=measured_at,
                    frame_id='',
                    axis=run.axis,
                    channel=run.channel,
                    displacement=run.displacement[row],
                    standard_deviation=noise,
                    includes_compensation=False,
                )
            )
            row = next(waiting, None)
        yield stamp, source.take(stamp, reference)


Floats = NDArray[np.float64]

_DRAWN = (('unprobed', FAINT, 0.9), ('held', OTHER, 0.9), ('learnt', AFTER, 1.4))
"""Rows that are drawn, each with its colour and width, from the back to the front."""

RULE = (
    'Samples count once their channel has been probed, and each is judged against the probes '
    'before it.'
)
"""Rule of counting, for readers of the figures."""


def probed_table(probed: Sequence[ProbedEvaluation]) -> Table:
    """Return what is left of a run in each way to use its probes, or over all of several runs."""
    first = probed[0]
    if len(probed) > 1:
        title = f'Over {len(probed)} runs, {_every(first)}: {LEFT} [µm]'
        return replace(overall_table(probed), title=title)
    return residual_table(
        f'{first.run}, {_every(first)}: {LEFT}', first.channel, first.rms, first.largest
    )


def probed_lines(probed: Sequence[ProbedEvaluation]) -> list[str]:
    """Return what else is to be said below the table, a line each."""
    lines = [RULE]
    for item in probed:
        parts = [
            f'{item.run}: {_range(item.samples)} samples, {_range(item.probes)} probes a channel'
        ]
        if item.doubted.any():
            parts.append(f'{int(item.doubted.sum())} of them doubted')
        bands = [
            f'{name} ±{micrometres(half)} µm holds {100.0 * inside:.0f} %'
            for name, half, inside in zip(item.channel, item.half_width, item.covered, strict=True)
        ]
        parts.append(f'band: {", ".join(bands)}')
        beaten = _no_better_than_held(item)
        if beaten:
            parts.append(f'on {", ".join(beaten)} the last probe, held, does as well alone')
        lines.append('; '.join(parts))
    return lines


def probed_document(probed: Sequence[ProbedEvaluation]) -> dict[str, Any]:
    """Return all figures of probed runs.

    Returns
    -------
    dict
        `every_s`; `runs`: run -> row -> channel -> `rms_um` and `max_um`; `overall`: row ->
        channel -> median and worst of both; `samples`, `probes`, `doubted`: run -> channel ->
        number; `covered`, `half_width_um`: run -> channel -> share of the samples in the band of
        'learnt', and its half width in the median.
    """
    return {
        'every_s': probed[0].every,
        'runs': {
            item.run: residual_document(item.channel, item.rms, item.largest) for item in probed
        },
        'overall': overall_document(probed),
        'samples': {item.run: by_channel(item.channel, item.samples) for item in probed},
        'probes': {item.run: by_channel(item.channel, item.probes) for item in probed},
        'doubted': {item.run: by_channel(item.channel, item.doubted) for item in probed},
        'covered': {
            item.run: dict(zip(item.channel, item.covered.tolist(), strict=True))
            for item in probed
        },
        'half_width_um': {
            item.run: dict(zip(item.channel, (1e6 * item.half_width).tolist(), strict=True))
            for item in probed
        },
    }


def probed_section(item: ProbedEvaluation) -> Section:
    """Return a section on a probed run, for a page."""
    return Section(
        f'Run {item.run}, {_every(item)}',
        tables=(probed_table([item]),),
        remarks=probed_lines([item]),
        figures=(
            Figure(
                f'{item.run}: remaining error, {_every(item)}',
                'The gain of the model over probing alone is the distance between the line of '
                'the last probe, held without a model, and that of the model corrected by the '
                'same probes.',
                probed_chart(item),
            ),
        ),
    )


def probed_chart(item: ProbedEvaluation) -> Chart:
    """Declare what is left unprobed, with the last probe held, and learnt."""
    x, unit = time_axis(item.time)
    panels = [
        Panel(
            x,
            Axis('thermal error', 'µm'),
            [
                Series(candidate_label(name), 1e6 * item.residual[name][:, c], colour, width)
                for name, colour, width in _DRAWN
            ],
            title=channel,
            rules=[Rule(0.0, MUTED)],
        )
        for c, channel in enumerate(item.channel)
    ]
    return Chart(Axis('time', unit), panels, columns=min(2, len(panels)), height=2.6)


def _no_better_than_held(item: ProbedEvaluation) -> list[str]:
    """Return the channels on which probes say as much without the model as with it."""
    worse = item.rms[LEARNT] >= item.rms[HELD]
    return [name for name, beaten in zip(item.channel, worse, strict=True) if beaten]


def _every(item: ProbedEvaluation) -> str:
    return f'probed every {item.every / 60.0:g} min'


def _range(count: Counts) -> str:
    """Return the numbers of the channels as one, or from the least to the most."""
    low, high = int(count.min()), int(count.max())
    return str(low) if low == high else f'{low} to {high}'


def by_channel(channel: Sequence[str], count: Counts) -> dict[str, int]:
    """Return a count (c,) of each channel."""
    return dict(zip(channel, count.tolist(), strict=True))
