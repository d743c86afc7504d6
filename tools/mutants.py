# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Put small faults into the sources, one at a time, and see which the tests catch.

    python tools/mutants.py draw --seed 1 --count 60 > mutants.json
    python tools/mutants.py run mutants.json --suite 'fast=-m "not slow and not ros"'
    python tools/mutants.py show mutants.json

`draw` spreads them over the parts of the package and over the kinds of fault; ids of mutants that
no test could catch stand in `mutation/rejected.txt`, with the reason, and are left out.  `run`
works in copies of the tree: first it runs the suite once and notes which tests run which mutant's
line (`map` does only that), then on each mutant those tests, cheapest first, up to the first
failure.  A failure counts if it comes again on the mutant and does not come without it.  Results
are kept, so that a run can be broken off and continued, or another suite compared.
"""

import argparse
import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

TOOLS = Path(__file__).resolve().parent
sys.path.insert(0, str(TOOLS))

from mutation.draw import Mutant, draw, find  # noqa: E402
from mutation.reach import make_map  # noqa: E402
from mutation.trial import run  # noqa: E402

ROOT = TOOLS.parent
REJECTED = TOOLS / 'mutation' / 'rejected.txt'
RESULTS = ROOT / 'build' / 'mutants'


def describe(mutant: Mutant, results: Mapping[str, dict[str, Any]]) -> str:
    """Return lines on a mutant, what it changes and its result with each suite."""
    rows = [f'{mutant.id} {mutant.kind} {mutant.file}:{mutant.line}']
    rows += [f'- {mutant.before.strip()}', f'+ {mutant.after.strip()}']
    for suite, result in results.items():
        if result['caught']:
            text = f'caught by {result["by"]}' + (', which hung' if result['hung'] else '')
        else:
            text = f'SURVIVED {result["ran"]} tests'
            text += f', {result["left"]} more left out' if result['left'] else ''
            text += f', doubted: {", ".join(result["doubted"])}' if result['doubted'] else ''
        rows.append(f'{suite}: {text}')
    return '\n    '.join(rows)


def read_json(path: Path, default: Any = None) -> Any:
    """Return the content of a file, or a default where there is none."""
    return json.loads(path.read_text()) if path.is_file() else default


def write_json(path: Path, content: Any) -> None:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix('.part')
    part.write_text(json.dumps(content, indent=1) + '\n')
    part.replace(path)


def read_mutants(path: str) -> list[Mutant]:
    """Return drawn mutants."""
    rows = json.loads(sys.stdin.read() if path == '-' else Path(path).read_text())
    return [Mutant(**{**row, 'lines': tuple(row['lines'])}) for row in rows]


def rejected(path: Path) -> set[str]:
    """Return the ids that a file lists, each before its reason."""
    rows = path.read_text(encoding='utf-8').splitlines()
    return {row.split()[0] for row in rows if row.strip() and not row.startswith('#')}


def is_there(tree: Path, mutant: Mutant) -> bool:
    """Return whether a mutant's line is still in the tree; say so if not."""
    try:
        find(tree, mutant)
    except LookupError as error:
        print(f'left out: {error}', file=sys.stderr)
        return False
    return True


def mapped(given: argparse.Namespace, mutants: Sequence[Mutant]) -> tuple[str, dict[str, Any]]:
    """Return a suite's name and its map, which is made if it is missing or of other mutants."""
    name, has_arguments, text = given.suite.partition('=')
    path = given.results / f'map-{name}.json'
    suite = read_json(path)
    if not has_arguments and suite is None:
        raise SystemExit(
            f'mutants: expected what to run, as no map of {name} was found in {given.results}: '
            f"say --suite '{name}=ARGUMENTS OF PYTEST'"
        )
    arguments = shlex.split(text) if has_arguments else suite['arguments']
    known = suite is not None and suite['arguments'] == arguments
    if not known or not {m.id for m in mutants} <= set(suite['tests']):
        print(f'mutants: running {name} once to see which tests run which lines', file=sys.stderr)
        suite = make_map(given.tree, mutants, arguments)
        write_json(path, suite)
    return name, suite


def main(words: Sequence[str] | None = None) -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--tree', type=Path, default=ROOT, help='sources and tests, if not these')
    parser.add_argument('--results', type=Path, default=RESULTS, help='folder of maps and results')
    commands = parser.add_subparsers(dest='command', required=True)
    command = commands.add_parser('draw', help='draw mutants, as JSON on standard output')
    command.add_argument('--seed', type=int, default=1)
    command.add_argument('--count', type=int, default=60)
    command.add_argument('--without', type=Path, default=REJECTED, help='ids to leave out')
    for name, text in (
        ('show', 'show mutants and their results'),
        ('map', 'note which tests of a suite run which lines'),
        ('run', 'try the tests of a suite on each mutant'),
    ):
        command = commands.add_parser(name, help=text)
        command.add_argument('mutants', help='file that `draw` wrote, - for standard input')
        if name != 'show':
            command.add_argument('--suite', required=True, help="NAME='ARGUMENTS OF PYTEST'")
        if name == 'run':
            command.add_argument('-j', '--jobs', type=int, default=2)
            command.add_argument('--budget', type=float, default=900.0, help='s a mutant')
    given = parser.parse_args(words)
    given.tree = given.tree.resolve()
    if given.command == 'draw':
        drawn = draw(given.tree, given.seed, given.count, rejected(given.without))
        print(json.dumps([asdict(mutant) for mutant in drawn], indent=1))
        return
    mutants = read_mutants(given.mutants)
    kept = given.results / 'results.json'
    results = read_json(kept, {})
    if given.command == 'show':
        for mutant in mutants:
            found = {name: done[mutant.id] for name, done in results.items() if mutant.id in done}
            print(describe(mutant, found))
        return
    mutants = [mutant for mutant in mutants if is_there(given.tree, mutant)]
    name, suite = mapped(given, mutants)
    if given.command == 'map':
        return
    of_suite = results.setdefault(name, {})
    for mutant in run(given.tree, mutants, suite, of_suite, given.jobs, given.budget):
        write_json(kept, results)
        print(describe(mutant, {name: of_suite[mutant.id]}), flush=True)
    caught = sum(of_suite[mutant.id]['caught'] for mutant in mutants)
    print(f'{name}: {caught} of {len(mutants)} caught')


if __name__ == '__main__':
    main()
