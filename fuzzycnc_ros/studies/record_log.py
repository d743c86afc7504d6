# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The records that a run is judged by, as they were published or as a bag has them."""

import os
from collections import defaultdict
from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.runs import find_topic
from fuzzycnc_ros.runtime.convert import decode
from fuzzycnc_ros.runtime.records import Record

Log = TypeVar('Log', bound='RecordLog')


class RecordLog:
    """The records of a run by topic; a sink for `InProcessGraph`, or read from a bag.

    Attributes
    ----------
    TOPICS : mapping of str to type of Record
        Topics that the run is judged by; those that are not published stay empty.
    REQUIRED : tuple of str
        Those without which a bag is refused, one at least; the first one tells the namespace of
        all.
    """

    TOPICS: ClassVar[Mapping[str, type[Record]]]
    REQUIRED: ClassVar[tuple[str, ...]]

    def __init__(self) -> None:
        self._records: dict[str, list[Any]] = defaultdict(list)

    def __call__(self, topic: str, record: Record) -> None:
        """Take one published record."""
        if topic in self.TOPICS:
            self._records[topic].append(record)

    @classmethod
    def from_bag(
        cls: type[Log], path: str | os.PathLike[str], *, namespace: str | None = None
    ) -> Log:
        """Read the log of a recorded run.

        Parameters
        ----------
        path : path
            The bag.
        namespace : str, optional
            The machine, where the bag holds several.

        Raises
        ------
        BagError
            If the bag cannot be read or lacks one of the topics in `REQUIRED`.
        """
        log = cls()
        first, *others = cls.REQUIRED
        with BagReader(path) as reader:
            topic = find_topic(reader, first, cls.TOPICS[first].TYPE, namespace)
            space = topic.removesuffix(first)
            reader.require([topic, *(f'{space}{name}' for name in others)])
            names = {f'{space}{name}': name for name in cls.TOPICS}
            there = [name for name in names if name in reader.connections]
            for message in reader.messages(there):
                name = names[message.topic]
                log(name, decode(cls.TOPICS[name], message.message))
        return log

    def _between(self, topic: str, start: int, until: int | None) -> list[Any]:
        """Return the records of a topic with `start` <= stamp < `until` [ns]."""
        return [
            item
            for item in self._records[topic]
            if start <= item.stamp and (until is None or item.stamp < until)
        ]
