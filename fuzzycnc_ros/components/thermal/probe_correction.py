# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What probes do to the prediction of one model: correction, deviation, adaptation, drift alarm.

Published error = prediction + offset + gain * prediction per channel, where offset and gain move
to what the probes say within `correction_time` and never step.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.thermal.fade import Fade
from fuzzycnc_ros.components.thermal.predictor_stream import Probe
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.probing import (
    DriftAlarm,
    GainAdaptation,
    OffsetGainFilter,
    OffsetReset,
    Verdict,
    drift_deviation,
)
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Floats,
    Stamp,
)

FILTERS = {'offset': OffsetReset, 'kalman': OffsetGainFilter}
"""Filter behind each kind of probing; 'none' has none."""


class ProbeCorrection:
    """Correct the predictions of one model by the probes that come with its samples.

    Parameters
    ----------
    model : ThermalModel
        The model.
    config : ThermalPredictorConfig
        Kind of probing, gates, limits.
    """

    def __init__(self, model: ThermalModel, config: ThermalPredictorConfig) -> None:
        channels = len(model.channel)
        self._channel, self._axis = model.channel, model.axis
        self._residual = np.fmin(model.held_out_rms, model.band.deviation)
        kind = FILTERS.get(config.probing)
        self._kind = config.probing
        self._filter = kind and kind(channels, jump_max=config.probe_jump_max)
        self._adaptation = (
            GainAdaptation(channels, config.adaptation) if config.adaptation else None
        )
        self._alarm = DriftAlarm(channels, config.drift_limit)
        self._correction = Fade(np.zeros(2 * channels))
        self._worked_at: Stamp | None = None
        self._predicted: tuple[Stamp, Floats] | None = None
        self._used = 0
        self._rejection = ''
        self.doubted: NDArray[np.int64] = np.zeros(channels, dtype=np.int64)
        """Number of probes of each channel that were not believed, shape (c,)."""

    @property
    def active(self) -> bool:
        """Whether probes have any effect."""
        return self._filter is not None or self._adaptation is not None

    def begin(self) -> None:
        """Begin at a new thermal reference: the error is zero there, and so are its offsets."""
        if self._filter is not None:
            self._filter.forget()
        if self._adaptation is not None:
            self._adaptation.begin()
        self._correction = Fade(self._wanted())
        self._worked_at = self._predicted = None
        self._rejection = ''

    def pause(self) -> None:
        """Note that there is no prediction: nothing can be said of a probe until the next."""
        self._predicted = None

    def apply(
        self,
        stamp: Stamp,
        predicted: Floats,
        deviation: Floats,
        distance: float,
        probes: tuple[Probe, ...],
        duration: float,
    ) -> tuple[Floats, Floats]:
        """Return the corrected error and its standard deviation, shapes (c,) [m].

        Parameters
        ----------
        stamp : int
            Stamp of the sample [ns].
        predicted, deviation : ndarray, shape (c,)
            What the model says of it [m].
        distance : float
            Distance from the training data, 1 at the border of the domain [-].
        probes : tuple of Probe
            Probes since the sample before, oldest first.
        duration : float
            Time in which their correction comes into force [s].
        """
        if not self.active:
            return predicted, deviation
        if self._worked_at is not None:
            self._correction.advance((stamp - self._worked_at) / SECOND)
        for probe in probes:
            self._take(probe, stamp, predicted, distance, duration)
        self._elapse_to(stamp)
        self._predicted = (stamp, predicted)
        offset, gain = np.split(self._correction.value, 2)
        return predicted + offset + gain * predicted, self._deviation(predicted, deviation)

    def health(self) -> list[Health]:
        """Report what the probes do, which was doubted, and whether the model still fits."""
        if not self.active:
            return []
        offset, gain = np.split(self._correction.value, 2)
        values = {}
        for number, name in enumerate(self._channel):
            values[f'offset {name} [um]'] = f'{1e6 * offset[number]:.2f}'
            values[f'gain {name} [%]'] = f'{100.0 * gain[number]:.1f}'
            values[f'cusum {name} [-]'] = f'{self._alarm.sums[:, number].max():.3g}'
        what = self._kind if self._filter is not None else 'adaptation'
        text = f'{what}: {self._used} probes used'
        level = Level.WARN if self._rejection else Level.OK
        return [
            Health('probing', level, self._rejection or text, values),
            *self._drift_health(values),
        ]

    @property
    def blocks(self) -> dict[str, Floats]:
        """States by name, as a checkpoint keeps them; none without probing."""
        if not self.active:
            return {}
        found = {'correction': self._correction.state, 'drift': self._alarm.state}
        if self._filter is not None:
            found[self._kind] = self._filter.state
        if self._adaptation is not None:
            found['adaptation'] = self._adaptation.state
        return found

    def remember(self, blocks: Mapping[str, Floats]) -> None:
        """Take back what outlasts a thermal reference: what belongs to machine and model.

        Raises
        ------
        ValueError
            If a state does not fit; what was taken back before it stays.
        """
        if 'drift' in blocks:
            self._alarm.state = blocks['drift']
        if self._adaptation is not None and 'adaptation' in blocks:
            self._adaptation.state = blocks['adaptation']

    def resume(self, stamp: Stamp, blocks: Mapping[str, Floats]) -> None:
        """Take back the states of an earlier life that ended at `stamp` [ns].

        What was off then, or is off now, begins anew.

        Raises
        ------
        ValueError
            If a state does not fit; what was taken back before it stays.
        """
        self.remember(blocks)
        if self._filter is not None and self._kind in blocks:
            self._filter.state = blocks[self._kind]
        if self.active and 'correction' in blocks:
            self._correction.state = blocks['correction']
        self._worked_at = stamp

    def _take(
        self,
        probe: Probe,
        stamp: Stamp,
        predicted: Floats,
        distance: float,
        duration: float,
    ) -> None:
        """Learn from one probe."""
        measured, noise = probe.of_channels(self._channel, self._axis)
        expected = self._at(probe.stamp, stamp, predicted)
        if expected is None or not np.isfinite(measured).any():
            why = 'nothing was predicted' if expected is None else 'its channels are not predicted'
            self._rejection = f'probe at {probe.stamp / SECOND:.3f} s is not used: {why}'
            return
        self._elapse_to(probe.stamp)
        allowed = drift_deviation(self._residual, distance, noise)
        verdicts = []
        adapted = np.zeros_like(expected)
        if self._adaptation is not None:
            adapted = self._adaptation.gain
        if self._filter is not None:
            # What the adaptation corrects already is none of the filter's business.
            verdicts.append(self._filter.update(expected, measured - adapted * expected, noise))
        if self._adaptation is not None:
            verdicts.append(self._adaptation.update(expected, measured, allowed))
            if self._filter is not None:
                self._filter.absorb(self._adaptation.gain - adapted, expected)
        self._note(probe, verdicts[0], measured - expected)
        measured = np.where(verdicts[0] == Verdict.ACCEPTED, measured, np.nan)
        self._alarm.update((measured - expected) / allowed)
        self._correction.to(self._wanted(), duration)

    def _at(self, probed: Stamp, stamp: Stamp, predicted: Floats) -> Floats | None:
        """Return what was predicted for the time of a probe, None if nothing was."""
        if probed == stamp:
            return predicted
        if self._predicted is None or probed < self._predicted[0]:
            return None
        before, first = self._predicted
        return first + (predicted - first) * ((probed - before) / (stamp - before))

    def _elapse_to(self, stamp: Stamp) -> None:
        if self._worked_at is not None:
            stamp = max(stamp, self._worked_at)
            elapsed = (stamp - self._worked_at) / SECOND
            for part in (self._filter, self._adaptation):
                if part is not None:
                    part.elapse(elapsed)
        self._worked_at = stamp

    def _wanted(self) -> Floats:
        """Return the offsets [m] and gains [-] that the probes call for, shape (2c,)."""
        wanted = np.zeros((2, len(self._channel)))
        if self._filter is not None:
            wanted += self._filter.estimate.T
        if self._adaptation is not None:
            wanted[1] += self._adaptation.gain
        return wanted.ravel()

    def _deviation(self, predicted: Floats, deviation: Floats) -> Floats:
        """Return the deviation: the model's, or the probes' where they know more."""
        if self._filter is None:
            return deviation
        known = np.fmin(deviation, self._filter.deviation(predicted))
        offset, gain = np.split(self._correction.target - self._correction.value, 2)
        # What has not come into force yet is an error that is known.
        return np.asarray(np.hypot(known, offset + gain * predicted))

    def _note(self, probe: Probe, verdict: NDArray[np.int64], residual: Floats) -> None:
        self.doubted += verdict == Verdict.REJECTED
        rejected = [
            f'{name} by {1e6 * value:+.1f} um'
            for name, value, what in zip(self._channel, residual, verdict, strict=True)
            if what == Verdict.REJECTED
        ]
        self._rejection = ''
        if rejected:
            self._rejection = (
                f'probe at {probe.stamp / SECOND:.3f} s misses the model in {", ".join(rejected)} '
                'and is not used; a second one that agrees will be'
            )
        self._used += bool((verdict == Verdict.ACCEPTED).any())

    def _drift_health(self, values: Mapping[str, str]) -> list[Health]:
        if not self._alarm.alarmed.any():
            return []
        figures = [
            f'{name} {mean:+.1f} standard deviations over {count} probes'
            for name, mean, count, alarmed in zip(
                self._channel,
                self._alarm.mean,
                self._alarm.probes,
                self._alarm.alarmed,
                strict=True,
            )
            if alarmed
        ]
        return [
            Health(
                'drift',
                Level.WARN,
                'the model no longer fits the machine, train it anew (train_thermal_model): '
                f'{", ".join(figures)}',
                values,
            )
        ]
