# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `sensor_selector`: calibration runs in, the few sensors that represent them out.

Selection is an act of calibration, never of operation: sensors that were swapped while a part is
being cut would move the compensation without any change of the machine.  So nothing happens
until it is asked for.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from fuzzycnc_ros.components.thermal.kept_samples import KeptSamples
from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.remedies import Remedy, remedied
from fuzzycnc_ros.core.thermal.places import along_axes
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun
from fuzzycnc_ros.core.thermal.sensor_limits import JUDGED, SensorLimits
from fuzzycnc_ros.core.thermal.sensor_watch import InputSelection
from fuzzycnc_ros.runtime.component import (
    LATCHED,
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.enums import Status
from fuzzycnc_ros.runtime.records import (
    Displacement,
    Record,
    SensorCluster,
    SensorSelection,
    Temperatures,
    nanoseconds,
)


class RunReader(Protocol):
    """Reads the run in a bag."""

    def __call__(self, bag: str, /, *, sensor_limits: Sequence[str]) -> ThermalRun:
        """Return the run; its sensors have limits of their own."""


PAUSE = nanoseconds(4 * 3600.0)
"""Machine time without a sample after which another run begins [ns]: the machine has cooled."""


@dataclass(frozen=True, kw_only=True)
class SensorSelectorConfig(Config):
    """Parameters of `sensor_selector`."""

    clusters: int = param(5, '-', 'Number of clusters, and so of sensors', low=1, high=30)
    ranking: str = param(
        'correlation',
        '-',
        'Ranking inside the clusters',
        choices=('correlation', 'grey_grade'),
    )
    refine: bool = param(True, '-', 'Whether better ranked members compete on held-out runs')
    seed: int = param(0, '-', 'Seed of the clustering', low=0, high=2**31 - 1)
    sensor_limits: tuple[str, ...] = param(
        (),
        '-',
        'Limits of single sensors in the bags, as SENSOR:LIMIT:VALUE, such as bed*:rate_max:0.7; '
        'limits: range_low, range_high [degC], rate_max [K/s]',
    )


class SensorSelector(Component[SensorSelectorConfig]):
    """Cluster the sensors of calibration runs and choose one per cluster."""

    NAME = 'sensor_selector'
    SUMMARY = 'Chooses few representative sensors from calibration runs, with substitutes.'
    CONFIG = SensorSelectorConfig
    MEASURED = Input('displacement', Displacement, paced=False)
    INPUTS = (MEASURED, Input('temperatures', Temperatures, driving=True))
    OUTPUTS = (Output('sensor_selection', SensorSelection, LATCHED, persistent=True),)

    def __init__(self, config: SensorSelectorConfig | None = None) -> None:
        super().__init__(config)
        SensorLimits.of(self._config.sensor_limits)  # refused before it is asked for
        self.run_reader: RunReader | None = None
        """Reads calibration bags; `prepare` sets it."""
        self._samples = KeptSamples[tuple[Temperatures, Displacement]](lambda pair: pair[0])
        self._selection: SensorSelection | None = None

    def prepare(self, model: str, run_reader: RunReader) -> None:
        """Take the reader of calibration bags."""
        self.run_reader = run_reader

    def on_temperatures(self, sample: Temperatures) -> Iterable[Emission]:
        """Keep the sample if its displacement was measured with it."""
        measured = self.last(self.MEASURED)
        if measured is not None and measured.stamp == sample.stamp:
            newest = self._samples.newest
            if newest is not None and sample.stamp - newest[0].stamp > PAUSE:
                self._samples.clear()
            self._samples.add((sample, measured))
        return ()

    def renewed(self, step: int) -> 'tuple[SensorSelector, list[Emission]]':
        """Forget the samples of the run; a selection stays."""
        self._samples.clear()
        return self, []

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """`select_sensors`: from the named bags, or from the present run if none is named."""
        if name != 'select_sensors':
            return super().on_request(name, arguments, stamp)
        bags = [str(item) for item in arguments.get('bag', ())]
        clusters = int(arguments.get('clusters', 0)) or self._config.clusters
        try:
            runs = self._read(bags) if bags else [self._present_run()]
            chosen = self.select(runs, clusters)
        except ValueError as error:
            refusal = remedied(error)
            return Answer(False, str(error) if refusal is None else refusal.told(_with_parameter))
        self._selection = selection_record(chosen, stamp, self.frame('machine'))
        text = f'{", ".join(chosen.chosen)} from {", ".join(chosen.calibration)}'
        return Answer(True, text, (Emission('sensor_selection', self._selection),))

    def select(self, runs: Sequence[ThermalRun], clusters: int) -> InputSelection:
        """Select with the configured method; see `select_sensors` for the errors."""
        # Loaded on use: a node that is never asked to select starts a second faster.
        from fuzzycnc_ros.core.thermal.fit import select_sensors

        return select_sensors(
            runs,
            n_clusters=clusters,
            method=self._config.ranking,
            refine=self._config.refine,
            random_state=self._config.seed,
        )

    def restore(self, output: str, record: Record) -> None:
        """Take back the selection that was made before a restart."""
        if isinstance(record, SensorSelection):
            self._selection = record

    def health(self) -> list[Health]:
        """Report what is selected."""
        kept = {'samples with displacement': str(len(self._samples))}
        if self._selection is None:
            text = 'nothing selected yet; call select_sensors after a calibration run'
            return [Health('selection', Level.OK, text, kept)]
        names = ', '.join(cluster.chosen for cluster in self._selection.cluster)
        return [Health('selection', Level.OK, f'selected {names}', kept)]

    def _read(self, bags: Sequence[str]) -> list[ThermalRun]:
        if self.run_reader is None:
            raise ThermalDataError('bag: this host cannot read bags; select from the present run')
        limits = self._config.sensor_limits
        return [self.run_reader(bag, sensor_limits=limits) for bag in bags]

    def _present_run(self) -> ThermalRun:
        """Return what was received so far as one run."""
        if not self._samples:
            raise ThermalDataError(
                'bag: none named, and no temperatures with a displacement of the same stamp '
                'were received; name the bags of calibration runs'
            )
        first, measured = next(iter(self._samples))
        temperature = np.array([sample.temperature for sample, _ in self._samples])
        status = np.array([sample.status for sample, _ in self._samples])
        temperature[status != Status.OK] = np.nan
        time = 1e-9 * np.array([sample.stamp - first.stamp for sample, _ in self._samples])
        moved = np.array([item.displacement for _, item in self._samples])
        axis, channel, moved = along_axes(
            time, measured.axis, measured.channel, measured.position, moved
        )
        return ThermalRun(
            name='present run',
            time=time,
            sensor=first.sensor,
            temperature=temperature,
            channel=channel,
            axis=axis,
            displacement=moved,
            limits=JUDGED,
        )


def _with_parameter(remedy: Remedy) -> str:
    """Return a remedy with the parameter that does it, if there is one."""
    limits = remedy.arguments.get('sensor_limits')
    if limits is None:
        return remedy.words
    return f"{remedy.words}: parameter sensor_limits: ['{limits}']"


def selection_record(selection: InputSelection, stamp: int, frame_id: str) -> SensorSelection:
    """Return a selection as the record that is published."""
    return SensorSelection(
        stamp=stamp,
        frame_id=frame_id,
        method=selection.method,
        cluster=tuple(
            SensorCluster(
                member=item.member,
                score=np.array(item.score, dtype=np.float64),
                chosen=item.chosen,
                substitute=item.substitute,
                gain=np.array(item.gain, dtype=np.float64),
                correlation=np.array(item.correlation, dtype=np.float64),
            )
            for item in selection.clusters
        ),
        partition_coefficient=selection.partition_coefficient,
        xie_beni=selection.xie_beni,
        dropped=selection.dropped,
        calibration=selection.calibration,
    )
