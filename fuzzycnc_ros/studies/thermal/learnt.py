# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of a machine that is only probed now and then, and what is learnt from run to run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.band import WIDTH, coverage, mean_of_square
from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.core.thermal.fit.training import at_interval, training_interval
from fuzzycnc_ros.core.thermal.fit.training_runs import check_training_runs
from fuzzycnc_ros.core.thermal.learning import Basis, Learner, Verdict
from fuzzycnc_ros.core.thermal.places import motion_of
from fuzzycnc_ros.core.thermal.run import JITTER_MAX, ThermalRun, speed_known
from fuzzycnc_ros.core.thermal.screw_growth import screws_of
from fuzzycnc_ros.studies.page.chart import Axis, Band, Chart, Panel, Rule, Series
from fuzzycnc_ros.studies.page.drawing import AFTER, BEFORE, FAINT, MEASURED, MUTED, time_axis
from fuzzycnc_ros.studies.page.html import Figure, Page, Remark, Section
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.thermal.comparison import residual_document
from fuzzycnc_ros.studies.thermal.judged import narrow_band_remarks
from fuzzycnc_ros.studies.thermal.probed import by_channel, check_every
from fuzzycnc_ros.studies.thermal.report_data import Score
from fuzzycnc_ros.studies.thermal.summary import micrometres

HELD, CARRIED, LEARNT = 'held', 'carried', 'learnt'
"""Rows beside 'uncompensated': the last probe, the knowledge from before the run without its
probes, and all that is learnt."""

FIRST = 4
"""Probes of a run after which a band is one of a machine that is known."""

PHASES = ('unprobed', 'before_the_first', 'first_four', 'later')
"""Parts of a run that its bands are judged in; 'unprobed' is all of it without its probes."""


@dataclass(frozen=True, eq=False)
class LearntRun:
    """Residuals of a run that was probed now and then, of a model that began with nothing.

    Parameters
    ----------
    run : str
        Name of the run.
    every : float
        Time between two probes of a channel [s].
    channel : tuple of str, length c
        Channels.
    time : ndarray, shape (n,)
        Time of each sample [s].
    probes, doubted : ndarray of int, shape (c,)
        Probes taken, and those of them that were not believed.
    probed : ndarray of bool, shape (n, c)
        Samples at which a probe was taken.
    rms, largest : mapping of str to ndarray, shape (c,)
        Root mean square and largest residual of 'uncompensated', 'held', 'carried', 'learnt' [m].
    measured : ndarray, shape (n, c)
        Measured error [m]; NaN where there was none.
    predicted, deviation : ndarray, shape (n, c)
        Prediction from the probes before each sample, and its standard deviation [m].
    covered, half_width : mapping of str to ndarray, shape (c,)
        Share of the samples within the band [-], and its half width over the root mean square of
        the residual [-], for each of `PHASES`; NaN where a run has no such part.
    """

    run: str
    every: float
    channel: tuple[str, ...]
    time: Array
    probes: NDArray[np.int64]
    doubted: NDArray[np.int64]
    probed: NDArray[np.bool_]
    rms: Mapping[str, Array]
    largest: Mapping[str, Array]
    measured: Array
    predicted: Array
    deviation: Array
    covered: Mapping[str, Array]
    half_width: Mapping[str, Array]

    @property
    def inside(self) -> Array:
        """Share of all samples within the band, shape (c,) [-]."""
        return coverage(self.measured - self.predicted, self.deviation)


def learn_runs(
    runs: Sequence[ThermalRun],
    every: float,
    *,
    carry: bool = True,
    noise: float = 0.5e-6,
    seed: int | None = None,
) -> Iterator[LearntRun]:
    """Walk through runs in their order, and learn from a probe now and then.

    Parameters
    ----------
    runs : sequence of ThermalRun
        Runs of one machine, each from its thermal start.
    every : float
        Time between two probes of a channel [s]; where nothing was measured when one is due, the
        next displacement is taken.  A probe acts from the next sample on.
    carry : bool
        Whether what was learnt is carried from run to run; else each begins with nothing.
    noise : float
        Standard deviation of a probe [m].
    seed : int, optional
        Seed of as much noise on the probes; without one they are as recorded.

    Yields
    ------
    LearntRun
        The residuals of each run in turn.

    Raises
    ------
    ThermalDataError
        If runs cannot be used together, or `every` is shorter than their interval.
    """
    interval = training_interval(runs)
    even = [at_interval(run, interval) for run in runs]
    check_training_runs(even)
    check_every(every, interval, 'the runs')
    speed = all(speed_known(run) for run in even)
    screws = screws_of(even[0].channel, [run.drives for run in even])
    basis = Basis(len(even[0].sensor), speed, interval, screws=screws)
    random = None if seed is None else np.random.default_rng(seed)
    learner = Learner(basis, even[0].channel)
    for number, run in enumerate(even):
        if number and carry:
            learner.begin_run()
        elif number:
            learner = Learner(basis, run.channel)
        probes = run.displacement
        if random is not None:
            probes = probes + noise * random.standard_normal(probes.shape)
        yield _followed(learner, run, probes, every, noise)


def _followed(
    learner: Learner,
    run: ThermalRun,
    probes: Array,
    every: float,
    noise: float,
) -> LearntRun:
    """Let a learner follow a run from its reference to its end."""
    shape = run.displacement.shape
    speeds = np.zeros(shape[0]) if run.spindle_speed is None else run.spindle_speed
    moved = motion_of(run.drives, learner.basis.axes, shape[0])
    before = deepcopy(learner)
    predicted = {name: np.zeros(shape) for name in (UNCOMPENSATED, HELD, CARRIED, LEARNT)}
    deviation = {name: np.zeros(shape) for name in (CARRIED, LEARNT)}
    held, due = np.zeros(shape[1]), np.full(shape[1], run.time[0] + every)
    probed, doubted = np.zeros(shape, dtype=np.bool_), np.zeros(shape[1], dtype=np.int64)
    slack = JITTER_MAX * learner.basis.interval
    for row, (rise, now) in enumerate(zip(run.rise(), speeds, strict=True)):
        for name, item in ((CARRIED, before), (LEARNT, learner)):
            item.step(rise, float(now), run.time[row] - run.time[0], moved[row])
            predicted[name][row], deviation[name][row] = item.predict()
        predicted[HELD][row] = held
        taken = np.isfinite(probes[row]) & (run.time[row] >= due - slack)
        if not taken.any():
            continue
        probed[row] = taken
        held = np.where(taken, probes[row], held)
        due = np.where(taken, run.time[row] + every, due)
        verdicts = learner.probe(np.where(taken, probes[row], np.nan), np.full(shape[1], noise))
        doubted += verdicts == Verdict.REJECTED
    measured = run.displacement
    scores = {
        name: [Score.of(*pair) for pair in zip((measured - values).T, measured.T, strict=True)]
        for name, values in predicted.items()
    }
    number: NDArray[np.int64] = np.cumsum(probed, axis=0) - probed  # probes before each sample
    parts = {
        'before_the_first': number == 0,
        'first_four': (number > 0) & (number <= FIRST),
        'later': number > FIRST,
    }
    left = measured - predicted[LEARNT]
    bands = {'unprobed': (measured - predicted[CARRIED], deviation[CARRIED])}
    for name, part in parts.items():
        bands[name] = np.where(part, left, np.nan), deviation[LEARNT]
    return LearntRun(
        run=run.name,
        every=every,
        channel=run.channel,
        time=run.time,
        probes=probed.sum(axis=0),
        doubted=doubted,
        probed=probed,
        rms={name: np.array([score.rms for score in own]) for name, own in scores.items()},
        largest={name: np.array([score.max for score in own]) for name, own in scores.items()},
        measured=measured,
        predicted=predicted[LEARNT],
        deviation=deviation[LEARNT],
        covered={name: coverage(*bands[name]) for name in PHASES},
        half_width={name: _half_width(*bands[name]) for name in PHASES},
    )


def _half_width(residual: Array, deviation: Array) -> Array:
    """Return the half width of the band over the root mean square of a residual (n, c), (c,)."""
    width = np.where(np.isnan(residual), np.nan, WIDTH * deviation)
    with np.errstate(divide='ignore'):
        return np.asarray(np.sqrt(mean_of_square(width) / mean_of_square(residual)))


def learnt_table(found: Sequence[LearntRun]) -> Table:
    """Return what each run leaves in each way to use its probes, a row per run [um]."""
    columns = [Column('Run', numeric=False), Column('probes')]
    for name in found[0].channel:
        columns += [
            Column(heading, name)
            for heading in ('none', 'probe held', 'before probes', 'learnt', 'in band %', '± µm')
        ]
    rows = []
    for item in found:
        cells = [item.run, '/'.join(map(str, dict.fromkeys(item.probes.tolist())))]
        inside = item.inside
        for channel in range(len(item.channel)):
            cells += [
                micrometres(item.rms[name][channel])
                for name in (UNCOMPENSATED, HELD, CARRIED, LEARNT)
            ]
            cells.append(f'{100.0 * inside[channel]:.0f}')
            cells.append(micrometres(WIDTH * float(np.median(item.deviation[:, channel]))))
        rows.append(tuple(cells))
    every = found[0].every / 60.0
    title = f'Learnt from nothing, probed every {every:g} min: root mean square error [µm]'
    return Table(title, tuple(columns), tuple(rows))


LINES = (
    'none: the machine as it is; probe held: the last probe, without any model; before probes: '
    'what the runs before have taught; learnt: what the probes of this run teach as well.',
    'Each sample is judged against the probes before it. ± is the half width of the band, two '
    'predicted standard deviations, in the median.',
)
"""Meaning of the figures for readers."""


def learnt_lines(found: Sequence[LearntRun]) -> list[str]:
    """Return what else is to be said below the table, a line each."""
    lines = list(LINES)
    for item in found:
        if item.doubted.any():
            number = int(item.doubted.sum())
            lines.append(f'{item.run}: {number} of {int(item.probes.sum())} probes doubted')
        worse = item.rms[LEARNT] > item.rms[HELD]
        names = [name for name, lost in zip(item.channel, worse, strict=True) if lost]
        if names:
            lines.append(f'{item.run}: on {", ".join(names)} the last probe, held, does better')
    return lines


def narrow_bands(found: Sequence[LearntRun]) -> list[Remark]:
    """Return the runs of which the band holds too little, a sentence each."""
    return [
        remark
        for item in found
        for remark in narrow_band_remarks(item.run, item.channel, item.inside)
    ]


def learnt_document(found: Sequence[LearntRun]) -> dict[str, Any]:
    """Return all figures.

    Returns
    -------
    dict
        `every_s`; `runs`: run -> row -> channel -> `rms_um` and `max_um`; `probes`, `doubted`:
        run -> channel -> number; `band`: run -> phase -> channel -> share `covered` of the band
        and its `half_width_per_rms`.
    """
    return {
        'every_s': found[0].every,
        'runs': {
            item.run: residual_document(item.channel, item.rms, item.largest) for item in found
        },
        'probes': {item.run: by_channel(item.channel, item.probes) for item in found},
        'doubted': {item.run: by_channel(item.channel, item.doubted) for item in found},
        'band': {
            item.run: {
                phase: {
                    name: {'covered': float(inside), 'half_width_per_rms': float(width)}
                    for name, inside, width in zip(
                        item.channel, item.covered[phase], item.half_width[phase], strict=True
                    )
                }
                for phase in PHASES
            }
            for item in found
        },
    }


def learnt_page(found: Sequence[LearntRun], facts: Mapping[str, str]) -> Page:
    """Return the page of all runs."""
    remarks = [line.text for line in narrow_bands(found)] + learnt_lines(found)
    table = Section('Runs', tables=(learnt_table(found),), remarks=remarks)
    figures = [
        Figure(
            f'{item.run}: error, prediction and probes',
            'The area is the band of two predicted standard deviations about the prediction.',
            learnt_chart(item),
        )
        for item in found
    ]
    return Page(
        title='A thermal model, learnt from nothing but probes',
        summary='No calibration: what is known of the machine comes from its probes, run by run.',
        sections=(table, Section('Along the runs', figures=tuple(figures))),
        facts=facts,
    )


def learnt_chart(item: LearntRun) -> Chart:
    """Declare measured error, prediction with its band, and probes of a run."""
    x, unit = time_axis(item.time)
    panels = []
    for c, channel in enumerate(item.channel):
        known = item.predicted[:, c], item.deviation[:, c]
        probed = np.where(item.probed[:, c], item.measured[:, c], np.nan)
        panels.append(learnt_panel(x, channel, item.measured[:, c], known, probed))
    return Chart(Axis('time', unit), panels, columns=min(2, len(panels)), height=2.6)


def learnt_panel(
    x: Array,
    channel: str,
    error: Array,
    known: tuple[Array, Array],
    probes: Array,
    rules: Sequence[Rule] = (),
) -> Panel:
    """Declare the error of a channel, its prediction with the band, and probes.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Time.
    channel : str
        Name of the channel.
    error : ndarray, shape (n,)
        Error [m].
    known : tuple of two ndarray, shape (n,)
        Prediction and its standard deviation [m].
    probes : ndarray, shape (n,)
        Probed error [m]; NaN where there was no probe.
    rules : sequence of Rule
        Further lines.
    """
    center, half = 1e6 * known[0], 1e6 * WIDTH * known[1]
    return Panel(
        x,
        Axis('thermal error', 'µm'),
        [
            Series('error', 1e6 * error, MEASURED, 1.2),
            Series('learnt', center, AFTER, 1.2),
            Series('probes', 1e6 * probes, BEFORE, 4.0, kind='dots'),
        ],
        title=channel,
        bands=[Band('band', center - half, center + half, FAINT)],
        rules=[Rule(0.0, MUTED), *rules],
    )
