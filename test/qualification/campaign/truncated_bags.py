# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bags cut at random bytes: what a repair keeps, and what it should have kept."""

import shutil
from collections import Counter
from pathlib import Path

import numpy as np

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.bags.mcapfile import McapFile
from fuzzycnc_ros.bags.metadata import storage_files
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.repair import repair

CUTS = 20


def cut_and_repair(bag: Path, folder: Path, seed: int) -> tuple[int, list[str]]:
    """Cut copies of a bag at random bytes, repair them, compare.

    Parameters
    ----------
    bag : Path
        A bag of one file; it is not changed.
    folder : Path
        Where the copies go; it is removed again.
    seed : int
        Of the places.

    Returns
    -------
    int
        Messages lost that lay whole before the cut.
    list of str
        What went wrong.
    """
    (file,) = storage_files(bag)
    with McapFile(file) as whole:
        ends = [chunk.offset + chunk.length for chunk in whole.chunks]
        counts = [Counter(raw.channel.topic for raw in whole.read(c)) for c in whole.chunks]
    size = file.stat().st_size
    places = np.random.default_rng(seed).integers(1, size, CUTS)
    lost, wrong = 0, []
    for number, place in enumerate(sorted(int(item) for item in places)):
        copy = folder / f'cut_{number}'
        copy.mkdir(parents=True)
        torn = copy / file.name
        shutil.copyfile(file, torn)
        with torn.open('r+b') as handle:
            handle.truncate(place)
        before = sum((c for e, c in zip(ends, counts, strict=True) if e <= place), Counter())
        try:
            report = repair(torn, copy / 'whole')
            with BagReader(copy / 'whole') as reader:
                kept = Counter(message.topic for message in reader.messages(raw=True))
        except BagFormatError as error:
            if before:
                wrong.append(f'cut at byte {place} of {size}: {error}')
                lost += before.total()
            continue
        lost += (before - kept).total()
        stated = {name: topic.kept for name, topic in report.topics.items() if topic.kept}
        if stated != dict(kept):
            wrong.append(f'cut at byte {place} of {size}: the repair tells another number')
    shutil.rmtree(folder)
    return lost, wrong
