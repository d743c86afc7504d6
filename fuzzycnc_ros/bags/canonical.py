# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The canonical form of a recording, and its hash: what two equal runs have in common.

A run in one process, the same run over DDS, and its replay give equal hashes.  Of each topic,
the messages count in the order of their header stamp (log time where a type has no header),
serialised anew so that padding is zero, and with fields tagged `[wall]` in their definition set
to zero.  Messages of a topic with equal stamps are put in the order of their bytes: several
nodes may publish on one topic, and who came first is chance.  Log times themselves do not count.
"""

import hashlib
import os
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from typing import Any

import numpy as np

from fuzzycnc_ros.bags.definitions import SEPARATOR
from fuzzycnc_ros.bags.reader import BagMessage, BagReader
from fuzzycnc_ros.bags.typestore import PACKAGE, deserialize, message_definition, serialize
from fuzzycnc_ros.runtime.convert import stamp_of

EXCLUDED = (
    'diagnostics',
    'rosout',
    'parameter_events',
    'clock',
    'machine_tick',
    'tick_answer',
    'node_configuration',
    'node_event',
    'recorder/progress',
    'deadline_fired',
    'transition_event',
)
"""Topics, in whatever namespace and with all below them, that say how a run was carried out, not
what came of it."""

_WALL = re.compile(r'^\s*(\S+)\s+([A-Za-z]\w*)[^#\n]*#.*\[wall\]')


def topic_hashes(
    source: str | os.PathLike[str] | Iterable[BagMessage | tuple[str, str, int, Any]],
    exclude: Collection[str] = EXCLUDED,
) -> dict[str, str]:
    """Return the SHA-256 of the canonical form of each topic.

    Parameters
    ----------
    source : path or iterable of BagMessage
        A bag, or messages as (topic, type, log time [ns], message), the message decoded by
        rosbags or as undecoded bytes.
    exclude : collection of str
        Topics to leave out, in any namespace.

    Returns
    -------
    dict of str to str
        Topic to 64 hexadecimal digits, sorted by topic; topics without messages are absent.

    Raises
    ------
    BagError
        If the bag cannot be read, or a message does not fit its type.
    """
    if isinstance(source, (str, os.PathLike)):
        with BagReader(source) as reader:
            topics = [topic for topic in reader.connections if not excluded(topic, exclude)]
            return _hashes(reader.messages(topics), reader)
    return _hashes((item for item in source if not excluded(item[0], exclude)), None)


def combined_hash(hashes: Mapping[str, str]) -> str:
    """Return one SHA-256 for all topics.

    Examples
    --------
    >>> combined_hash({'/b': '01', '/a': '02'}) == combined_hash({'/a': '02', '/b': '01'})
    True
    """
    lines = ''.join(f'{topic} {digest}\n' for topic, digest in sorted(hashes.items()))
    return hashlib.sha256(lines.encode()).hexdigest()


def excluded(topic: str, exclude: Collection[str] = EXCLUDED) -> bool:
    """Return whether a topic is left out, in whatever namespace it is.

    Examples
    --------
    >>> excluded('/mill/machine_tick/compensator'), excluded('/mill/compensation')
    (True, False)
    """
    return any(f'/{name.strip("/")}/' in f'/{topic}/' for name in exclude)


def canonical_message(message: Any, type_name: str) -> bytes:
    """Return the canonical bytes of a decoded message or of undecoded bytes.

    Parameters
    ----------
    message : object or bytes
        The message.
    type_name : str
        Its type, which must be known on this machine.

    Raises
    ------
    BagDataError
        If the message does not fit its type.
    """
    return _canonical(_decoded(message, type_name), type_name, None, wall_fields(type_name))


def _canonical(
    message: Any, type_name: str, store: Any, wall: tuple[tuple[str, ...], ...]
) -> bytes:
    for path in wall:
        message = _without(message, path)
    return serialize(message, type_name, store)


def _decoded(message: Any, type_name: str) -> Any:
    if isinstance(message, (bytes, bytearray, memoryview)):
        return deserialize(bytes(message), type_name)
    return message


def _hashes(
    messages: Iterable[BagMessage | tuple[str, str, int, Any]], reader: BagReader | None
) -> dict[str, str]:
    found: dict[str, list[tuple[int, bytes]]] = defaultdict(list)
    types: dict[str, tuple[str, Any, tuple[tuple[str, ...], ...]]] = {}
    for topic, type_name, log_time, message in messages:
        if topic not in types:
            types[topic] = (type_name, *_definition(topic, type_name, reader))
        decoded = _decoded(message, type_name)
        found[topic].append((_stamp(decoded, log_time), _canonical(decoded, *types[topic])))
    result = {}
    for topic in sorted(found):
        digest = hashlib.sha256(f'{types[topic][0]}\n'.encode())
        for _, payload in sorted(found[topic]):
            digest.update(len(payload).to_bytes(8, 'little'))
            digest.update(payload)
        result[topic] = digest.hexdigest()
    return result


def _definition(
    topic: str, type_name: str, reader: BagReader | None
) -> tuple[Any, tuple[tuple[str, ...], ...]]:
    """Return the store of a type and its fields tagged `[wall]`."""
    # Messages of our own package are always of the current set, whatever the bag's was.
    if reader is None or type_name.startswith(f'{PACKAGE}/'):
        return None, wall_fields(type_name)
    text = reader.connections[topic].definition or message_definition(type_name)
    return reader.decoder.store(type_name), tagged_fields(text, type_name)


def _stamp(message: Any, log_time: int) -> int:
    header = getattr(message, 'header', None)
    return log_time if header is None else stamp_of(header.stamp)


@cache
def wall_fields(type_name: str) -> tuple[tuple[str, ...], ...]:
    """Return the paths of the fields that are tagged `[wall]`, also inside of nested messages.

    Such fields hold wall-clock times and the like, which differ from run to run.
    """
    return tagged_fields(message_definition(type_name), type_name)


def tagged_fields(definition: str, type_name: str) -> tuple[tuple[str, ...], ...]:
    """Return the paths of the fields tagged `[wall]` in a definition text.

    Examples
    --------
    >>> text = 'float64 load   # [-] Load' + chr(10) + 'float64 took  # [wall] [s] Time it took'
    >>> tagged_fields(text, 'shop_msgs/msg/Load')
    (('took',),)
    """
    texts: dict[str, str] = {}
    name = type_name
    for part in definition.split(SEPARATOR + '\n'):
        if part.startswith('MSG: '):
            head, _, part = part.partition('\n')
            name = head[len('MSG: ') :].strip()
            name = name if '/msg/' in name else name.replace('/', '/msg/')
        texts[name] = part
    return tuple(_tagged(texts, type_name, ()))


def _tagged(
    texts: Mapping[str, str], type_name: str, parents: tuple[str, ...]
) -> Iterable[tuple[str, ...]]:
    package = type_name.split('/')[0]
    for line in texts.get(type_name, '').splitlines():
        code = line.split('#')[0].split()
        if len(code) < 2 or '=' in line.split('#')[0]:
            continue
        kind, field = code[0].split('[')[0].split('<=')[0], code[1]
        if _WALL.match(line):
            yield (*parents, field)
            continue
        nested = kind if '/' in kind else f'{package}/{kind}'
        nested = nested if '/msg/' in nested else nested.replace('/', '/msg/')
        if nested in texts:
            yield from _tagged(texts, nested, (*parents, field))


def _without(value: Any, path: tuple[str, ...]) -> Any:
    """Return a message, or each of a list of messages, with one field set to zero."""
    if not path:
        return _zero(value)
    if isinstance(value, list):
        return [_without(item, path) for item in value]
    fields = dict(vars(value))
    fields[path[0]] = _without(fields[path[0]], path[1:])
    return type(value)(**fields)


def _zero(value: Any) -> Any:
    """Return zero, empty or false in the form of a value."""
    if isinstance(value, np.ndarray):
        return np.zeros_like(value)
    if isinstance(value, list):
        return [_zero(item) for item in value]
    if isinstance(value, (bool, int, float, str)):
        return type(value)()
    return type(value)(**{name: _zero(item) for name, item in vars(value).items()})
