# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files with wrong content: damaged bytes, and documents whose parts mean something else."""

import json
import random
import re
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

SIZES = (0, 1, 7, 255, 2**16, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1)
NUMBERS = (
    '0', '-0', '1', '-1', '1e308', '-1e308', '1e999', 'nan', 'inf', '-inf', 'NaN', '.', '1e-320',
    '9' * 400, '9' * 5000, '0x1f', '1_000', '1,5', '1.7976931348623157e308', '4294967296', '-7',
    '1e9', '1e18', '', ' ', 'true', 'null', '""', '\u0663', '\u221e', '٣', '2**9', '#', '~',
)  # fmt: skip
FRAGMENTS = (
    '\x00', '\ufeff', '\r', '\n', '\r\n', '\t', '"', "'", '{', '}', '[', ']', '(', ')', ';', ',',
    ':', '%', '../../../etc/passwd', '&a [*a, *a]', '*b', '<<', '!!python/object/apply:os.system',
    '!!int ""', '!!float x', '!!bool x', '!!timestamp x', '!!python/name:os.system ""', '.inf',
    '[' * 3000, '{"a":' * 3000, '(' * 3000, 'A' * 70_000, '- ' * 3000, '\ud7ff', '\u202e', '#!',
)  # fmt: skip
VALUES = (
    None, True, False, 0, -1, 1.5, 1e308, float('nan'), float('inf'), 10**30, '', 'x', [], {},
    [None], [[]], [1, 'a'], {'a': 1}, 'A' * 50_000, '<deep>', '../x', [0.0] * 5000,
)  # fmt: skip
_NUMBER = re.compile(r'[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?')


def mutated_bytes(data: bytes, rng: random.Random, edits: int = 3) -> bytes:
    """Return bytes with some flipped, overwritten, left out, moved or said twice."""
    found = bytearray(data)
    for _ in range(rng.randint(1, edits)):
        place = rng.randrange(len(found) + 1)
        length = rng.choice((1, 2, 4, 8, 16, 64, 1000, len(found) // 3))
        choice = rng.randrange(9)
        if choice <= 1 and place < len(found):
            found[place] ^= 1 << rng.randrange(8)
        elif choice == 2:
            size = rng.choice((1, 2, 4, 8))
            value = rng.choice(SIZES) & (2 ** (8 * size) - 1)
            found[place : place + size] = value.to_bytes(size, 'little')
        elif choice == 3:
            found[place : place + length] = rng.randbytes(min(length, len(found)))
        elif choice == 4:
            del found[place:]
        elif choice == 5:
            del found[place : place + length]
        elif choice == 6:
            found[place:place] = found[place : place + length] * rng.choice((1, 1, 2, 50))
        elif choice == 7:
            other = rng.randrange(len(found) + 1)
            found[other : other + length] = found[place : place + length]
        else:
            found[place : place + length] = bytes([rng.choice((0, 255, 10, 34))]) * length
        if len(found) > 4_000_000:
            del found[4_000_000:]
    return bytes(found)


def mutated_text(text: str, rng: random.Random, edits: int = 4) -> str:
    """Return a text with other numbers, and lines or parts of them where they do not belong."""
    for _ in range(rng.randint(1, edits)):
        lines = text.split('\n')
        row = rng.randrange(len(lines))
        choice = rng.randrange(8)
        if choice <= 2:
            numbers = list(_NUMBER.finditer(text))
            if not numbers:
                continue
            match = rng.choice(numbers)
            text = text[: match.start()] + rng.choice(NUMBERS) + text[match.end() :]
            continue
        if choice == 3:
            place = rng.randrange(len(text) + 1)
            text = text[:place] + rng.choice(FRAGMENTS) + text[place:]
            continue
        if choice == 4:
            lines[row : row + 1] = [lines[row]] * rng.choice((0, 2, 500))
        elif choice == 5:
            lines[row] = lines[row][: rng.randrange(len(lines[row]) + 1)]
        elif choice == 6:
            lines.insert(row, rng.choice(lines))
        else:
            other = rng.choice(lines)
            lines[row] += other[rng.randrange(len(other) + 1) :]
        text = '\n'.join(lines)
        if len(text) > 2_000_000:
            text = text[:2_000_000]
    return text


def damaged(text: str, rng: random.Random) -> bytes:
    """Return a damaged text file."""
    if rng.random() < 0.3:
        return mutated_bytes(text.encode(), rng)
    return mutated_text(text, rng).encode('utf-8', 'surrogatepass')


def mutated_json(text: str, rng: random.Random, edits: int = 2) -> str:
    """Return a JSON document in which some values are others, or missing."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        return text  # it is damaged already
    for _ in range(rng.randint(1, edits)):
        place = _place(document, rng)
        if place is None:
            break
        parent, key = place
        if rng.random() < 0.15:
            del parent[key]
        else:
            parent[key] = _other(parent[key], rng)
    found = json.dumps(document)
    return found.replace('"<deep>"', '[' * 100_000 + ']' * 100_000)


def _place(document: Any, rng: random.Random) -> tuple[Any, Any] | None:
    """Return where a value of the document stands, deep ones as likely as shallow ones."""
    parent, key = None, None
    value = document
    depth = rng.randint(1, 9)
    while isinstance(value, (dict, list)) and value and depth:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        parent, key = value, rng.choice(keys)
        value = parent[key]
        depth -= 1
    return None if parent is None else (parent, key)


def _other(value: Any, rng: random.Random) -> Any:
    choice = rng.randrange(7)
    if isinstance(value, list) and value and choice < 4:
        if choice == 0:
            return value[: rng.randrange(len(value))]
        if choice == 1:
            return [*value, rng.choice(value)]
        if choice == 2:
            return (value * 2000)[:20_000]
        return rng.sample(value, len(value))
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if number and abs(value) < 1e300 and choice < 5:
        scale = rng.choice((-1, 0, 2, 0.5, 1e6, 1e-6, 1e150, 1e300, 1 + 1e-9))
        return rng.choice((value * scale, value + 1, -1, 0, 2, 10**6, 10**400, 1e308, 5e-324))
    return deepcopy(rng.choice(VALUES))  # the next mutation may put it into itself


def places_of_numbers(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Return where each number of a document stands."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from places_of_numbers(item, (*path, key))
    elif isinstance(value, list):
        for at, item in enumerate(value):
            yield from places_of_numbers(item, (*path, at))
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield path


def one_of_each(paths: Iterator[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """Return one place of each field."""
    fields = {tuple(key for key in path if isinstance(key, str)): path for path in paths}
    return list(fields.values())
