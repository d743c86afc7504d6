# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What fuzzy is worth: each system with its rules, with a plain law in their place, without.

Feedrate, servo and soft material, each held out: on paths, moves and sheets that nothing was
tuned on.  Figures are least, median and largest over the cases; the last column counts in how
many of them the first figure is better than, equal to within 1 % and worse than with the plain
law.  Part programs and the EMPS recording are looked for in the folder that `FUZZYCNC_DATA` names,
and left out where they are not.  It takes some minutes of one core, with `--quick` half a minute.
Run with `python benchmarks/fuzzy_worth.py [--markdown FILE] [--json FILE] [--quick]`.
"""

import os

# One thread each, set before numpy starts its pool.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import fuzzy_worth_feedrate as feedrate
import fuzzy_worth_foam as foam
import fuzzy_worth_servo as servo
from fuzzy_worth_rows import Part

DATA = Path(os.environ.get('FUZZYCNC_DATA') or Path(__file__).parents[2] / 'shared' / 'data')
"""Where part programs and recordings are."""


def parts(data: Path, quick: bool) -> Iterator[Part]:
    """Yield what each system is worth, one part after the other.

    Parameters
    ----------
    data : Path
        Folder with `gcode` and `emps-ballscrew`.
    quick : bool
        Whether a few cases do.
    """
    yield feedrate.curves(quick)
    if (data / 'gcode').is_dir():
        yield feedrate.programs(data / 'gcode', quick)
    else:
        print(f'left out: no part programs in {data / "gcode"}', file=sys.stderr)
    yield servo.lathe_moves(quick)
    yield servo.lathe_courses(quick)
    recording = data / 'emps-ballscrew' / 'DATA_EMPS.mat'
    if not recording.is_file():
        print(f'left out: no recording {recording}', file=sys.stderr)
    yield servo.ballscrew_courses(recording if recording.is_file() else None, quick)
    yield foam.prediction(quick)
    yield foam.tracks(quick)


def main() -> int:
    """Print the table and write it where asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--markdown', type=Path, metavar='FILE')
    parser.add_argument('--json', type=Path, metavar='FILE')
    parser.add_argument('--quick', action='store_true', help='a few cases, to see that it runs')
    asked = parser.parse_args()
    found = []
    for part in parts(DATA, asked.quick):
        found.append(part)
        print(part.table().to_text(), *part.notes, '', sep='\n', flush=True)
    if asked.markdown:
        texts = [
            '\n\n'.join([part.table().to_markdown(), *filter(None, ['; '.join(part.notes)])])
            for part in found
        ]
        asked.markdown.write_text('\n\n'.join(texts) + '\n')
    if asked.json:
        asked.json.write_text(json.dumps([part.document() for part in found], indent=1) + '\n')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
