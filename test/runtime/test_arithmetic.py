# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a process computes with is told in words, and compared."""

import os
import subprocess
import sys

import pytest
from processors import C_LIBRARY

from fuzzycnc_ros.components.thermal.compensator import Compensator
from fuzzycnc_ros.runtime.arithmetic import apart, arithmetic
from fuzzycnc_ros.runtime.provenance import configuration_record

TELL = 'from fuzzycnc_ros.runtime.arithmetic import arithmetic; print(arithmetic())'


def elsewhere(**variables: str) -> str:
    """Return what a process computes with that these variables tell to use less."""
    command = [sys.executable, '-c', TELL]
    return subprocess.run(
        command, env={**os.environ, **variables}, capture_output=True, text=True, check=True
    ).stdout.strip()


def test_a_configuration_says_what_its_node_computes_with():
    version, _, told = configuration_record(Compensator(), 0).version.partition(' ')
    assert version[0].isdigit()
    assert told == arithmetic()
    assert apart([told, told], arithmetic()) == ''


# A BLAS that is older than the processor takes the least kernel for it by itself.
OTHER_KERNEL = 'Nehalem' if 'kernel=Prescott' in arithmetic() else 'Prescott'


@pytest.mark.parametrize('setting', [{'OPENBLAS_CORETYPE': OTHER_KERNEL}, C_LIBRARY])
def test_other_instructions_are_another_kind_of_processor(setting):
    if 'kernel= ' in arithmetic() and 'OPENBLAS_CORETYPE' in setting:
        pytest.skip('numpy computes with another BLAS here')
    told = elsewhere(**setting)
    assert apart([told], arithmetic()).startswith('on another kind of processor (')
    assert apart([told], told) == ''


def test_the_version_of_scipy_is_told_without_its_import():
    script = f'{TELL}; import sys; assert "scipy" not in sys.modules; import scipy; '
    script += 'print(f"scipy={scipy.__version__}")'
    command = [sys.executable, '-c', script]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    told, version = done.stdout.splitlines()
    assert version in told.split()


def test_other_libraries_are_no_other_processor():
    text = apart(['x86_64 kernel=Zen numpy=1'], 'x86_64 kernel=Zen numpy=2')
    assert text == 'with other libraries (numpy=1, here numpy=2)'
    assert 'another kind' in apart(
        ['x86_64 kernel=Zen numpy=1'], 'x86_64 kernel=Cooperlake numpy=2'
    )


def test_what_another_version_says_of_something_else_is_no_difference():
    """Bags recorded before had the C library's functions as `functions=`, at other arguments."""
    here = 'x86_64 FMA3 libm=1f numpy=2'
    assert apart(['x86_64 FMA3 functions=ab numpy=2'], here) == ''
    text = apart(['x86_64 functions=ab numpy=2'], here)
    assert text == 'on another kind of processor (nothing of it, here FMA3)'
    text = apart(['x86_64 FMA3 libm=2e numpy=2'], here)
    assert text == 'on another kind of processor (libm=2e, here libm=1f)'
