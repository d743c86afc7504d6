# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Lumped thermal network that the simulated machines share: nodes, links, one implicit step."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array


@dataclass(frozen=True, eq=False)
class ThermalNetwork:
    """Lumps of metal, each with a heat capacity, a loss to the surroundings and neighbours.

    Parameters
    ----------
    node : tuple of str, length n
        Names of the nodes, in the order of every array.
    capacity : ndarray, shape (n,)
        Heat capacity of each node [J/K].
    loss : ndarray, shape (n,)
        Loss of each node to the surroundings [W/K].
    conductance : ndarray, shape (n, n)
        Laplacian of the links [W/K]; its rows sum to zero.
    """

    node: tuple[str, ...]
    capacity: Array
    loss: Array
    conductance: Array

    @staticmethod
    def of(
        nodes: Mapping[str, tuple[float, float]], links: Mapping[tuple[str, str], float]
    ) -> 'ThermalNetwork':
        """Build a network from tables in the units of the simulated machines.

        Parameters
        ----------
        nodes : mapping of str to (float, float)
            Heat capacity [kJ/K] and loss [W/K] of each node.
        links : mapping of (str, str) to float
            Conductance between two nodes [W/K].
        """
        index = {name: i for i, name in enumerate(nodes)}
        conductance = np.zeros((len(nodes), len(nodes)))
        for (a, b), value in links.items():
            i, j = index[a], index[b]
            conductance[[i, j], [i, j]] += value
            conductance[[i, j], [j, i]] -= value
        return ThermalNetwork(
            node=tuple(nodes),
            capacity=np.array([1e3 * capacity for capacity, _ in nodes.values()]),
            loss=np.array([loss for _, loss in nodes.values()]),
            conductance=conductance,
        )

    def implicit_euler(self, step: float, loss: Array | None = None) -> tuple[Array, Array]:
        """Solve an implicit Euler step: T' = solved (storage T + loss ambient + heat).

        Parameters
        ----------
        step : float
            Length of the step [s].
        loss : ndarray, shape (n,), optional
            Losses in force [W/K]; those of the network if left out.

        Returns
        -------
        solved : ndarray, shape (n, n)
            Temperatures after the step per power [K/W].
        storage : ndarray, shape (n,)
            Power that a kelvin of each node is worth over the step [W/K].
        """
        storage = self.capacity / step
        lost = self.loss if loss is None else loss
        matrix = np.diag(storage + lost) + self.conductance
        return portable.solve(matrix, np.eye(len(matrix))), storage

    def mean_row(self, *names: str) -> Array:
        """Return weights that average the named nodes, shape (n,) [-]."""
        row = np.zeros(len(self.node))
        row[[self.node.index(name) for name in names]] = 1.0 / len(names)
        return row
