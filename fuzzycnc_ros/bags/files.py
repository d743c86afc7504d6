# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Which storage files belong to a bag directory."""

from contextlib import suppress
from pathlib import Path

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.bags.metadata import Metadata


def bag_files(folder: Path, metadata: Metadata) -> list[Path]:
    """Return the storage files that a `metadata.yaml` names.

    Raises
    ------
    BagFormatError
        If one is missing, or lies outside of the bag's directory.
    """
    files = []
    for name in metadata.files:
        relative = Path(name)
        if relative.is_absolute() or '..' in relative.parts:
            raise BagFormatError(
                f'{folder}: expected storage files inside of the bag but metadata.yaml names '
                f'{name!r}'
            )
        # The first versions of rosbag2 wrote the bag's own directory in front.
        candidates = [folder / relative, folder / relative.name]
        file = next((path for path in candidates if path.exists()), None)
        if file is None:
            there = sorted(p.name for p in folder.iterdir())
            raise BagFormatError(
                f'{folder}: expected the storage file {name!r} but found {", ".join(there)}'
            )
        with suppress(OSError):
            if not file.resolve().is_relative_to(folder.resolve()):
                raise BagFormatError(
                    f'{folder}: expected storage files inside of the bag but {name!r} leads to '
                    f'{file.resolve()}'
                )
        files.append(file)
    return files


def storage_files(folder: Path) -> list[Path]:
    """Return the storage files that lie in a directory, in recording order."""
    files = [*folder.glob('*.mcap'), *folder.glob('*.db3')]
    # rosbag2 numbers the files of a split recording: bag_2 comes before bag_10.
    return sorted(files, key=lambda path: (len(path.name), path.name))
