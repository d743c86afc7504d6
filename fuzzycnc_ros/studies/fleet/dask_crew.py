# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The workers of a Dask scheduler, on this host or others, as a crew."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from fuzzycnc_ros.studies.fleet.in_flight import Crew, only
from fuzzycnc_ros.studies.requirement import require

PATIENCE = 20.0
"""Longest wait for the scheduler, and for its first worker [s]."""

PER_WORKER = 2
"""Pieces that each thread of a worker has: one in hand, one on its way."""


@contextmanager
def dask_crew(address: str) -> Iterator[Crew]:
    """Hold a connection to a Dask scheduler as long as the block runs.

    Parameters
    ----------
    address : str
        Address of the scheduler, such as `tcp://10.0.0.7:8786`.

    Raises
    ------
    ModuleNotFoundError
        If Dask is not installed; the message says how to install it.
    ValueError
        If no scheduler answers there, or it has no worker.

    Notes
    -----
    The scheduler gives what a lost worker had in hand to others.
    """
    client = _client(address)
    try:
        threads = sum(client.nthreads().values())
        executor = client.get_executor(pure=False)
        killed = (require('distributed').KilledWorker,)
        yield Crew(only(executor), max(1, PER_WORKER * threads), killed)
    finally:
        client.close(timeout=PATIENCE)


def _client(address: str) -> Any:
    distributed = require('distributed')
    try:
        # A client that is given none hangs for its patience when it is dropped.
        require('distributed.comm').get_address_host_port(address)
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ValueError(
            f'--dask: expected the scheduler of Dask at {address} but {_cause(error)}; start it '
            'with `dask scheduler` and name the address that it prints'
        ) from None
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        client.close(timeout=PATIENCE)
        raise ValueError(
            f'--dask: expected workers at {address} but found none within {PATIENCE:g} s; start '
            f'some with `dask worker {address} --nthreads 1`'
        ) from None
    return client


def _cause(error: Exception) -> str:
    if isinstance(error, OSError):
        return f'nothing answered within {PATIENCE:g} s'
    return f'this is no address ({error})'
