# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A day of 76 sensors at 10 Hz through the recording thread, in a process that may be killed.

    python recorded_day.py BAG PROGRESS FIRST LAST SPLIT [COPY]

Records messages FIRST up to LAST, in parts of SPLIT s, and writes into the file PROGRESS how many
of the day the recorder has been given.  Machine time passes with the messages, however fast they
are written, and the writer's clock with it: the bag comes out as it does at 10 Hz.
COPY is where the bag goes in the end from a disk that ends with the process.
"""

import argparse
import shutil
import struct
import sys
import time
from pathlib import Path

import numpy as np

from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.bags.metadata import Qos
from fuzzycnc_ros.bags.recorder import RecordingThread
from fuzzycnc_ros.bags.typestore import ROSBAGS, serialize
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.records import SECOND, Temperatures

SENSORS = 76
RATE = 10
"""Messages a second."""
MESSAGES = 24 * 3600 * RATE
TOPIC = '/mill/temperatures'
SETTING, SETTING_TYPE = '/mill/setting', 'std_msgs/msg/UInt64'
"""A latched topic with one message, which every part repeats."""
SETTING_MESSAGE = bytes([0, 1, 0, 0, 7]) + bytes(7)
MODEL = 'thermal_predictor/model.json'
AHEAD = 2
"""Messages given to the recorder at once; with each its clock goes on, so they must be few."""
_NOISE = np.random.default_rng(76).normal(0.0, 0.02, (997, SENSORS)).round(3)


def stamp(number: int) -> int:
    """Return the time of a message of the day [ns], which begins at 1 s."""
    return SECOND + number * (SECOND // RATE)


def values(number: int) -> np.ndarray:
    """Return the temperatures of a message [degC]: they rise over hours, with noise."""
    warm = 20.0 + 8.0 * (1.0 - np.exp(-number / (4 * 3600 * RATE)))
    return np.asarray(warm + 0.05 * np.arange(SENSORS) + _NOISE[number % len(_NOISE)])


def message(number: int) -> bytes:
    """Return a message of the day in CDR."""
    record = Temperatures(
        stamp=stamp(number),
        frame_id='mill/machine',
        sensor=tuple(f'column_{k}' for k in range(SENSORS)),
        temperature=values(number),
        status=np.zeros(SENSORS, dtype=np.uint8),
        readings=5,
    )
    return serialize(encode(record, ROSBAGS))


class Messages:
    """The same messages, made of the first of them: to serialise all takes far longer."""

    def __init__(self) -> None:
        self._first = message(0)
        self._place = self._first.index(values(0).tobytes())

    def __getitem__(self, number: int) -> bytes:
        """Return a message of the day in CDR."""
        rest = self._first
        place = self._place
        time_bytes = struct.pack('<iI', *divmod(stamp(number), SECOND))
        row = values(number).tobytes()
        return rest[:4] + time_bytes + rest[12:place] + row + rest[place + len(row) :]


def record(bag: Path, given: np.ndarray, first: int, last: int, split: float) -> int:
    """Record a part of the day; return the exit code of a recorder.

    Parameters
    ----------
    bag : Path
        The new bag.
    given : ndarray, shape (1,)
        Holds how many messages of the day the recorder has been given.
    first, last : int
        Messages of the day.
    split : float
        Length of a part [s]; 0 for one.
    """
    messages = Messages()
    number = first
    thread = RecordingThread(BagWriter(bag, split_duration=split, clock=lambda: number / RATE))
    try:
        thread.add_topic(SETTING, SETTING_TYPE, Qos(depth=1, durability='transient_local'))
        thread.add_topic(TOPIC, Temperatures.TYPE)
        thread.attach(MODEL, 'steel')
        thread.put(SETTING, SETTING_MESSAGE, stamp(first), sequence=1, publisher='x')
        while number < last and not thread.failed:
            for _ in range(min(AHEAD, last - number)):
                thread.put(TOPIC, messages[number], stamp(number), sequence=number + 1)
                number += 1
                given[0] = number
            while thread.progress().written <= number - first and not thread.failed:
                time.sleep(0.0001)
    except BagError:
        pass  # told again by the end
    try:
        progress = thread.close()
    except BagError as error:
        print(f'error: {error}', file=sys.stderr)
        return 1
    return 1 if progress.lost else 0


def main() -> None:
    """Record as the command line says."""
    parser = argparse.ArgumentParser()
    parser.add_argument('bag', type=Path)
    parser.add_argument('given', type=Path)
    parser.add_argument('first', type=int)
    parser.add_argument('last', type=int)
    parser.add_argument('split', type=float)
    parser.add_argument('copy', type=Path, nargs='?')
    words = parser.parse_args()
    given = np.memmap(words.given, dtype=np.int64, mode='r+', shape=(1,))
    code = record(words.bag, given, words.first, words.last, words.split)
    if words.copy is not None:
        shutil.copytree(words.bag, words.copy)
    sys.exit(code)


if __name__ == '__main__':
    main()
