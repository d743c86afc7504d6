# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Types of messages without ROS: rosbags' types of Jazzy and the messages of fuzzycnc.

Definitions are read from the `.msg` files themselves, of a source checkout or of the installed
package, so that there is no second copy that could differ.
"""

import struct
from functools import cache
from threading import RLock
from typing import Any

from fuzzycnc_ros.bags import definitions
from fuzzycnc_ros.bags.errors import BagDataError, BagTypeError
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.runtime.convert import Target

PACKAGE = 'fuzzycnc_msgs'
"""The package of the messages of fuzzycnc."""

COMPRESSED = 'compressed by rosbag2 one by one; convert the bag with `ros2 bag convert` first'

_lock = RLock()  # the recorder adds topics while its thread writes


@cache
def typestore() -> Any:
    """Return the store of all known types: those of ROS 2 Jazzy and of `fuzzycnc_msgs`.

    Raises
    ------
    MissingLibraryError
        If rosbags is not installed.
    BagTypeError
        If the definitions of `fuzzycnc_msgs` cannot be found.
    """
    typesys = load('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    folder = definitions.find_folder(PACKAGE)
    if folder is None:
        raise BagTypeError(
            f'expected the .msg files of {PACKAGE} in one of '
            f'{", ".join(str(f) for f in definitions.folders(PACKAGE))} but found none; source '
            'the workspace (. install/setup.bash) or install the package (pip install ./msg_defs)'
        )
    types: definitions.Types = {}
    for path in sorted(folder.glob('*.msg')):
        text = path.read_text(encoding='utf-8')
        types.update(definitions.parse(text, f'{PACKAGE}/msg/{path.stem}'))
    store.register(types)
    return store


def ensure_type(type_name: str) -> None:
    """Make a type known, from the `.msg` files of a sourced ROS workspace where necessary.

    Raises
    ------
    BagTypeError
        If no definition is found, or not of every type that it contains.
    """
    with _lock:
        store = typestore()
        if type_name in store.fielddefs:
            return
        text = definitions.find_text(type_name)
        if text is None:
            raise BagTypeError(
                f'expected a message definition of {type_name} but found none on this machine; '
                'source the workspace that contains its package'
            )
        types = definitions.parse(text, type_name)
        for reference in definitions.references(types, type_name):
            ensure_type(reference)
        store.register(types)


def message_type(type_name: str) -> Any:
    """Return the class of a message type; its constructor takes all fields by name.

    Examples
    --------
    >>> Time = message_type('builtin_interfaces/msg/Time')
    >>> Time(sec=1, nanosec=500).nanosec
    500
    """
    ensure_type(type_name)
    return typestore().types[type_name]


ROSBAGS = Target(message_type, numpy_arrays=True)
"""Makes rosbags' messages of records."""


@cache
def message_definition(type_name: str) -> str:
    """Return the text of a type's definition followed by those of all types it contains.

    This is the content of an MCAP schema with the encoding `ros2msg`.

    Raises
    ------
    BagTypeError
        If the type is unknown.
    """
    ensure_type(type_name)
    names = [type_name]
    for name in names:  # grows while it is walked: breadth first, each type once
        names.extend(
            n for n in definitions.references(typestore().fielddefs, name) if n not in names
        )
    embedded = [
        f'{definitions.SEPARATOR}\nMSG: {name.replace("/msg/", "/")}\n{_own_text(name)}'
        for name in names[1:]
    ]
    return ''.join([_own_text(type_name), *embedded])


def _own_text(type_name: str) -> str:
    # Only our own definitions are taken as written: their comments carry units and [wall] tags.
    text = definitions.find_text(type_name) if type_name.startswith(f'{PACKAGE}/') else None
    if text is None:
        whole: str = typestore().generate_msgdef(type_name, ros_version=2)[0]
        text = whole.split(definitions.SEPARATOR)[0]
    return text if text.endswith('\n') or not text else text + '\n'


@cache
def type_hash(type_name: str) -> str:
    """Return the REP 2011 hash of a type, `RIHS01_...`, the same as on a live graph."""
    ensure_type(type_name)
    return str(typestore().hash_rihs01(type_name))


def serialize(message: Any, type_name: str | None = None, store: Any = None) -> bytes:
    """Return a message of rosbags in CDR, little endian.

    Parameters
    ----------
    message : object
        Message made by `message_type` or `deserialize`.
    type_name : str, optional
        Its type; by default what the message itself says.
    store : optional
        Store of the type; by default `typestore()`.

    Raises
    ------
    BagDataError
        If a field does not fit the type.
    """
    name = type_name or message.__msgtype__
    try:
        return bytes((store or typestore()).serialize_cdr(message, name))
    except (AttributeError, TypeError, ValueError, KeyError, struct.error) as error:
        raise BagDataError(f'expected a message that fits {name} but found: {error}') from error


def deserialize(raw: bytes, type_name: str, store: Any = None) -> Any:
    """Return the message that CDR bytes hold; its arrays are read-only views of the bytes.

    Raises
    ------
    BagDataError
        If the bytes do not fit the type.
    """
    try:
        return (store or typestore()).deserialize_cdr(raw, type_name)
    except _decoding_errors() as error:
        why = 'the message is damaged or was recorded with another definition of the type'
        raise BagDataError(
            f'expected {len(raw)} bytes that fit {type_name} but found: '
            + (COMPRESSED if is_compressed(raw) else f'{error}; {why}')
        ) from error


def is_compressed(raw: bytes) -> bool:
    """Return whether rosbag2 has compressed a message: no CDR begins as zstd does."""
    return bytes(raw[:4]) == b'\x28\xb5\x2f\xfd'


@cache
def _decoding_errors() -> tuple[type[BaseException], ...]:
    serde = load('rosbags.serde')
    return (serde.SerdeError, ValueError, IndexError, AssertionError, struct.error)
