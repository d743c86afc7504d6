# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Decoding the messages of one bag with the definitions that it embeds.

Flat messages with arrays of names are decoded here, faster than rosbags does: a stream repeats
its names in every message, and decoding them is most of the work.  The bytes of an array of
strings state its own end and, starting at a multiple of four, do not depend on where they stand:
bytes that begin as those of the message before give the same names.  Whatever is unusual about a
message is left to rosbags, whose checks and errors then apply.
"""

import struct
from collections.abc import Callable, Iterable, Mapping
from functools import partial, reduce
from types import SimpleNamespace
from typing import Any

import numpy as np

from fuzzycnc_ros.bags import definitions
from fuzzycnc_ros.bags.definitions import BASE, NAME, SEQUENCE
from fuzzycnc_ros.bags.errors import BagTypeError, BagVersionError
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.bags.storage import Channel
from fuzzycnc_ros.bags.typestore import (
    PACKAGE,
    deserialize,
    ensure_type,
    message_definition,
    message_type,
    serialize,
    type_hash,
    typestore,
)
from fuzzycnc_ros.runtime.provenance import MESSAGE_SET

Decode = Callable[[bytes], Any]
Step = Callable[[bytes, int], tuple[Any, int]]
"""Takes the message without its head and a position; returns a value and where it ends."""

_HEAD = b'\x00\x01'  # CDR, little endian
_LENGTH = struct.Struct('<I')
_STAMP = struct.Struct('<iI')
_APPLIED = 'fuzzycnc_msgs/msg/CompensationApplied'
_DISPLACEMENT = 'fuzzycnc_msgs/msg/Displacement'
_MACHINE_STATE = 'fuzzycnc_msgs/msg/MachineState'
_THERMAL_ERROR = 'fuzzycnc_msgs/msg/ThermalError'
_TIME, _HEADER = 'builtin_interfaces/msg/Time', 'std_msgs/msg/Header'
_TIME_FIELDS = [('sec', (BASE, ('int32', 0))), ('nanosec', (BASE, ('uint32', 0)))]
_HEADER_FIELDS = [('stamp', (NAME, _TIME)), ('frame_id', (BASE, ('string', 0)))]
_NUMBERS = {
    'bool': '?', 'int8': 'b', 'uint8': 'B', 'int16': 'h', 'uint16': 'H', 'int32': 'i',
    'uint32': 'I', 'int64': 'q', 'uint64': 'Q', 'float32': 'f', 'float64': 'd',
}  # fmt: skip

Upgraders = Mapping[tuple[str, int], Callable[[Any], Any]]
"""By type and the version that they start from: functions that take a message of that version and
return what the next version has in its place.

The argument has the old definition's attributes; so has the result the new one's.
"""


def _with_position(old: Any) -> Any:
    """Return a displacement of message set 1, measured at the reference position."""
    return message_type(_DISPLACEMENT)(**vars(old), position=np.full(len(old.axis), np.nan))


def _with_motion(old: Any) -> Any:
    """Return a machine state of message set 1, which knew no motion of axes and no coolant."""
    unknown = np.full(len(old.axis), np.nan)
    added = {'coolant': 0, 'spindle_load': np.nan, 'travel': unknown, 'square_speed': unknown}
    return SimpleNamespace(**vars(old), **added)


def _without_moments(old: Any) -> Any:
    """Return a machine state of message set 3, which did not tell where an axis had moved."""
    unknown = np.full(len(old.axis), np.nan)
    added = {'travel_moment': unknown, 'travel_second_moment': unknown}
    return message_type(_MACHINE_STATE)(**vars(old), **added)


def _without_slope(old: Any) -> Any:
    """Return a thermal error of message set 2, the same at all positions of an axis."""
    names = ('slope', 'slope_deviation', 'reference_position', 'line_deviation')
    unknown = np.full(len(old.axis), np.nan)
    return message_type(_THERMAL_ERROR)(**vars(old), **dict.fromkeys(names, unknown))


def _applied_everywhere(old: Any) -> Any:
    """Return a read-back of message set 2, whose offset is in force wherever the axis is."""
    count = len(old.axis)
    added = {'slope': np.zeros(count), 'position': np.full(count, np.nan)}
    return message_type(_APPLIED)(**vars(old), **added)


UPGRADERS: Upgraders = {
    (_DISPLACEMENT, 1): _with_position,
    (_MACHINE_STATE, 1): _with_motion,
    (_THERMAL_ERROR, 2): _without_slope,
    (_APPLIED, 2): _applied_everywhere,
    (_MACHINE_STATE, 3): _without_moments,
}
"""The upgraders of this version."""


class Decoder:
    """Decodes messages of a bag.

    A type is decoded with the definition that the bag embeds; where the bag has none, or the
    same one as this machine, with this machine's own.

    Parameters
    ----------
    channels : iterable of Channel
        The bag's channels.
    version : int, optional
        Message-set version that the bag states.  Without one, its types are taken to be of the
        first version.
    upgraders : Upgraders
        Bring messages of older versions of `fuzzycnc_msgs` to the current one.
    """

    def __init__(
        self, channels: Iterable[Channel], version: int | None, upgraders: Upgraders
    ) -> None:
        self._channels = {channel.type: channel for channel in channels}
        self._version = version
        self._upgraders = upgraders
        self._stores: dict[str, Any] = {}
        self._decodes: dict[str, Decode] = {}

    def store(self, type_name: str) -> Any:
        """Return the rosbags store in which a type is defined as in the bag.

        Raises
        ------
        BagTypeError
            If there is no definition of the type, or it cannot be used.
        """
        if type_name not in self._stores:
            self._stores[type_name] = self._find_store(type_name)
        return self._stores[type_name]

    def decode(self, type_name: str) -> Decode:
        """Return the function that decodes messages of a type.

        Raises
        ------
        BagTypeError
            If there is no usable definition of the type.
        BagVersionError
            If the bag's definition differs from the current one and no upgrader is known.
        """
        if type_name not in self._decodes:
            self._decodes[type_name] = self._make(type_name)
        return self._decodes[type_name]

    def _make(self, type_name: str) -> Decode:
        store = self.store(type_name)
        as_recorded = fast_decoder(store, type_name) or partial(
            deserialize, type_name=type_name, store=store
        )
        steps = self._steps(type_name)
        if not type_name.startswith(f'{PACKAGE}/') or store is typestore():
            return as_recorded
        stated = 'unknown' if self._version is None else self._version
        refusal = (
            f'expected {type_name} as in message set {MESSAGE_SET} but the bag (message set '
            f'{stated}) defines it otherwise and no upgrader is known; install the fuzzycnc that '
            'recorded it'
        )
        if not steps:
            raise BagVersionError(refusal)

        def upgraded(raw: bytes) -> Any:
            message = as_recorded(raw)
            try:
                return reduce(lambda found, step: step(found), steps, message)
            except (AttributeError, TypeError) as error:  # not what that version defined
                raise BagVersionError(refusal) from error

        return upgraded

    def _steps(self, type_name: str) -> list[Callable[[Any], Any]]:
        """Return the upgraders that a type of the bag goes through, in order."""
        if self.store(type_name) is typestore():
            return []
        return [
            self._upgraders[name, version]
            for name, version in sorted(self._upgraders)
            if name == type_name and (self._version is None or version >= self._version)
        ]

    def current(self, type_name: str) -> Callable[[bytes], bytes] | None:
        """Return the function that upgrades undecoded messages; None if they are current."""
        if not self._steps(type_name):
            return None
        decode = self.decode(type_name)
        return lambda raw: serialize(decode(raw), type_name)

    def _find_store(self, type_name: str) -> Any:
        channel = self._channels[type_name]
        if channel.message_encoding != 'cdr':
            raise BagTypeError(
                f'{channel.topic}: expected messages in cdr but found {channel.message_encoding}'
            )
        if not channel.definition.strip():
            ensure_type(type_name)
            return typestore()
        try:
            if channel.definition.strip() == message_definition(type_name).strip():
                return typestore()
        except BagTypeError:  # unknown on this machine: the bag's own definition is all there is
            return self._embedded(channel)
        store = self._embedded(channel)
        return typestore() if store.hash_rihs01(type_name) == type_hash(type_name) else store

    def _embedded(self, channel: Channel) -> Any:
        """Return a store with the types of one definition, completed from this machine's."""
        typesys = load('rosbags.typesys')
        types = definitions.parse(channel.definition, channel.type, channel.encoding)
        names = list(types)
        for name in names:  # grows while it is walked
            for reference in definitions.references(types, name):
                if reference not in types:
                    ensure_type(reference)
                    types[reference] = typestore().fielddefs[reference]
                    names.append(reference)
        store = typesys.get_typestore(typesys.Stores.EMPTY)
        try:
            store.register(types)
            store.get_msgdef(channel.type)  # makes its code now, so that errors appear here
        except (typesys.TypesysError, SyntaxError, RecursionError, KeyError) as error:
            raise BagTypeError(
                f'{channel.type}: the definition in the bag cannot be used: {error}'
            ) from error
        return store


def fast_decoder(store: Any, type_name: str) -> Decode | None:
    """Return a faster decoder of a type, or None where rosbags' own is as good.

    Parameters
    ----------
    store : rosbags Typestore
        Store that defines the type.
    type_name : str
        The type; worth it are flat ones with an array of strings.
    """
    fields = [desc for _, desc in store.fielddefs[type_name][1]]
    if not any(_is_names(desc) for desc in fields):
        return None
    steps = [_step(store, desc) for desc in fields]
    plan = [step for step in steps if step is not None]
    if len(plan) < len(steps):
        return None
    make = store.types[type_name]

    def decode(raw: bytes) -> Any:
        if raw[:2] == _HEAD:
            body = raw[4:]
            position = 0
            values = []
            try:
                for step in plan:
                    value, position = step(body, position)
                    values.append(value)
            except (ValueError, struct.error):
                return deserialize(raw, type_name, store)
            if position <= len(body) <= position + 3:
                return make(*values)
        return deserialize(raw, type_name, store)

    return decode


def _is_names(desc: Any) -> bool:
    return bool(desc[0] == SEQUENCE and desc[1][0][0] == BASE and desc[1][0][1][0] == 'string')


def _step(store: Any, desc: Any) -> Step | None:
    kind, detail = desc
    if _is_names(desc):
        return _names()
    if kind == SEQUENCE and detail[0][0] == BASE and detail[0][1][0] in _NUMBERS:
        return _numbers(detail[0][1][0])
    if kind == BASE and detail[0] == 'string':
        return _string
    if kind == BASE and detail[0] in _NUMBERS:
        return _number(detail[0])
    # A bag may bring a type of the same name with other fields: ROS 1 had another header.
    if kind != NAME or store.fielddefs.get(_TIME, ((), ()))[1] != _TIME_FIELDS:
        return None
    if detail == _TIME:
        return _time(store.types[_TIME])
    if detail == _HEADER and store.fielddefs[_HEADER][1] == _HEADER_FIELDS:
        return _header(store.types[_HEADER], store.types[_TIME])
    return None


def _string(body: bytes, position: int) -> tuple[str, int]:
    begin = (position + 3 & -4) + 4
    end = begin + _LENGTH.unpack_from(body, begin - 4)[0]
    if not begin < end <= len(body) or body[end - 1]:
        raise ValueError('a string has a wrong length')
    return body[begin : end - 1].decode(), end


def _names() -> Step:
    block = b''
    names: list[str] = []

    def step(body: bytes, position: int) -> tuple[list[str], int]:
        nonlocal block, names
        begin = position + 3 & -4
        if block and body.startswith(block, begin):
            return names.copy(), begin + len(block)
        count = _LENGTH.unpack_from(body, begin)[0]
        if count * 5 > len(body):
            raise ValueError('more strings than bytes')
        found = []
        end = begin + 4
        for _ in range(count):
            name, end = _string(body, end)
            found.append(name)
        block, names = body[begin:end], found
        return found.copy(), end

    return step


def _numbers(name: str) -> Step:
    dtype = np.dtype('<' + _NUMBERS[name])
    size = dtype.itemsize

    def step(body: bytes, position: int) -> tuple[Any, int]:
        begin = position + 3 & -4
        count = _LENGTH.unpack_from(body, begin)[0]
        begin += 4
        if count:  # nothing aligns an empty array
            begin = begin + size - 1 & -size
        return np.frombuffer(body, dtype, count, begin), begin + count * size

    return step


def _number(name: str) -> Step:
    form = struct.Struct('<' + _NUMBERS[name])
    size = form.size

    def step(body: bytes, position: int) -> tuple[Any, int]:
        begin = position + size - 1 & -size
        return form.unpack_from(body, begin)[0], begin + size

    return step


def _time(make: Any) -> Step:
    def step(body: bytes, position: int) -> tuple[Any, int]:
        begin = position + 3 & -4
        return make(*_STAMP.unpack_from(body, begin)), begin + 8

    return step


def _header(make: Any, make_time: Any) -> Step:
    time = _time(make_time)

    def step(body: bytes, position: int) -> tuple[Any, int]:
        stamp, position = time(body, position)
        frame_id, position = _string(body, position)
        return make(stamp, frame_id), position

    return step
