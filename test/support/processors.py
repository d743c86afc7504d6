# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Settings under which this computer computes as one with another processor does."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy._core import _multiarray_umath as numpy_core

C_LIBRARY = {'GLIBC_TUNABLES': 'glibc.cpu.hwcaps=-FMA,-AVX2'}
_WIDEST = ('X86_V4', 'AVX512_ICL', 'AVX512_SPR')


def _without(*features: str) -> dict[str, str]:
    """Return what keeps numpy from features, as far as it was built for them and they are here."""
    present = [
        name
        for name in numpy_core.__cpu_dispatch__
        if numpy_core.__cpu_features__[name] and (not features or name in features)
    ]
    return {'NPY_DISABLE_CPU_FEATURES': ' '.join(present)}


OLDEST = {**_without(), **C_LIBRARY, 'OPENBLAS_CORETYPE': 'Prescott'}
"""A processor without any of it; an older numpy, whose features have other names, included."""

SETTINGS = {
    'numpy without AVX-512': _without(*_WIDEST),
    'numpy without AVX2': _without(),
    'C library without FMA': C_LIBRARY,
    **{
        f'BLAS for {name}': {'OPENBLAS_CORETYPE': name}
        for name in ('Haswell', 'Nehalem', 'Prescott', 'SkylakeX', 'Zen')
    },
    'BLAS on two threads': {'OPENBLAS_NUM_THREADS': '2', 'OMP_NUM_THREADS': '2'},
    'Haswell': {**_without(*_WIDEST), 'OPENBLAS_CORETYPE': 'Haswell'},
    'oldest': OLDEST,
}


def result_under(settings: dict[str, str], script: Path, *arguments: str) -> Any:
    """Return what a script prints as JSON in a process with some settings."""
    kept = {k: v for k, v in os.environ.items() if k not in ('OPENBLAS_CORETYPE', *OLDEST)}
    done = subprocess.run(
        [sys.executable, str(script), *arguments],
        env={**kept, **settings},
        capture_output=True,
        text=True,
        timeout=3600.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def _fingerprints() -> dict[str, str]:
    """Return what depends on the settings: some results of each library, in hexadecimal."""
    values = np.random.Generator(np.random.PCG64(1)).uniform(0.1, 9.0, 3000)
    found = {
        'C library': [math.exp(value) for value in values],
        'BLAS': [float(values[at : at + 300] @ values[:300]) for at in range(0, 2700, 300)],
        'numpy': np.log(values).tolist(),
    }
    return {kind: ' '.join(map(float.hex, results)) for kind, results in found.items()}


if __name__ == '__main__':
    print(json.dumps(_fingerprints()))
