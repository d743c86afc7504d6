# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Learning from the probes that come with the samples: the error of a model, or all of it.

Published error = share of the model's prediction + learnt rest.  A change by a probe comes into
force within `correction_time` and never steps.
"""

from collections import deque
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.thermal.fade import Fade
from fuzzycnc_ros.components.thermal.predictor_stream import ProbedError
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.core.thermal.band import WIDTH
from fuzzycnc_ros.core.thermal.confirmation import is_right, is_wrong, judged
from fuzzycnc_ros.core.thermal.learning import Learner, Verdict
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.places import channel_spans, motion_of
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.enums import ForgetMode
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Bools,
    Floats,
    ProbeStatus,
    Stamp,
    ThermalPosterior,
    nanoseconds,
)

MISSED_MAX = 3.0
"""Root mean square of what probes missed, over the deviation expected [-], that is said aloud:
the machine is not what the probes before have taught."""


FORESEEN_MAX = 86400.0
"""Longest time ahead for which a due probe is reported [s]."""

KEPT = 8
"""Probes before which can be gone back."""


class _Known(NamedTuple):
    """All that was learnt at some time: memory, probes and evidence."""

    memory: Floats
    probes: NDArray[np.int64]
    evidence: Floats


class ProbeLearning:
    """Learn what is left of one model's error, by the probes that come with its samples.

    Parameters
    ----------
    model : ThermalModel
        The model.
    config : ThermalPredictorConfig
        Whether anything is learnt, and the band beyond which a probe is asked for.
    """

    def __init__(self, model: ThermalModel, config: ThermalPredictorConfig) -> None:
        self._model, self._config = model, config
        self._share = np.ones(len(model.channel))
        """Share of the model's prediction in an error, shape (c,) [-]."""
        self._learner: Learner | None = None
        if config.learn:
            self._learner = model.learner()
            self._fresh = self._learner.memory
            if model.prior is not None:
                self._share = np.array(model.prior.share)
        channels = len(model.channel)
        self._jump = Fade(np.zeros(channels))
        """Error published minus error known: what the last probes changed, on its way to zero."""
        self._predicted: tuple[Stamp, Floats] | None = None
        self._worked_at: Stamp | None = None
        self._learnt_at: Stamp = 0
        self.evidence = np.zeros(channels)
        """Evidence that probes see an offset as it is, shape (c,) [-]; see `judged`."""
        self._since: Stamp = 0
        self._probes = np.zeros(channels, dtype=np.int64)
        self._probed_at: Stamp | None = None
        self._doubt = ''
        self._deviation = np.full(channels, np.nan)
        self._change = np.full(channels, np.nan)
        """Change of the error by the newest probe, shape (c,) [m]."""
        self._narrowest: tuple[Floats, Floats] | None = None
        """Time of the narrowest band since the newest probe [ns], and its half width [m]."""
        self.doubted: NDArray[np.int64] = np.zeros(channels, dtype=np.int64)
        """Number of probes of each channel that were not believed, shape (c,)."""
        self._before: deque[_Known] = deque(maxlen=KEPT)
        self.news = False
        """True if something was learnt that has not been published yet."""

    @property
    def active(self) -> bool:
        """True if probes have any effect."""
        return self._learner is not None

    def begin(self, since: Stamp, memory: ThermalPosterior | None) -> None:
        """Begin at a new thermal reference, or go on with what an earlier life has learnt.

        Parameters
        ----------
        since : int
            Stamp of the reference [ns].
        memory : ThermalPosterior, optional
            What an earlier life has learnt, of this model.
        """
        if self._learner is None:
            return
        if memory is not None:
            self._recall(memory)
        begun = self._since
        if memory is not None:
            begun = memory.reference_stamp
        if begun and begun != since:
            self._learner.begin_run()
            self._before.clear()
            self.news = True
        else:
            self._learner.rest()
        self._since, self._jump = since, Fade(np.zeros(len(self._probes)))
        self._worked_at = self._predicted = None

    def pause(self) -> None:
        """Note that there is no prediction: nothing can be said of a probe until the next."""
        self._predicted = None

    def _recall(self, memory: ThermalPosterior) -> None:
        """Take back what was learnt; a damaged memory is none, which is said aloud."""
        assert self._learner is not None
        try:
            self._learner.memory = memory.memory
        except ValueError as error:
            self._doubt = f'what was learnt before is lost: {error}'
            return
        self.evidence = memory.evidence.copy()
        self._probes, self._learnt_at = memory.probes.astype(np.int64), memory.stamp

    def step(
        self,
        rise: Floats,
        speed: float,
        stamp: Stamp,
        drives: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """Go on to a sample.

        Parameters
        ----------
        rise : ndarray, shape (p,)
            Rises of the inputs [K].
        speed : float
            Spindle speed [rad/s]; NaN where it was not told.
        stamp : int
            Machine time [ns].
        drives : mapping of str to float
            What else the control told of heat, see `ThermalRun`.
        """
        if self._learner is not None:
            known = speed if np.isfinite(speed) else 0.0
            motion = motion_of(drives, self._learner.basis.axes)[0]
            self._learner.step(rise, known, self._elapsed(stamp), motion)

    def apply(
        self, stamp: Stamp, predicted: Floats, deviation: Floats, probes: tuple[ProbedError, ...]
    ) -> tuple[Floats, Floats]:
        """Return the error and its standard deviation, probes considered, shapes (c,) [m].

        Parameters
        ----------
        stamp : int
            Stamp of the sample [ns], the last that was stepped to.
        predicted, deviation : ndarray, shape (c,)
            Prediction of the model [m].
        probes : tuple of ProbedError
            Probes since the sample before, oldest first; they act from the next sample on.
        """
        if self._learner is None:
            return predicted, deviation
        predicted = self._share * predicted
        if self._worked_at is not None:
            self._jump.advance((stamp - self._worked_at) / SECOND)
        self._worked_at = stamp
        for probe in probes:
            if probe.stamp > max(self._since, self._learnt_at):
                self._take(probe, stamp, predicted)
        self._predicted = (stamp, predicted)
        learnt, known = self._learner.predict()
        jump = self._jump.value
        # What has not come into force yet is an error that is known.
        self._deviation = np.hypot(known, jump)
        return predicted + learnt + jump, self._deviation

    def _take(self, probe: ProbedError, stamp: Stamp, predicted: Floats) -> None:
        assert self._learner is not None
        expected = self._at(probe.stamp, stamp, predicted)
        before, deviation = self._learner.predict()
        why = 'nothing was predicted' if expected is None else 'its channels are not predicted'
        unused = f'probe at {probe.stamp / SECOND:.3f} s is not used: {why}'
        if expected is None:
            self._doubt = unused
            return
        measured, noise, offset = probe.of_channels(
            self._model.channel, self._model.axis, expected + before, deviation
        )
        if not np.isfinite(measured).any():
            self._doubt = unused
            return
        self._before.append(self._known())
        measured = self._trusted(measured, measured - expected - before, noise, deviation, offset)
        verdicts = self._learner.probe(measured - expected, noise, (stamp - probe.stamp) / SECOND)
        self._come_into_force(before)
        self._probes += verdicts == Verdict.ACCEPTED
        self.doubted += verdicts == Verdict.REJECTED
        self._learnt_at = self._probed_at = stamp
        self._change, self._narrowest = self._learner.predict()[0] - before, None
        doubted = [
            f'{name} by {1e6 * value:+.1f} µm'
            for name, value, verdict in zip(
                self._model.channel, measured - expected - before, verdicts, strict=True
            )
            if verdict == Verdict.REJECTED
        ]
        self._doubt = (
            f'probe at {probe.stamp / SECOND:.3f} s is off in {", ".join(doubted)}, more than is '
            'likely: it is believed if the next one agrees'
            if doubted
            else ''
        )

    def forget(self, mode: ForgetMode) -> str:
        """Know less than the probes have taught; return what was done, in words.

        Raises
        ------
        ValueError
            If nothing was learnt, or there is no probe to go back before.
        """
        if self._learner is None:
            raise ValueError('nothing is learnt; set the parameter learn')
        before, _ = self._learner.predict()
        if mode is ForgetMode.UNDO:
            if not self._before:
                raise ValueError(
                    f'no probe to go back before: {KEPT} are kept, none over a restart or a new '
                    'thermal reference; know less instead, or begin from nothing'
                )
            known = self._before.pop()
            self._learner.memory, self._probes, self.evidence = known
            text = 'back to what was known before the last probe'
        elif mode is ForgetMode.ALL:
            self._learner.memory = self._fresh
            self._probes, self.evidence = np.zeros_like(self._probes), self.evidence * 0.0
            self._before.clear()
            text = 'begun from nothing'
        else:
            self._learner.forget()
            text = 'known less, until probes have taught it anew'
        self._doubt = ''
        self._come_into_force(before)
        return text

    def _known(self) -> '_Known':
        assert self._learner is not None
        return _Known(self._learner.memory, self._probes.copy(), self.evidence.copy())

    def _come_into_force(self, before: Floats) -> None:
        """Let what is known now come into force slowly, where `before` was published [m]."""
        assert self._learner is not None
        after, _ = self._learner.predict()
        self._jump = Fade(self._jump.value + before - after)
        self._jump.to(np.zeros(len(after)), self._config.correction_time)
        self.news = True

    def _trusted(
        self, measured: Floats, missed: Floats, noise: Floats, deviation: Floats, offset: Floats
    ) -> Floats:
        """Return the errors (c,) that may be learnt, NaN for the others.

        Until probes are known to see an offset as it is, one that is taken under a large offset
        is learnt only if it speaks for that: of a wrong sign it would feed on itself.
        """
        spread, before = np.hypot(deviation, noise), self.evidence.copy()
        spans = {
            item.columns[0]: list(item.columns) for item in channel_spans(self._model.channel)
        }
        rest = {column for columns in spans.values() for column in columns[1:]}
        for first in range(len(measured)):
            # Offset and slope of an axis are seen by the same probes: they speak together.
            columns = spans.get(first, [] if first in rest else [first])
            for number in columns:
                if np.isfinite(measured[number]):
                    self.evidence[columns] = judged(
                        float(self.evidence[first]),
                        float(missed[number]),
                        float(spread[number]),
                        float(offset[number]),
                    )
        free = is_right(self.evidence) | (self.evidence > before) | (np.abs(offset) <= spread)
        return np.where(free & ~is_wrong(self.evidence), measured, np.nan)

    def _at(self, probed: Stamp, stamp: Stamp, predicted: Floats) -> Floats | None:
        """Return what the model predicted for the time of a probe, None if nothing."""
        if probed == stamp:
            return predicted
        if self._predicted is None or probed < self._predicted[0]:
            return None
        before, first = self._predicted
        return first + (predicted - first) * ((probed - before) / (stamp - before))

    def _elapsed(self, stamp: Stamp) -> float:
        """Return the time since the thermal reference [s]."""
        return max(stamp - self._since, 0) / SECOND

    @property
    def blocks(self) -> dict[str, Floats]:
        """States by name, as a checkpoint of the run keeps them; none without learning."""
        if self._learner is None:
            return {}
        return {'lags': self._learner.lags, 'jump': self._jump.state}

    def resume(self, stamp: Stamp, rise: Floats, blocks: dict[str, Floats]) -> None:
        """Take back the states of the run that an earlier life ended in.

        Raises
        ------
        ValueError
            If a state does not fit; what was taken back before it stays.
        """
        if self._learner is None or 'lags' not in blocks:
            return
        self._learner.resume(rise, blocks['lags'], self._elapsed(stamp))
        if 'jump' in blocks:
            self._jump.state = blocks['jump']
        self._worked_at = stamp

    def record(self, stamp: Stamp, model_hash: str, frame_id: str) -> ThermalPosterior:
        """Return all that was learnt so far, of the run under way."""
        assert self._learner is not None
        self.news = False
        return ThermalPosterior(
            stamp=stamp,
            frame_id=frame_id,
            model_hash=model_hash,
            reference_stamp=self._since,
            interval=self._model.interval,
            input=self._model.inputs,
            axis=self._model.axis,
            channel=self._model.channel,
            probes=self._probes.astype(np.uint64),
            evidence=self.evidence.copy(),
            memory=self._learner.memory,
        )

    def status(self, stamp: Stamp, frame_id: str) -> ProbeStatus | None:
        """Return whether a probe is due at a sample, and when; None where nothing is learnt."""
        if self._learner is None:
            return None
        half, wanted = WIDTH * self._deviation, self._config.band_wanted
        wide = half > wanted
        since, least = self._narrowest or (np.full(len(half), float(stamp)), half)
        narrower = half <= least
        since, least = np.where(narrower, float(stamp), since), np.where(narrower, half, least)
        self._narrowest = since, least
        growth = (half - least) / np.maximum(stamp - since, 1.0)
        due_at = stamp if wide.any() else 0
        reason = self._reason(wide) if wide.any() else 'the band is narrow enough'
        if not due_at and (growth > 0.0).any():
            left = float(((wanted - half)[growth > 0.0] / growth[growth > 0.0]).min())
            if left < nanoseconds(FORESEEN_MAX):
                due_at = stamp + round(left)
        return ProbeStatus(
            stamp=stamp,
            frame_id=frame_id,
            due=bool(wide.any()),
            reason=reason,
            due_at=due_at,
            probed_at=self._probed_at or 0,
            axis=self._model.axis,
            channel=self._model.channel,
            band=half,
            change=self._change.copy(),
        )

    def health(self) -> list[Health]:
        """Report how well the error is known, which probe was doubted, when to probe next."""
        if self._learner is None:
            return []
        half = WIDTH * self._deviation
        values, known = {}, []
        for number, name in enumerate(self._model.channel):
            values[f'band {name} [um]'] = f'{1e6 * half[number]:.2f}'
            values[f'probes {name} [-]'] = str(self._probes[number])
            if np.isfinite(half[number]):
                known.append(f'{name} to ±{1e6 * half[number]:.1f} µm')
        text = f'{int(self._probes.max())} probes; known: {", ".join(known) or "nothing"}'
        level = Level.WARN if self._doubt else Level.OK
        items = [Health('learning', level, self._doubt or text, values)]
        if (wrong := is_wrong(self.evidence)).any():
            names = ', '.join(np.array(self._model.channel)[wrong])
            text = f'{names}: probes do not see an offset as it is; they are not learnt'
            items.append(Health('probes', Level.WARN, text))
        missed = np.array([item.missed for item in self._learner.posteriors])
        if (missed > MISSED_MAX).any():
            names = ', '.join(np.array(self._model.channel)[missed > MISSED_MAX])
            text = f'{names}: probes miss by far more than expected; has the machine changed?'
            items.append(Health('changed', Level.WARN, text))
        wide = half > self._config.band_wanted
        if wide.any():
            names = ', '.join(np.array(known)[wide])
            items.append(Health('probe due', Level.OK, f'known: {names}; {self._reason(wide)}'))
        return items

    def _reason(self, wide: Bools) -> str:
        """Say why a probe is due."""
        assert self._learner is not None
        if self._probed_at is None or self._worked_at is None:
            return 'not probed yet since the start'
        parts = self._learner.unknown(int(np.argmax(wide)))
        kind = max(parts, key=lambda name: parts[name])
        hours = (self._worked_at - self._probed_at) / SECOND / 3600.0
        return f'mostly unknown: {kind}; the last probe was {hours:.1f} h ago'
