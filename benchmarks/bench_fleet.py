# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thousands of bags judged on a Dask scheduler: what a second worker gains, what the cache saves.

Makes bags of 3 sensors and 300 samples, varied from one warm-up of a machine, and judges them with
`fuzzycnc_ros.studies.fleet`: on one worker process, on two, again from the cache, and in one
process without Dask, whose figures have to be the same to the last bit.  What counts are ratios:
two workers take at most 0.6 of the time of one, a run from the cache 0.02 of the first.  No fleet
gains more than the computer gives: where two processors are the threads of one core, computations
that share nothing gain as little, so their ratio is measured in the same turns and printed too.
With `--sizes 100,1000,10000` it also prints how time and memory of the driver grow.
Run with `python benchmarks/bench_fleet.py`; it needs the extra `fleet`, and an idle computer.
"""

import os

# One thread, set before numpy starts its pool, and handed down to the workers.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

import argparse
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).parents[1] / 'test' / 'support'))

from distributed import Client
from fleet_bags import DAY, FIRST_DAY, SAMPLES, SENSORS, warm_up, write_bag

from fuzzycnc_ros.bags.finding import find_bags
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.studies.fleet.dask_crew import dask_crew
from fuzzycnc_ros.studies.fleet.evaluation import evaluate_fleet, read_models

MACHINES = 4
TURN = 500
COMPUTATIONS = 8
RATIO_MAX, CACHED_MAX = 0.6, 0.02

WORKER = """
import sys
from distributed import LocalCluster
cluster = LocalCluster(
    n_workers=int(sys.argv[1]), threads_per_worker=1, dashboard_address=':0', host='127.0.0.1'
)
print(cluster.scheduler_address, flush=True)
sys.stdin.read()
cluster.close()
"""


def make_shop(folder: Path, count: int) -> list[Path]:
    """Write bags of some machines, one of which drifts; return their places in order."""
    places = []
    for number in range(count):
        machine, day = f'mill_{number % MACHINES + 1}', number // MACHINES
        place = folder / machine / f'{machine}_{day:05d}'
        drift = 2e-8 * day if machine == 'mill_2' else 0.0
        if not place.exists():
            write_bag(warm_up(number + 100, drift), place, FIRST_DAY + day * DAY, machine)
        places.append(place)
    return places


@contextmanager
def scheduler(workers: int) -> Iterator[str]:
    """Run a Dask scheduler with worker processes in a process of its own; return its address."""
    process = subprocess.Popen(
        [sys.executable, '-c', WORKER, str(workers)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        yield process.stdout.readline().strip()
    finally:
        process.stdin.close()
        process.wait(60.0)


def judged(
    places: list[Path], model: Path, out: Path, address: str = '', cache: Path | None = None
) -> float:
    """Judge bags, on the workers of a scheduler or in this process; return the time it took."""
    with dask_crew(address) if address else nullcontext() as crew:
        begin = perf_counter()
        models, _ = read_models([model])
        evaluate_fleet(
            find_bags(places), models, out, crew=crew, cache=cache or out.with_suffix('.cache')
        )
        return perf_counter() - begin


def computed(address: str) -> float:
    """Return what the workers of a scheduler take for computations that share nothing [s]."""
    with Client(address) as client:
        begin = perf_counter()
        client.gather([client.submit(_compute, key, pure=False) for key in range(COMPUTATIONS)])
        return perf_counter() - begin


def _compute(key: int) -> int:
    return sum(number * key for number in range(2_000_000))


def main() -> None:
    """Print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--bags', type=int, default=2000)
    parser.add_argument('--sizes', default='', help='numbers of bags, such as 100,1000,10000')
    parser.add_argument('--keep', type=Path, help='folder of bags that is made once')
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        shop = given.keep or folder / 'shop'
        sizes = [int(text) for text in given.sizes.split(',') if text]
        places = make_shop(shop, max(given.bags, *sizes, 0))
        model = folder / 'model.json'
        model.write_text(train_model([warm_up(1), warm_up(2)]).to_json(), encoding='utf-8')
        judged(places[:4], model, folder / 'warm.parquet')  # imports, and the hash of the code
        print_ratios(places[: given.bags], model, folder)
        if sizes:
            print_growth(sizes, places, model, folder)


def print_ratios(places: list[Path], model: Path, folder: Path) -> None:
    """Print what a second worker gains and what the cache saves."""
    print(f'{len(places)} bags of {len(SENSORS)} sensors and {SAMPLES} samples')
    counts = (1, 2)
    times: dict[int, list[float]] = {workers: [] for workers in counts}
    given = dict.fromkeys(counts, 0.0)
    with scheduler(1) as one, scheduler(2) as two:
        for workers, address in zip(counts, (one, two), strict=True):
            judged(places[:8], model, folder / 'warm.parquet', address, folder / f'warm{workers}')
        # By turns, so that other work on the computer slows both alike.
        for first in range(0, len(places), TURN):
            for workers, address in zip(counts, (one, two), strict=True):
                part, cache = places[first : first + TURN], folder / f'cache_{workers}'
                taken = judged(part, model, folder / 'part.parquet', address, cache)
                times[workers].append(taken)
                given[workers] += computed(address)
    again = []
    for workers in counts:
        out, cache = folder / f'{workers}.parquet', folder / f'cache_{workers}'
        again.append(judged(places, model, out, cache=cache))
        print(f'  {workers} worker(s): {sum(times[workers]):.1f} s, again {again[-1]:.2f} s')
    alone = judged(places, model, folder / 'alone.parquet')
    print(f'  one process without Dask: {alone:.1f} s')
    ratios = sorted(two / one for one, two in zip(*times.values(), strict=True))
    gain = sum(times[2]) / sum(times[1])
    print(
        f'two workers : one      {gain:.2f} (at most {RATIO_MAX}), '
        f'by turns {ratios[0]:.2f} to {ratios[-1]:.2f}, median {ratios[len(ratios) // 2]:.2f}'
    )
    print(f'  work that shares nothing {given[2] / given[1]:.2f} on this computer')
    print(f'again : first          {again[1] / sum(times[2]):.4f} (below {CACHED_MAX})')
    files = [(folder / f'{name}.parquet').read_bytes() for name in ('1', '2', 'alone')]
    print(f'files are the same     {files[0] == files[1] == files[2]}')


def print_growth(sizes: list[int], places: list[Path], model: Path, folder: Path) -> None:
    """Print how time and memory of the driver grow with the number of bags."""
    print('   bags       s  ms a bag  again ms a bag  peak memory of the driver MiB')
    with scheduler(2) as address:
        for size in sorted(sizes):
            out = folder / f'size_{size}.parquet'
            first = judged(places[:size], model, out, address)
            again = judged(places[:size], model, out, address)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(
                f'{size:7d} {first:7.1f} {1e3 * first / size:9.1f} {1e3 * again / size:15.2f}'
                f' {peak:30.0f}'
            )


if __name__ == '__main__':
    main()
