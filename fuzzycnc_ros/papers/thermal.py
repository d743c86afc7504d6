# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""All thermal models that are compared: those of a model file, and their rivals."""

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType

from fuzzycnc_ros.core.thermal.fit.candidates import CONTENDERS, Contender
from fuzzycnc_ros.core.thermal.fit.training import DRIVEN
from fuzzycnc_ros.papers.grey import GreyVariant
from fuzzycnc_ros.papers.learners import GaussianProcess, Mlp
from fuzzycnc_ros.papers.names import COMPARED
from fuzzycnc_ros.papers.networks import Arma, DynamicNetwork, LinearNetwork, StaticNetwork

_RIVALS = {
    'convolution_grey': Contender(partial(GreyVariant, 'convolution'), chosen=False),
    'optimised_grey': Contender(partial(GreyVariant, 'optimised'), chosen=False),
    'discrete_grey': Contender(partial(GreyVariant, 'discrete'), chosen=False),
    'arma': Contender(Arma, network=True, chosen=False),
    'static_network': Contender(StaticNetwork, network=True),
    'dynamic_network': Contender(DynamicNetwork, network=True),
    'linear_network': Contender(LinearNetwork, network=True),
    'gaussian_process': Contender(GaussianProcess, network=True),
    'gaussian_process_speed': Contender(GaussianProcess, network=True),
    'mlp': Contender(Mlp, network=True),
    'mlp_speed': Contender(Mlp, network=True),
}

ALL_CONTENDERS: Mapping[str, Contender] = MappingProxyType(
    {name: {**CONTENDERS, **_RIVALS}[name] for name in (*COMPARED, DRIVEN)}
)
"""Estimator of each compared model, in the order of tables."""
