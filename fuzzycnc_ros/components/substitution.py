# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rises of a model's inputs, with cluster mates standing in for sensors that failed.

A mate's rise times the gain that was trained keeps the residual within 6 um (Y) and 4 um (Z) of
the mill of method sheet 001 section 8.C in the worst of 50 cases; taking the dead sensor for
zero costs up to 42 um.
"""

import numpy as np

from fuzzycnc_ros.components.records import Bools, Floats, Names, SensorSelection, ThermalReference
from fuzzycnc_ros.core.thermal import ModelMismatchError, ThermalModel
from fuzzycnc_ros.core.thermal.mate_vote import MateVote

MATES_MAX = 4
"""Mates that may vote on a sensor or stand in for it."""

VOTING_CORRELATION = 0.95
"""Correlation in training that a mate needs to vote: 0.65 is enough to stand in, not to judge."""


class RiseSource:
    """Pick each input's rise out of a sample.

    Parameters
    ----------
    model : ThermalModel
        The model; its selection names the mates.
    sensor : tuple of str
        Sensors of the stream, in its order.
    reference : ThermalReference
        Temperatures that rises are meant against.
    selection : SensorSelection, optional
        A published selection; its mates take precedence for sensors that it chose too.
    vote : MateVote, optional
        Watches for slow faults.

    Raises
    ------
    ModelMismatchError
        If the stream or the reference lacks an input of the model.
    """

    def __init__(
        self,
        model: ThermalModel,
        sensor: Names,
        reference: ThermalReference,
        selection: SensorSelection | None,
        vote: MateVote | None = None,
    ) -> None:
        model.check_stream(sensor, model.interval)
        position = {name: index for index, name in enumerate(sensor)}
        zero = dict(zip(reference.sensor, reference.temperature.tolist(), strict=True))
        self.sensor = sensor
        self._inputs = model.inputs
        self._interval = model.interval
        self._vote = vote
        self._reference = np.array([zero.get(name, np.nan) for name in sensor])
        self._columns = np.array([position[name] for name in model.inputs])
        self._mates: list[list[str]] = []
        size = len(model.inputs)
        self._mate_columns = np.zeros((size, MATES_MAX), dtype=np.int64)
        self._gains = np.full((size, MATES_MAX), np.nan)
        self._votes = np.zeros((size, MATES_MAX), dtype=np.bool_)
        mates = _mates(model, selection)
        for row, name in enumerate(model.inputs):
            usable = [
                (mate, gain, correlation)
                for mate, gain, correlation in mates.get(name, ())
                if mate in position and np.isfinite(zero.get(mate, np.nan))
            ][:MATES_MAX]
            self._mates.append([mate for mate, *_ in usable])
            for column, (mate, gain, correlation) in enumerate(usable):
                self._mate_columns[row, column] = position[mate]
                self._gains[row, column] = gain
                self._votes[row, column] = correlation >= VOTING_CORRELATION
            if not usable and not np.isfinite(zero.get(name, np.nan)):
                raise ModelMismatchError(
                    f'the thermal reference lacks {name} and all of its mates; '
                    'set it anew while the machine is cold'
                )
        self.substituted: Names = ()
        self.substitute: Names = ()
        self.lost: Names = ()
        self.voted_out: Names = ()
        """Inputs that read something, but not what their mates expect."""

    def rise(self, temperature: Floats, good: Bools) -> Floats | None:
        """Return the rises of the inputs, shape (p,) [K]; None if one cannot be had.

        Parameters
        ----------
        temperature : ndarray, shape (s,)
            Sample of all sensors [degC].
        good : ndarray, shape (s,)
            Which readings may be used.
        """
        rises = np.where(good, temperature - self._reference, np.nan)
        rise: Floats = rises[self._columns]
        expected = self._gains * rises[self._mate_columns]
        usable = np.isfinite(rise)
        if self._vote is not None:
            votes = np.where(self._votes, expected, np.nan)
            faulty = usable & self._vote.update(rise, votes, self._interval)
            self.voted_out = tuple(self._inputs[n] for n in np.flatnonzero(faulty))
            usable &= ~faulty
        if usable.all():
            self.substituted = self.substitute = self.lost = ()
            return rise
        replaced, by, lost = [], [], []
        for number in np.flatnonzero(~usable):
            able = np.flatnonzero(np.isfinite(expected[number]))
            if len(able):
                rise[number] = expected[number, able[0]]
                replaced.append(self._inputs[number])
                by.append(self._mates[number][able[0]])
            else:
                lost.append(self._inputs[number])
        self.substituted, self.substitute, self.lost = tuple(replaced), tuple(by), tuple(lost)
        return None if lost else rise


def _mates(
    model: ThermalModel, selection: SensorSelection | None
) -> dict[str, list[tuple[str, float, float]]]:
    """Return the mates of each input with gain and correlation, best first."""
    mates = {
        cluster.chosen: list(
            zip(cluster.substitute, cluster.gain, cluster.correlation, strict=True)
        )
        for cluster in model.selection.clusters
    }
    if selection is not None:
        for item in selection.cluster:
            if item.chosen in mates:
                gains, correlations = item.gain.tolist(), item.correlation.tolist()
                mates[item.chosen] = list(zip(item.substitute, gains, correlations, strict=True))
    return mates
