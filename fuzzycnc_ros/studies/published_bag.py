# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Everything that an in-process graph publishes, in a bag like that of a live recorder."""

import os

from fuzzycnc_ros.bags.metadata import LATCHED as LATCHED_QOS
from fuzzycnc_ros.bags.metadata import STREAM as STREAM_QOS
from fuzzycnc_ros.bags.typestore import ROSBAGS
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.runtime.component import LATCHED
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.records import Record

_LATCHED_TOPICS = {'node_configuration'} | {
    item.name
    for component in COMPONENTS.values()
    for item in component.OUTPUTS
    if item.durability is LATCHED
}


class PublishedBag:
    """A sink for `InProcessGraph` that writes every record into a new bag.

    With the graph's `provenance` the bag also holds configurations, requests and turns, and can
    be replayed.

    Parameters
    ----------
    path : path
        Directory of the bag; it must not exist.
    machine : str
        Name of the machine, the namespace of all topics.

    Raises
    ------
    BagExistsError
        If `path` exists.
    BagWriteError
        If the bag cannot be written.

    Notes
    -----
    Messages are logged at the newest machine time seen, as the recorder logs them in lock-step.
    Chunks are closed by size alone, so that equal runs give equal files.
    """

    def __init__(self, path: str | os.PathLike[str], *, machine: str = 'mill') -> None:
        self._writer = BagWriter(path, flush_interval=None)
        self._space = f'/{machine}'
        self._newest = 0
        self._early: list[tuple[str, Record]] = []

    def __enter__(self) -> 'PublishedBag':
        """Return the sink."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the bag; what was written before an error stays readable."""
        self.close()

    def __call__(self, topic: str, record: Record) -> None:
        """Write one record."""
        self._newest = max(self._newest, record.stamp)
        if self._newest == 0:
            # What is said before the first tick has no machine time to be logged at.
            self._early.append((topic, record))
            return
        self._write_early()
        self._write(topic, record)

    def attach(self, name: str, text: str) -> None:
        """Keep a JSON document, such as a model file, beside the messages."""
        self._writer.attach(name, text, 'application/json')

    def close(self) -> None:
        """Finish the bag; closing twice does nothing."""
        self._write_early()
        self._writer.close()

    def _write_early(self) -> None:
        for topic, record in self._early:
            self._write(topic, record)
        self._early.clear()

    def _write(self, topic: str, record: Record) -> None:
        name = f'{self._space}/{topic}'
        if name not in self._writer.topics:
            qos = LATCHED_QOS if topic in _LATCHED_TOPICS else STREAM_QOS
            self._writer.add_topic(name, record.TYPE, qos)
        self._writer.write_message(name, encode(record, ROSBAGS), self._newest)
