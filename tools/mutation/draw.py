# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Mutants of the sources: a seeded draw of them, and how one gets into a tree and out again."""

import contextlib
import hashlib
from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from mutation.kinds import KINDS, changes

PACKAGE = 'fuzzycnc_ros'
GROUPS = ('core', 'runtime', 'components', 'ros', 'adapters', 'nodes', 'bags', 'cli')


@dataclass(frozen=True)
class Mutant:
    """A fault that can be put into the sources.

    Attributes
    ----------
    id : str
        Follows from the rest, but not from the line's number.
    group, file, kind : str
        Part of the package, path from the top of the tree, kind of fault.
    line : int
        Number of the line when it was drawn, from 1.
    before, after : str
        The line as it is, and with the fault.
    occurrence : int
        How many equal lines stand before it in the file.
    lines : (int, int)
        First and last line of what behaves differently, counted from the line itself.
    owner : str
        What changes on import; empty for code in a function.
    """

    id: str
    group: str
    file: str
    line: int
    kind: str
    before: str
    after: str
    occurrence: int
    lines: tuple[int, int]
    owner: str


def mutants_of(tree: Path, file: Path, group: str) -> Iterator[Mutant]:
    """Yield all mutants of a file."""
    name = file.relative_to(tree).as_posix()
    source = file.read_text(encoding='utf-8')
    rows = source.split('\n')
    for change in changes(source):
        line, start, end = change.span
        before = rows[line - 1]
        raw = before.encode()
        after = (raw[:start] + change.text.encode() + raw[end:]).decode()
        occurrence = rows[: line - 1].count(before)
        text = f'{name}\n{before}\n{occurrence}\n{after}'
        first, last = (number - line for number in change.place.lines)
        yield Mutant(
            id=hashlib.sha256(text.encode()).hexdigest()[:8],
            group=group,
            file=name,
            line=line,
            kind=change.kind,
            before=before,
            after=after,
            occurrence=occurrence,
            lines=(first, last),
            owner=change.place.owner,
        )


def shuffled(tree: Path, group: str, seed: int, without: Collection[str] = ()) -> Iterator[Mutant]:
    """Yield the mutants of a group but some ids, its folders and all kinds in turn.

    The order is that of hashes, so that a change of the sources changes little in it.
    """

    def chance(text: str) -> str:
        return hashlib.sha256(f'{seed} {group} {text}'.encode()).hexdigest()

    top = tree / PACKAGE / group
    by_place: dict[tuple[str, str], list[Mutant]] = defaultdict(list)
    for file in sorted(top.rglob('*.py')):
        folder = '/'.join(file.relative_to(top).parts[:-1][:1])
        for mutant in mutants_of(tree, file, group):
            if mutant.id not in without:
                by_place[folder, mutant.kind].append(mutant)
    for found in by_place.values():
        found.sort(key=lambda mutant: chance(mutant.id))
    folders = sorted({folder for folder, _ in by_place}, key=chance)
    kinds = sorted(KINDS, key=chance)
    turn = 0
    while any(by_place.values()):
        # Each folder in turn, each time with its next kind
        number = turn % len(folders)
        kind = kinds[(turn // len(folders) + number) % len(kinds)]
        if by_place[folders[number], kind]:
            yield by_place[folders[number], kind].pop()
        turn += 1


def draw(tree: Path, seed: int, count: int, without: Collection[str] = ()) -> list[Mutant]:
    """Return mutants, as many of each group as the count allows."""
    drawn: list[Mutant] = []
    for number, group in enumerate(GROUPS):
        share = count // len(GROUPS) + (number < count % len(GROUPS))
        drawn += islice(shuffled(tree, group, seed, without), share)
    return drawn


def find(tree: Path, mutant: Mutant) -> int:
    """Return the number of a mutant's line in a tree that may have changed, from 1.

    Raises
    ------
    LookupError
        If the line is gone.
    """
    file = tree / mutant.file
    rows = file.read_text(encoding='utf-8').split('\n') if file.is_file() else []
    found = [number for number, row in enumerate(rows, 1) if row == mutant.before]
    if len(found) <= mutant.occurrence:
        raise LookupError(
            f'mutant {mutant.id}: expected {mutant.before.strip()!r} in {mutant.file} but found '
            f'it {len(found)} times: draw mutants of the present sources'
        )
    return found[mutant.occurrence]


@contextlib.contextmanager
def applied(tree: Path, mutant: Mutant) -> Iterator[None]:
    """Put a mutant into a tree, and take it out again whatever happens."""
    file = tree / mutant.file
    number = find(tree, mutant)
    original = file.read_bytes()
    rows = original.decode().split('\n')
    rows[number - 1] = mutant.after
    try:
        file.write_bytes('\n'.join(rows).encode())
        yield
    finally:
        file.write_bytes(original)
