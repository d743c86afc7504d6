# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A wish to end is heeded wherever it meets the process."""

import signal

import pytest
from processes import wait_for

from fuzzycnc_ros.bags.uninterrupted import Interrupted
from fuzzycnc_ros.ros.processes import interruptible


class Finalised:
    """Gets a signal while it is finalised, where Python can only print what is raised."""

    def __del__(self):
        signal.raise_signal(signal.SIGTERM)


def never():
    """Return False."""
    return False


def test_wish_that_meets_a_finaliser_is_repeated():
    with interruptible() as wish:
        item = Finalised()
        with pytest.raises(Interrupted):  # noqa: PT012
            del item
            wait_for(never, 'nothing: the wish ends this')
    assert wish.number == signal.SIGTERM


def test_other_errors_that_are_lost_are_told_as_ever(monkeypatch):
    told = []
    monkeypatch.setattr('sys.unraisablehook', told.append)

    class Faulty:
        def __del__(self):
            raise ValueError

    with interruptible():
        item = Faulty()
        del item
    assert [lost.exc_type for lost in told] == [ValueError]
