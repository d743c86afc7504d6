# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Relief from stick-slip hunting at rest: hold where it is good, dither loose where it is not.

Any integral action, an observer's too, hunts where friction falls once the axis moves: it winds up
until the axis breaks away, and the axis slips 30 to 60 um within the lags of drive and sensor,
before anything can be known of it.  [long2014] says nothing of friction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite

from fuzzycnc_ros.core.servo.constants import Constant


@dataclass(frozen=True, kw_only=True)
class StickSlipParams:
    """Detection of a stuck axis, and the remedy.

    Parameters
    ----------
    still_band : float
        An axis whose reading stays within this of where it stopped is still [m].
    still_time : float
        How long it has to be for a judgement [s].
    proof : float
        Change of duty [-] that does not move it and so proves friction; without it, at rest on
        target without friction, nothing is ever held.
    hold_error : float
        Mean error up to which a stuck axis is left where it is, duty held [m].
    loose_error : float
        Mean error beyond which it is dithered loose, and beyond which a held one is let go [m].
    reached_error : float
        Mean error at which dithering ends [m].
    zone : float
        Error up to which a stuck axis is dithered at all [m]; farther off, the controller pulls.
    patience : float
        How long an axis may be stuck off target before it is dithered [s]; one that was stuck on
        the other side before is at once.
    half_period : float
        Half a period of the dither [s].
    growth : float
        Growth of the dither's amplitude [1/s]; it stops growing within `reached_error`.
    decay : float
        Its decay afterwards [1/s].
    start_amplitude, amplitude_max : float
        Amplitude to begin and to end with [-], as duty; 0 as the largest turns dithering off.
    settle_time : float
        How long the mean error has to be within `reached_error` [s].
    mean_time : float
        Time constant of the mean error and mean duty [s].

    Raises
    ------
    ValueError
        If a value is negative or not finite, or a time or band is 0.
    """

    still_band: float = 1.3e-6
    still_time: float = 0.015
    proof: float = 0.004
    hold_error: float = 1.0e-6
    loose_error: float = 1.3e-6
    reached_error: float = 0.75e-6
    zone: float = 300e-6
    patience: float = 0.15
    half_period: float = 2e-3
    growth: float = 2.4
    decay: float = 10.0
    start_amplitude: float = 0.03
    amplitude_max: float = 0.5
    settle_time: float = 0.024
    mean_time: float = 0.01

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (isfinite(value) and value >= 0.0):
                raise ValueError(f'StickSlipParams: {name}: expected 0 or more but found {value}')
        for name in ('still_band', 'still_time', 'half_period', 'mean_time'):
            if getattr(self, name) == 0.0:
                raise ValueError(
                    f'StickSlipParams: {name}: expected a positive number but found 0'
                )

    @classmethod
    def for_sensor(cls, count: float, noise: float) -> StickSlipParams:
        """Return bands that a sensor can tell apart; those of 0.625 um and finer stay.

        Parameters
        ----------
        count, noise : float
            One count and the RMS of the noise [m].

        Examples
        --------
        >>> f'{StickSlipParams.for_sensor(5e-6, 0.0).still_band:.3g}'
        '1.04e-05'
        """
        plain = cls()
        factor = max(count / 0.625e-6, noise / 0.1e-6, 1.0)
        bands = ('still_band', 'hold_error', 'loose_error', 'reached_error')
        return replace(plain, **{name: factor * getattr(plain, name) for name in bands})


class StickSlipRelief:
    """Takes the duty over from a controller while the axis is stuck at a steady reference.

    Three states.  *off*: the controller's duty goes through.  *holding*: the axis is stuck near
    enough; its duty is frozen, so that nothing winds up.  *dithering*: a square wave, as fast as
    the drive follows, is added to the controller's duty and grows until the axis floats on it;
    friction then acts like a damper, the controller's own disturbance estimate comes out free of
    breakaway, and the axis creeps to its target.  There the dither dies away and the duty is held.

    Parameters
    ----------
    params : StickSlipParams
        Times and bands.
    period : float
        Control period [s].

    Attributes
    ----------
    state : str
        `''` (off), `'holding'` or `'dithering'`.
    amplitude : float
        Amplitude of the dither [-].
    """

    def __init__(self, params: StickSlipParams, period: float) -> None:
        self.params = params
        self._mean = min(period / params.mean_time, 1.0)
        self._still_count = max(round(params.still_time / period), 1)
        self._patience = round(params.patience / period)
        self._half = max(round(params.half_period / period), 1)
        self._grow, self._fade = params.growth * period, params.decay * period
        self._settled = round(params.settle_time / period)
        self.reset(0.0)

    def constants(self) -> list[Constant]:
        """Return the numbers that it computes with."""
        p = self.params
        return [
            Constant('STILL_BAND', p.still_band, 'm', 'Way within which the axis is still'),
            Constant('PROOF', p.proof, '-', 'Change of duty that proves friction'),
            Constant('HOLD_ERROR', p.hold_error, 'm', 'Mean error up to which it is held'),
            Constant(
                'LOOSE_ERROR', p.loose_error, 'm', 'Mean error beyond which it is dithered loose'
            ),
            Constant('REACHED_ERROR', p.reached_error, 'm', 'Mean error at which dithering ends'),
            Constant('ZONE', p.zone, 'm', 'Error up to which it is dithered at all'),
            Constant(
                'START_AMPLITUDE', p.start_amplitude, '-', 'Amplitude that the dither begins with'
            ),
            Constant(
                'AMPLITUDE_MAX', p.amplitude_max, '-', 'Largest amplitude; 0 turns dithering off'
            ),
            Constant('MEAN_SHARE', self._mean, '-', 'Share of a new value in mean error and duty'),
            Constant('AMPLITUDE_GROWTH', self._grow, '-', 'Growth of the amplitude in a period'),
            Constant('AMPLITUDE_DECAY', self._fade, '-', 'Its decay in a period'),
            Constant(
                'STILL_COUNT', self._still_count, '', 'Periods after which a still axis is judged'
            ),
            Constant(
                'PATIENCE', self._patience, '', 'Periods for which it may be stuck off its target'
            ),
            Constant('HALF_WAVE', self._half, '', 'Periods of half a wave of the dither'),
            Constant('SETTLED', self._settled, '', 'Periods near the target after which it ends'),
        ]

    def reset(self, position: float, reference: float | None = None) -> None:
        """Forget what has been seen; the axis reads `position` [m]."""
        self.state = ''
        self.amplitude = 0.0
        self._reference = reference
        self._anchor = position
        self._still = self._good = self._phase = 0
        self._side = 0  # of the target, when the axis was last proven stuck off it
        self._moved = self._proven = False
        self._error = self._duty = self._before = self._held = 0.0

    def release(self) -> None:
        """Give the axis back to the controller, because the reference moves."""
        if self._reference is not None:
            self._leave()
            self._reference = None

    def duty(self, reference: float, position: float, wanted: float, last: float) -> float:
        """Return the duty to command at a reference that stands still.

        Parameters
        ----------
        reference, position : float
            Where the axis is to be and what the sensor reads [m].
        wanted : float
            Duty that the controller wants [-].
        last : float
            Duty that was held in the last period [-].

        Returns
        -------
        float
            Duty [-].
        """
        if reference != self._reference:
            self.reset(position, reference)
            return wanted
        params, mean = self.params, self._mean
        self._duty += (last - self._duty) * mean
        self._error += (reference - position - self._error) * mean
        away = position - self._anchor
        if -params.still_band <= away <= params.still_band:
            self._still += 1
        else:
            self._anchor, self._still = position, 0
            self._moved, self._proven = True, False
        if not self.state:
            if self._still >= self._still_count and self._moved:
                self._judge()
            return wanted
        if self.state == 'dithering':
            return self._dither(wanted)
        if abs(self._error) > params.loose_error:
            self._leave()
            return wanted
        self.amplitude = max(self.amplitude - self._fade, 0.0)
        return self._held + self._wave()

    def _judge(self) -> None:
        """Decide what to do with an axis that has been still for a while."""
        params, error = self.params, abs(self._error)
        if self._still == self._still_count:
            self._before = self._duty
        if not self._proven:
            if abs(self._duty - self._before) <= params.proof:
                return
            self._proven = True
            side = 0 if error <= params.loose_error else 1 if self._error > 0.0 else -1
            slipped = side * self._side < 0
            self._side = side
        else:
            slipped = False
        if error <= params.hold_error:
            self.state, self._held = 'holding', self._duty
        elif params.loose_error < error < params.zone and params.amplitude_max:
            if slipped or self._still >= self._patience:
                self.state, self.amplitude = 'dithering', params.start_amplitude
                self._good = 0

    def _dither(self, wanted: float) -> float:
        """Go on dithering, until the axis is where it should be or is pulled far away."""
        params = self.params
        if abs(self._error) > 2.0 * params.zone:
            self._leave()
            return wanted
        self._held += (wanted - self._held) * self._mean
        if abs(self._error) <= params.reached_error:
            self._good += 1
            if self._good >= self._settled:
                self.state = 'holding'
        else:
            self._good = 0
            self.amplitude = min(self.amplitude + self._grow, params.amplitude_max)
        return wanted + self._wave()

    def _wave(self) -> float:
        """Return the next value of the square wave."""
        self._phase = (self._phase + 1) % (2 * self._half)
        return self.amplitude if self._phase < self._half else -self.amplitude

    def _leave(self) -> None:
        """Give the axis back to the controller."""
        self.state, self.amplitude, self._still = '', 0.0, 0
