# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rises of a model's inputs, with other sensors standing in for those that failed.

A ridge estimate from all sensors that can be read stands in where the model knows the machine's
sensors.  It keeps the residual of the simulated mill within 6 um (Y) and 4 um (Z), as one cluster
mate's rise times its trained gain does, and costs less in the mean; taking the dead sensor for
zero costs up to 42 um.
"""

import numpy as np

from fuzzycnc_ros.core.thermal.model import ModelMismatchError, ThermalModel
from fuzzycnc_ros.core.thermal.sensor_watch import MateEstimate, SensorWatch
from fuzzycnc_ros.runtime.records import (
    Bools,
    Floats,
    Names,
    SensorSelection,
    ThermalReference,
)

MATES_MAX = 4
"""Cluster mates that may stand in for a sensor."""

RISE_MAX = 1000.0
"""Rise that no part of a machine has [K]: a model would carry it along for hours."""

MISSED_MAX = 0.5
"""Largest RMS error of an estimate in training [K] to replace a sensor without a mate in its
own cluster: no more than the watch tolerates."""


class RiseSource:
    """Pick each input's rise out of a sample.

    Parameters
    ----------
    model : ThermalModel
        The model; its selection names the mates, its watch knows the sensors.
    sensor : tuple of str
        Sensors of the stream, in its order.
    reference : ThermalReference
        Temperatures that rises are meant against.
    selection : SensorSelection, optional
        A published selection; its mates take precedence for sensors that it chose too.
    watch : SensorWatch, optional
        Watches for slow faults; it is of the model's watch.

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
        watch: SensorWatch | None = None,
    ) -> None:
        model.check_stream(sensor, model.interval)
        position = {name: index for index, name in enumerate(sensor)}
        zero = dict(zip(reference.sensor, reference.temperature.tolist(), strict=True))
        self.sensor = sensor
        self._inputs = model.inputs
        self._interval = model.interval
        self._watch = watch
        self._reference = np.array([zero.get(name, np.nan) for name in sensor])
        self._columns = np.array([position[name] for name in model.inputs])
        # Places in the stream of the sensors that the watch knows, -1 where it has none.
        watched = model.watch.sensor if model.watch is not None else ()
        self._places = np.array([position.get(name, -1) for name in watched], np.intp)
        self._estimate = None if model.watch is None else MateEstimate(model.watch)
        published = _published(selection)
        self._mates: list[list[tuple[str, int, float]]] = []
        self._published: list[bool] = []
        for cluster in model.selection.clusters:
            trained = zip(cluster.substitute, cluster.gain, strict=True)
            mates = [
                (mate, position[mate], gain)
                for mate, gain in published.get(cluster.chosen, trained)
                if mate in position and np.isfinite(zero.get(mate, np.nan))
            ][:MATES_MAX]
            self._mates.append(mates)
            self._published.append(cluster.chosen in published)
            if not mates and not np.isfinite(zero.get(cluster.chosen, np.nan)):
                raise ModelMismatchError(
                    f'the thermal reference lacks {cluster.chosen} and all of its mates; '
                    'set it anew while the machine is cold'
                )
        self.substituted: Names = ()
        self.substitute: Names = ()
        """For each of them the mate that is most like it; others may contribute."""
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
        rises[np.abs(rises) > RISE_MAX] = np.nan
        rise: Floats = rises[self._columns]
        usable = np.isfinite(rise)
        if self._watch is not None and self._estimate is not None:
            faulty = usable & self._watch.update(self._watched(rises), self._interval)
            self.voted_out = tuple(self._inputs[n] for n in np.flatnonzero(faulty))
            usable &= ~faulty
        if usable.all():
            self.substituted = self.substitute = self.lost = ()
            return rise
        # What failed must not stand in for others.
        rises[self._columns[~usable]] = np.nan
        replaced, by, lost = [], [], []
        for number in np.flatnonzero(~usable):
            name = self._inputs[number]
            mate, rise[number] = self._stand_in(int(number), rises)
            if mate:
                replaced.append(name)
                by.append(mate)
            else:
                lost.append(name)
        self.substituted, self.substitute, self.lost = tuple(replaced), tuple(by), tuple(lost)
        return None if lost else rise

    def _stand_in(self, number: int, rises: Floats) -> tuple[str, float]:
        """Return the best mate of an input and the rise that stands in for it; '' if none."""
        first, estimate = '', np.nan
        for mate, column, gain in self._mates[number]:
            if np.isfinite(rises[column]):
                first, estimate = mate, gain * float(rises[column])
                break
        if self._estimate is None or self._published[number]:
            return first, estimate
        found = self._estimate.of(number, self._watched(rises))
        if first:
            return first, found.rise
        return (found.mate, found.rise) if found.missed <= MISSED_MAX else ('', np.nan)

    def _watched(self, rises: Floats) -> Floats:
        """Return the rises in the order of the watch, NaN where the stream has none."""
        return np.where(self._places >= 0, rises[self._places], np.nan)


def _published(selection: SensorSelection | None) -> dict[str, list[tuple[str, float]]]:
    """Return the mates that a published selection names, with their gains, best first."""
    if selection is None:
        return {}
    return {
        item.chosen: list(zip(item.substitute, item.gain.tolist(), strict=True))
        for item in selection.cluster
    }
