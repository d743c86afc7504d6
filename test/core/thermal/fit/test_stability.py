# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A hundred random streams of plausible temperatures, and what models make of them.

Streams hold steps of heat, drop-outs bridged by the last value, wrong readings and warm restarts.
Models that training may choose stay within 1.5 times of what they were trained on, by themselves
or, on a machine whose parts were only ever warm together, by their bound; the published forms
that nothing guards do not.
"""

import numpy as np
import pytest
from random_streams import largest_output, random_streams

from fuzzycnc_ros.core.thermal.fit import select_sensors, train_model
from fuzzycnc_ros.core.thermal.fit.anfis import Anfis, GreyAnfis
from fuzzycnc_ros.core.thermal.fit.grey import GreyModel
from fuzzycnc_ros.core.thermal.fit.hybrid import HybridFilterNetwork
from fuzzycnc_ros.core.thermal.fit.linear import LagRidge, LeastSquares, StaticRidge
from fuzzycnc_ros.core.thermal.recursions.base import BoundedRecursion, bound_of, combine
from fuzzycnc_ros.papers.learners import GaussianProcess, Mlp
from fuzzycnc_ros.papers.networks import Arma, DynamicNetwork, LinearNetwork, StaticNetwork
from fuzzycnc_ros.simulation.thermal.duties import record_runs
from fuzzycnc_ros.simulation.thermal.grinder_runs import record_flux_case, record_grinder

FACTOR = 1.5
CLAMP = 50e-6
TRAINING = ('D0', 'T1', 'D0b')

STANDARD = [
    LeastSquares(),
    StaticRidge(),
    LagRidge(),
    GreyModel(),
    GreyAnfis(),
    HybridFilterNetwork(),
    GaussianProcess(samples_max=100),
    Mlp(),
]
OTHERS = [Anfis(), StaticNetwork(), DynamicNetwork(), LinearNetwork()]
UNGUARDED = [
    GreyModel('classical'),
    GreyModel('derived'),
    Arma(),
    HybridFilterNetwork(moving_average='first', ridge=1e-6, guard=False, anchored=False, refits=0),
]


class Machine:
    """Training samples of a machine, and streams in its manner."""

    def __init__(self, runs, sensors, channels=slice(None), streams=100):
        self.rise = np.concatenate([run.rise()[:, run.columns(sensors)] for run in runs])
        self.displacement = np.concatenate([run.displacement[:, channels] for run in runs])
        self.label = np.repeat(np.arange(len(runs)), [len(run.time) for run in runs])
        self.range = np.abs(self.displacement).max(axis=0)
        self.streams = random_streams(self.rise, count=streams)

    def fitted(self, model):
        """Return the recursion of all channels."""
        make, settings = type(model), model.get_params()
        return combine(
            [
                make(**settings).fit(self.rise, target, runs=self.label).recursion_
                for target in self.displacement.T
            ]
        )

    def largest(self, recursion):
        """Return the largest output in training ranges, and in metres."""
        ranges = largest_output(lambda rise: recursion.run(rise) / self.range, self.streams)
        return ranges, largest_output(recursion.run, self.streams)


@pytest.fixture(scope='module')
def mill():
    runs = record_runs(seed=0)
    training = [runs[name] for name in TRAINING]
    return Machine(training, select_sensors(training).chosen)


@pytest.fixture(scope='module')
def flux():
    """The case on which the published network runs away."""
    run = record_flux_case('regular', 0.02, 100)
    return Machine([run], run.sensor, slice(1))


@pytest.fixture(scope='module')
def grinder():
    runs = record_grinder(('E1', 'E3')).values()
    return Machine(list(runs), next(iter(runs)).sensor, streams=50)


@pytest.mark.parametrize('model', STANDARD, ids=repr)
def test_models_stay_near_what_they_were_trained_on(mill, flux, model):
    assert mill.largest(mill.fitted(model))[0] <= FACTOR
    ranges, metres = flux.largest(flux.fitted(model))
    assert ranges <= FACTOR
    assert metres <= CLAMP


@pytest.mark.parametrize('model', UNGUARDED, ids=repr)
def test_unguarded_forms_do_not(flux, model):
    assert flux.largest(flux.fitted(model))[0] > FACTOR


def test_what_training_chooses_stays_near_too(mill):
    runs = record_runs(seed=0)
    model = train_model([runs[name] for name in TRAINING])
    streams = [
        [np.pad(piece, ((0, 0), (0, len(model.drivers)))) for piece in stream]
        for stream in random_streams(
            np.concatenate(
                [runs[name].rise()[:, runs[name].columns(model.inputs)] for name in TRAINING]
            )
        )
    ]
    assert largest_output(lambda rise: model.predict(rise) / mill.range, streams) <= FACTOR


@pytest.mark.slow
@pytest.mark.parametrize(
    'model', [LagRidge(), GreyAnfis(), HybridFilterNetwork(), *OTHERS], ids=repr
)
def test_a_bound_keeps_models_near_where_nothing_like_it_was_trained_on(grinder, model):
    """In Z the grinder's parts pull against each other; warmed apart they add up."""
    recursion = grinder.fitted(model)
    assert grinder.largest(recursion)[0] > FACTOR
    ranges, metres = grinder.largest(BoundedRecursion(recursion, bound_of(grinder.displacement)))
    assert ranges <= FACTOR * (1.0 + 1e-12)
    assert metres <= CLAMP
