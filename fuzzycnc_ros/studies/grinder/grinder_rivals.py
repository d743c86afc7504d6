# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The models that compete on the simulated grinder, with the settings of the page on networks."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fuzzycnc_ros.core.thermal.fit import (
    Anfis,
    GreyAnfis,
    GreyModel,
    HybridFilterNetwork,
    LagRidge,
    LeastSquares,
    StaticRidge,
)
from fuzzycnc_ros.papers.grey import GreyVariant
from fuzzycnc_ros.papers.learners import GaussianProcess, Mlp
from fuzzycnc_ros.papers.networks import Arma, DynamicNetwork, LinearNetwork, StaticNetwork


@dataclass(frozen=True)
class Rival:
    """A model to compare.

    Parameters
    ----------
    name : str
        Name of its row in documents; that of the candidate where it has a candidate's settings.
    make : callable
        Returns the unfitted estimator of one axis for a seed.
    label : str
        Name of its row for people; that of the candidate if empty.
    """

    name: str
    make: Callable[[int], Any]
    label: str = ''


def _published_hybrid(seed: int, **settings: Any) -> HybridFilterNetwork:
    """Return the hybrid without guard and anchoring, its MA filter over one sample."""
    plain: dict[str, Any] = {'guard': False, 'anchored': False, 'moving_average': 'first'}
    return HybridFilterNetwork(**{**plain, **settings}, random_state=seed)


RIVALS: tuple[Rival, ...] = (
    Rival('least_squares', lambda seed: LeastSquares()),
    Rival('static_ridge', lambda seed: StaticRidge(ridge=1e-3), 'Static ridge, 1e-3'),
    Rival('static_ridge_strong', lambda seed: StaticRidge(ridge=1e-2), 'Static ridge, 1e-2'),
    Rival('lag_ridge', lambda seed: LagRidge(ridge=1e-3), 'LagRidge, 1e-3'),
    Rival('lag_ridge_strong', lambda seed: LagRidge(ridge=1e-2), 'LagRidge, 1e-2'),
    Rival('classical_grey', lambda seed: GreyModel('classical')),
    Rival('convolution_grey', lambda seed: GreyVariant('convolution')),
    Rival('optimised_grey', lambda seed: GreyVariant('optimised')),
    Rival('discrete_grey', lambda seed: GreyVariant('discrete')),
    Rival('stable_grey', lambda seed: GreyModel('stable')),
    Rival('anfis', lambda seed: Anfis(random_state=seed)),
    Rival('grey_anfis', lambda seed: GreyAnfis(random_state=seed)),
    Rival('gaussian_process', lambda seed: GaussianProcess()),
    Rival('mlp', lambda seed: Mlp(random_state=seed)),
    Rival('arma', lambda seed: Arma()),
    Rival('static_network', lambda seed: StaticNetwork(random_state=seed)),
    Rival('dynamic_network', lambda seed: DynamicNetwork(random_state=seed)),
    Rival('linear_network', lambda seed: LinearNetwork(random_state=seed)),
    Rival(
        'hybrid_teacher',
        lambda seed: _published_hybrid(seed, refits=0, ridge=1e-6),
        'Hybrid, teacher forcing, 1e-6',
    ),
    Rival('hybrid_plain', lambda seed: _published_hybrid(seed, refits=3), 'Hybrid, own history'),
    Rival(
        'hybrid_first',
        lambda seed: HybridFilterNetwork(moving_average='first', random_state=seed),
        'Hybrid, guarded, 1 min',
    ),
    Rival(
        'hybrid_spaced',
        lambda seed: HybridFilterNetwork(delays=(10, 20, 30), random_state=seed),
        'Hybrid, guarded, 10 to 30 min',
    ),
    Rival('hybrid_network', lambda seed: HybridFilterNetwork(random_state=seed)),
)
"""Models in the order of the tables: baselines, grey and fuzzy models, the family of
[kang2007]."""
