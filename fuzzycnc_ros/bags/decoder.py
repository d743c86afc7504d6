# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Decoding the messages of one bag with the definitions that it embeds."""

from collections.abc import Iterable
from typing import Any

from fuzzycnc_ros.bags import definitions
from fuzzycnc_ros.bags.errors import BagTypeError, BagVersionError
from fuzzycnc_ros.bags.fast_decode import Decode, fast_decoder
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.bags.storage import Channel
from fuzzycnc_ros.bags.typestore import (
    PACKAGE,
    deserialize,
    ensure_type,
    message_definition,
    type_hash,
    typestore,
)
from fuzzycnc_ros.bags.upgrade import Upgraders


class Decoder:
    """Decodes messages of a bag.

    A type is decoded with the definition that the bag embeds; where the bag has none, or the
    same one as this machine, with this machine's own.

    Parameters
    ----------
    channels : iterable of Channel
        The bag's channels.
    version : int
        Message-set version that the bag states.
    upgraders : Upgraders
        Bring messages of older versions of `fuzzycnc_msgs` to the current one.
    """

    def __init__(self, channels: Iterable[Channel], version: int, upgraders: Upgraders) -> None:
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
        version = self._version
        upgrade = self._upgraders.upgrade
        known = self._upgraders.names(type_name, version)
        if known:
            return lambda raw: upgrade(type_name, version, deserialize(raw, type_name, store))
        if type_name.startswith(f'{PACKAGE}/') and store is not typestore():
            raise BagVersionError(
                f'expected {type_name} as in message set {self._upgraders.current} but the bag '
                f'(message set {version}) defines it otherwise and no upgrader is known; '
                'install the fuzzycnc that recorded it'
            )
        fast = fast_decoder(store, type_name)
        return fast or (lambda raw: deserialize(raw, type_name, store))

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
