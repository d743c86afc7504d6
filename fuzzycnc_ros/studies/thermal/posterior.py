# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The memory of a machine, shown and handed on: what probes have taught of its thermal error."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.blank import blank_model
from fuzzycnc_ros.core.thermal.confirmation import is_right, is_wrong
from fuzzycnc_ros.core.thermal.learning import RISE_UNIT, Basis, Knowledge
from fuzzycnc_ros.core.thermal.model import ModelMismatchError, ThermalModel
from fuzzycnc_ros.core.thermal.prior import LearningPrior
from fuzzycnc_ros.runtime.records import ThermalPosterior
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.thermal.summary import micrometres

SENSORS_SHOWN = 5
"""Sensors of a channel that are listed, those with the largest error first."""


@dataclass(frozen=True, eq=False)
class Memory:
    """Knowledge of a machine for its next run, and where it comes from.

    Parameters
    ----------
    name : str
        Name of its source.
    posterior : ThermalPosterior
        The record.
    model : ThermalModel
        The model whose rest was learnt; one that predicts nothing where all of it was.
    basis : Basis
        The features.
    known : tuple of Knowledge, length c
        What is known of each channel.
    """

    name: str
    posterior: ThermalPosterior
    model: ThermalModel
    basis: Basis
    known: tuple[Knowledge, ...]

    def exported(self) -> ThermalModel:
        """Return a model file's content that begins with this; that probes are right lapses."""
        share = (0.0,) * len(self.known)
        if self.model.prior is not None:
            share = self.model.prior.share
        elif self.model.runs:
            share = (1.0,) * len(self.known)
        return replace(self.model, prior=LearningPrior(self.basis, self.known, share))

    def of_sensors(self, channel: int) -> tuple[Array, Array]:
        """Return the error of a channel where a sensor alone is warmer by 10 K for long.

        Returns
        -------
        error, deviation : ndarray, shape (s,)
            Expected error and its standard deviation [m].
        """
        sensors, known = self.basis.sensors, self.known[channel]
        rows = np.zeros((sensors, self.basis.features))
        rises = 1 + len(self.basis.lags)
        rows[:, : rises * sensors] = RISE_UNIT * np.tile(np.eye(sensors), rises)
        spread = np.einsum('ij,jk,ik->i', rows, known.covariance, rows)
        return rows @ known.mean, np.sqrt(spread)


def memory_of(name: str, posterior: ThermalPosterior, model: ThermalModel | None) -> Memory:
    """Return the memory that a record holds.

    Parameters
    ----------
    name : str
        Name of its source.
    posterior : ThermalPosterior
        The record.
    model : ThermalModel, optional
        The model in use when it was learnt; none where it was learnt from nothing.

    Raises
    ------
    ModelMismatchError
        If it was learnt beside another model.
    ValueError
        If the record is damaged.
    """
    if model is None:
        model = blank_model(posterior.input, posterior.channel, posterior.interval)
    if model.hash != posterior.model_hash:
        raise ModelMismatchError(
            f'{name}: expected what was learnt beside the model {model.hash[:12]}, but found '
            f'{posterior.model_hash[:12]}; name the file of that model with --model'
        )
    learner = model.learner()
    learner.memory = posterior.memory
    known = tuple(item.knowledge() for item in learner.posteriors)
    return Memory(name, posterior, model, learner.basis, known)


def memory_table(memories: Sequence[Memory]) -> Table:
    """Return what is known of each channel, a row for each source and channel."""
    columns = (
        Column('Source', numeric=False),
        Column('Channel', numeric=False),
        Column('probes'),
        Column('under an offset', numeric=False),
        Column('µm per 10 K, all sensors'),
        Column('± µm'),
        Column('drift µm'),
        Column('change %'),
    )
    rows = []
    for item in memories:
        for number, channel in enumerate(item.model.channel):
            known = item.known[number]
            warm = np.zeros(item.basis.features)
            warm[: (1 + len(item.basis.lags)) * item.basis.sensors] = RISE_UNIT
            spread = np.sqrt(warm @ known.covariance @ warm)
            rows.append(
                (
                    item.name,
                    channel,
                    str(int(item.posterior.probes[number])),
                    _confirmed(item.posterior.evidence[number : number + 1]),
                    micrometres(float(warm @ known.mean)),
                    micrometres(2.0 * float(spread)),
                    micrometres(known.scales.drift),
                    f'{100.0 * known.scales.change:.0f}',
                )
            )
    return Table('Learnt of each channel, for the next run', columns, tuple(rows))


def sensor_lines(item: Memory) -> list[str]:
    """Return the sensors with the largest part in each channel's error, a line each."""
    lines = []
    for number, channel in enumerate(item.model.channel):
        error, deviation = item.of_sensors(number)
        order = np.argsort(-np.abs(error), kind='stable')[:SENSORS_SHOWN]
        parts = [
            f'{item.model.inputs[place]} {1e6 * error[place]:+.1f} ± {2e6 * deviation[place]:.1f}'
            for place in order
        ]
        lines.append(f'{item.name}, {channel}, µm per 10 K of one sensor: {", ".join(parts)}')
    return lines


def memory_document(memories: Sequence[Memory]) -> dict[str, Any]:
    """Return all figures.

    Returns
    -------
    dict
        source -> `model_hash`, `reference_ns`, `stamp_ns`, `channels`: channel -> `probes`,
        `evidence`, `scales`, and `sensors`: sensor -> error and deviation per 10 K [um].
    """
    found = {}
    for item in memories:
        channels = {}
        for number, channel in enumerate(item.model.channel):
            error, deviation = item.of_sensors(number)
            channels[channel] = {
                'probes': int(item.posterior.probes[number]),
                'evidence': float(item.posterior.evidence[number]),
                'scales': item.known[number].scales._asdict(),
                'sensors': {
                    name: {'error_um': 1e6 * float(value), 'deviation_um': 1e6 * float(spread)}
                    for name, value, spread in zip(
                        item.model.inputs, error, deviation, strict=True
                    )
                },
            }
        found[item.name] = {
            'model_hash': item.posterior.model_hash,
            'stamp_ns': item.posterior.stamp,
            'reference_ns': item.posterior.reference_stamp,
            'channels': channels,
        }
    return found


def _confirmed(evidence: Array) -> str:
    if is_wrong(evidence)[0]:
        return 'wrong'
    return 'confirmed' if is_right(evidence)[0] else 'not yet'
