# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Random short part programs on a real LinuxCNC and on its model: times and contour errors.

Run with `python benchmarks/linuxcnc_short_programs.py --json FILE`, as a user who may start
LinuxCNC; 500 programs take 20 minutes, and those whose figures do not agree run once more, since a
queue may run short on a busy computer.  Programs that FILE has are not driven again, so that the
table of the model as it is now can be had without LinuxCNC.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / 'test' / 'support'))

from equipment.linuxcnc_short import agreement_table, compared, drive, driven, figures
from programs.short_programs import KINDS, PLUNGES, short_program

from fuzzycnc_ros.adapters.linuxcnc.recorder import recording


def main() -> int:
    """Drive what is not known yet and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--json', type=Path, required=True, help='what was driven')
    parser.add_argument('--seed', type=int, default=2, help='of the programs')
    parser.add_argument('--count', type=int, default=500, help='programs')
    parser.add_argument('--plunges', action='store_true', help='plunges after rapids alone')
    arguments = parser.parse_args()
    file, seed = arguments.json, arguments.seed
    kinds = PLUNGES if arguments.plunges else KINDS
    known = {'seed': seed, 'driven': {}, 'again': {}}
    if file.exists():
        known = json.loads(file.read_text())
    if known['seed'] != seed:
        raise SystemExit(f'{file}: expected seed {seed}, it has {known["seed"]}')
    numbers = range(arguments.count)
    missing = [one for one in numbers if str(one) not in known['driven']]
    _drive(known, 'driven', missing, file, kinds)
    rows = compared(seed, figures(known['driven']), kinds)
    apart = [row for row in rows if not row.agrees]
    missing = [row.number for row in apart if str(row.number) not in known['again']]
    _drive(known, 'again', missing, file, kinds)
    print(agreement_table(rows).to_text())
    for row, again in zip(apart, compared(seed, figures(known['again']), kinds), strict=True):
        print(
            f'{row.number}, {row.kind}: {row.time[0]:.3f} s and {1e6 * row.error[0]:.1f} um, '
            f'again {again.time[0]:.3f} s and {1e6 * again.error[0]:.1f} um, '
            f'simulated {row.time[1]:.3f} s and {1e6 * row.error[1]:.1f} um'
        )
    return 0


def _drive(
    known: dict[str, Any], run: str, numbers: list[int], file: Path, kinds: Sequence[str]
) -> None:
    """Run programs on LinuxCNC and write what came of it."""
    if not numbers:
        return
    with recording() as recorder:
        for number, cut in drive(recorder, known['seed'], numbers, kinds):
            time, error = driven(short_program(known['seed'], number, kinds), cut)
            known[run][str(number)] = [round(time, 4), round(error, 9)]
            file.write_text(json.dumps(known))


if __name__ == '__main__':
    raise SystemExit(main())
