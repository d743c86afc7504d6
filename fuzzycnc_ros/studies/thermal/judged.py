# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Judged models and their results, in sentences that pages and terminals share."""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.thermal.band import is_false_band
from fuzzycnc_ros.core.thermal.candidate import DEFAULT, UNCOMPENSATED
from fuzzycnc_ros.core.thermal.fit.evaluation import pooled_coverage
from fuzzycnc_ros.studies.page.html import Remark
from fuzzycnc_ros.studies.thermal.summary import candidate_label, has_diverged, micrometres

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal.fit import Evaluation
    from fuzzycnc_ros.core.thermal.model import ThermalModel

    Figures = Mapping[str, NDArray[np.float64]]


def remarks_on(
    judged: 'Evaluation', band: Remark | None, refused: Collection[str] = ()
) -> list[Remark]:
    """Return what a reader of a judged run has to know: window, start, domain, band, losses.

    Parameters
    ----------
    judged : Evaluation
        The run.
    band : Remark, optional
        What `run_band_remark` says of it; absent if the reader has seen that already.
    refused : collection of str
        Candidates that are not to be trusted.
    """
    remarks = [Remark(window_text(judged))]
    if judged.warm:
        remarks.append(Remark(warm_text(judged.run, judged.warm), True))
    if band is not None:
        remarks.append(band)
    remarks += loss_remarks(judged.run, judged.channel, judged.rms)
    return remarks + plain_remarks(judged.run, judged.channel, judged.rms, refused)


def window_text(judged: 'Evaluation') -> str:
    """Return what was judged, and how much of it is in the domain."""
    window = span_text(judged.run, judged.time, judged.channel, judged.samples)
    return f'{window}; {100.0 * judged.in_domain:.0f} % of them in the domain of the training'


def span_text(
    run: str, time: NDArray[np.float64], channel: Sequence[str], samples: Sequence[int]
) -> str:
    """Return the first and the last time that were judged, and the samples of each channel."""
    return f'{run}: judged from {time[0]:g} to {time[-1]:g} s, {samples_text(channel, samples)}'


def samples_text(channel: Sequence[str], samples: Sequence[int]) -> str:
    """Return how many samples were measured, channel by channel where they differ.

    Examples
    --------
    >>> samples_text(('Y', 'Z'), (480, 480)), samples_text(('Y', 'Z'), (480, 96))
    ('480 samples', 'samples: 480 of Y, 96 of Z')
    """
    if len(set(samples)) == 1:
        return f'{samples[0]} samples'
    each = [f'{count} of {name}' for name, count in zip(channel, samples, strict=True)]
    return f'samples: {", ".join(each)}'


def training_remark(
    run: str, trained_on: Mapping[str, float], recognised: bool, training: Sequence[str]
) -> Remark:
    """Return how much of what was judged the model was trained on.

    Parameters
    ----------
    run : str
        Name of the judged run.
    trained_on : mapping of str to float
        Training runs that judged samples come from, and their share [-].
    recognised : bool
        Whether samples that were trained on would have been recognised.
    training : sequence of str
        Names of all training runs.
    """
    if trained_on:
        share = max(1.0, 100.0 * min(1.0, sum(trained_on.values())))
        about = 'about ' if share < 99.5 else ''
        return Remark(
            f'{about}{share:.0f} % of the judged samples of {run} were trained on '
            f'({", ".join(trained_on)}): this is no test',
            True,
        )
    if not recognised:
        return Remark(
            f'{run}: whether the model was trained on these samples is unknown; its file does '
            'not identify the training samples',
            True,
        )
    same = ', but on others of a run of that name' if run in training else ''
    return Remark(f'{run}: no model was trained on these samples{same}')


def warm_text(run: str, warm: Mapping[str, float]) -> str:
    """Return that a run began on a warm machine."""
    return (
        f'{run}: the machine was warm when the run began: {kelvins(warm)}; its rises mean '
        'something else than in training, so none of its samples is in the domain'
    )


def kelvins(warm: Mapping[str, float]) -> str:
    """Return by how much sensors are off, such as 'front +6.2 K, rear -1.5 K'."""
    return ', '.join(f'{name} {kelvin:+.1f} K' for name, kelvin in warm.items())


def band_remark(
    run: str,
    channel: Sequence[str],
    covered: NDArray[np.float64],
    half_width: NDArray[np.float64],
    ratio: NDArray[np.float64],
    independent: NDArray[np.float64],
    runs: int = 1,
) -> Remark:
    """Return how much of what is left the band holds, how wide it is, and whether it is false.

    Parameters
    ----------
    run : str
        Name of the run.
    channel : sequence of str, length c
        Channels.
    covered, half_width, ratio, independent : ndarray, shape (c,)
        As in `Evaluation`, where the third is `band_ratio`.
    runs : int
        Number of runs that are judged, each by itself.
    """
    each = [
        f'{100.0 * share:.0f} % of {name} (\u00b1{micrometres(width)} \u00b5m)'
        for name, share, width in zip(channel, covered, half_width, strict=True)
        if np.isfinite(share)
    ]
    text = f'{run}: the band of two standard deviations holds {", ".join(each)}'
    figures = zip(channel, covered, ratio, independent, strict=True)
    false = {
        name: count
        for name, share, size, count in figures
        if is_false_band(share, size, count, runs)
    }
    if not false:
        return Remark(text)
    counts = '/'.join(dict.fromkeys(f'{count:.0f}' for count in false.values()))
    return Remark(
        f'{text}; it should cover 95 %, and chance does not explain so little of '
        f'{", ".join(false)} (as good as {counts} independent samples): {_ADVICE}',
        True,
    )


NARROW = 0.8
"""Share of the samples of a run in the band of what was learnt, below which it is said first."""


def narrow_band_remarks(
    run: str, channel: Sequence[str], covered: NDArray[np.float64]
) -> list[Remark]:
    """Return that the band of what probes have taught holds too little of a run, if it does.

    Parameters
    ----------
    run : str
        Name of the run.
    channel : sequence of str, length c
        Channels.
    covered : ndarray, shape (c,)
        Share of the samples in the band [-]; NaN where nothing was measured.
    """
    narrow = [
        f'{100.0 * share:.0f} % of {name}'
        for name, share in zip(channel, covered, strict=True)
        if share < NARROW
    ]
    if not narrow:
        return []
    text = f'{run}: the learnt band covers {", ".join(narrow)}; it should cover 95 %'
    return [Remark(f'{text}: probe more often', True)]


_ADVICE = 'do not rely on it, and train on runs like this as well'


def run_band_remark(judged: 'Evaluation', runs: int = 1) -> Remark:
    """Return `band_remark` of a run, one of `runs` that are judged, each by itself."""
    figures = judged.covered, judged.half_width, judged.band_ratio, judged.independent
    return band_remark(judged.run, judged.channel, *figures, runs=runs)


def overall_band_remarks(judged: 'Sequence[Evaluation]') -> list[Remark]:
    """Return that the band holds far less than it promises over several runs, if it does."""
    pooled = zip(judged[0].channel, *pooled_coverage(judged), strict=True)
    false = [
        f'{100.0 * each[0]:.0f} % of {name}' for name, *each in pooled if is_false_band(*each)
    ]
    if not false or len(judged) == 1:
        return []
    text = f'over {len(judged)} runs the band holds {", ".join(false)}; it should cover 95 %'
    return [Remark(f'{text}: {_ADVICE}', True)]


def worse_than_none(channel: Sequence[str], rms: 'Figures', name: str = DEFAULT) -> list[str]:
    """Return the channels in which a model leaves more than there was without compensation."""
    pairs = zip(channel, rms[name], rms[UNCOMPENSATED], strict=True)
    return [label for label, left, bare in pairs if left > bare]


def loss_remarks(run: str, channel: Sequence[str], rms: 'Figures') -> list[Remark]:
    """Return that a model is worse than none, in one sentence; nothing where it is not."""
    lost = worse_than_none(channel, rms)
    if not lost:
        return []
    figures = dict(zip(channel, zip(rms[DEFAULT], rms[UNCOMPENSATED], strict=True), strict=True))
    return [Remark(f'{run}: {loss_text({label: figures[label] for label in lost})}', True)]


PLAIN_RATIO = 1.5
"""Residual of the default over that of plain least squares from which it is much worse [-]."""

PLAIN_DIFFERENCE = 0.1e-6
"""Difference below which it is not [m]: tables do not show it."""


def worse_than_plain(
    channel: Sequence[str], rms: 'Figures', refused: Collection[str] = ()
) -> dict[str, tuple[float, float]]:
    """Return where the default is much worse than plain least squares: what both leave [m].

    Nothing where least squares are not among the candidates, or are not to be trusted.
    """
    if PLAIN in refused or PLAIN not in rms:
        return {}
    pairs = zip(channel, rms[DEFAULT], rms[PLAIN], strict=True)
    return {
        label: (float(left), float(plain))
        for label, left, plain in pairs
        if left > max(PLAIN_RATIO * plain, plain + PLAIN_DIFFERENCE)
    }


def plain_remarks(
    run: str, channel: Sequence[str], rms: 'Figures', refused: Collection[str] = ()
) -> list[Remark]:
    """Return that the default is much worse than plain least squares, in one sentence."""
    worse = worse_than_plain(channel, rms, refused)
    if not worse:
        return []
    figures = ', '.join(
        f'{micrometres(left)} \u00b5m instead of {micrometres(plain)} \u00b5m on {label}'
        for label, (left, plain) in worse.items()
    )
    return [
        Remark(f'{run}: the default leaves much more than plain least squares: {figures}', True)
    ]


PLAIN = 'least_squares'
"""Candidate that every other should at least equal."""


def loss_text(losing: Mapping[str, tuple[float, float]]) -> str:
    """Return in which channels a model is worse than none.

    Parameters
    ----------
    losing : mapping of str to (float, float)
        Channel -> root mean square with the model and without [m].

    Examples
    --------
    >>> loss_text({'y': (26.6e-6, 9.4e-6)})
    'worse than no compensation on y: 26.6 \u00b5m remain of 9.4 \u00b5m'
    """
    figures = ', '.join(_left_of(left, bare) for left, bare in losing.values())
    return f'worse than no compensation on {", ".join(losing)}: {figures}'


def _left_of(left: float, bare: float) -> str:
    """Return two residuals in as many digits as tell them apart."""
    if has_diverged(left):
        return f'it diverges, where there are {micrometres(bare)} \u00b5m without'
    digits = next((n for n in (1, 2, 3) if f'{1e6 * left:.{n}f}' != f'{1e6 * bare:.{n}f}'), 4)
    return f'{1e6 * left:.{digits}f} \u00b5m remain of {1e6 * bare:.{digits}f} \u00b5m'


def choice_remarks(model: 'ThermalModel') -> list[Remark]:
    """Return which channels a model leaves alone and which it makes worse, and what follows."""
    remarks = []
    if model.uncompensated:
        remarks.append(
            Remark(
                f'{", ".join(model.uncompensated)} '
                + ('stays' if len(model.uncompensated) == 1 else 'stay')
                + ' uncompensated, since no model was better beyond chance on held-out samples'
            )
        )
    if model.losing:
        names = dict.fromkeys(
            candidate_label(used)
            for channel, used in zip(model.channel, model.default, strict=True)
            if channel in model.losing
        )
        remarks.append(
            Remark(
                f'{", ".join(names)} is {loss_text(model.losing)} on held-out samples; '
                'thermal_predictor refuses this model unless its parameter force is true '
                f'(`fuzzycnc up --force-model`); `fuzzycnc train --model auto` leaves '
                f'{", ".join(model.losing)} uncompensated',
                True,
            )
        )
    return remarks
