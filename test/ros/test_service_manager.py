# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a process tells a service manager, on real sockets."""

import pytest
from managers import Manager

from fuzzycnc_ros.ros.service_manager import ServiceManager


@pytest.fixture(params=['path', 'abstract'])
def manager(request, tmp_path):
    with Manager(tmp_path if request.param == 'path' else None) as found:
        yield found


def test_the_protocol_is_that_of_systemd(manager):
    environment = {**manager.environment(watchdog=0.0), 'OTHER': '1'}
    service = ServiceManager(environment)
    assert environment == {'OTHER': '1'}  # what it starts is not asked
    assert service.present
    service.status('coming\nup')
    service.status('coming up')
    service.ready()
    service.ready()
    service.pulse()
    service.stopping()
    assert manager.heard() == ['STATUS=coming up', 'READY=1', 'WATCHDOG=1', 'STOPPING=1']


def test_signs_of_life_come_as_often_as_they_are_waited_for(manager):
    service = ServiceManager(manager.environment(watchdog=3600.0))
    for _ in range(5):
        service.pulse()
    assert manager.heard() == ['WATCHDOG=1']


def test_no_signs_of_life_are_sent_that_nobody_waits_for(manager):
    service = ServiceManager(manager.environment())
    service.pulse()
    service.ready()
    assert manager.heard() == ['READY=1']


def test_without_a_manager_nothing_is_told():
    service = ServiceManager({'WATCHDOG_USEC': '1000'})
    assert not service.present
    service.ready()
    service.pulse()
    service.stopping()


def test_a_manager_that_is_busy_is_not_waited_for_and_learns_it_later(manager):
    service = ServiceManager(manager.environment())
    while service._tell('STATUS=a flood'):
        pass
    service.ready()
    assert set(manager.heard()) == {'STATUS=a flood'}
    service.ready()
    assert manager.heard() == ['READY=1']


def test_a_manager_that_is_gone_ends_nothing(tmp_path):
    with Manager(tmp_path) as gone:
        service = ServiceManager(gone.environment(watchdog=0.0))
    service.ready()
    service.pulse()
