# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What stands in the files of a bag, for tests that look for what must not."""

from pathlib import Path

from mcap.reader import make_reader


def contents(path: Path) -> list[bytes]:
    """Return what a file of a bag holds, messages and attachments unpacked."""
    found = [path.read_bytes()]
    if path.suffix == '.mcap':
        with path.open('rb') as stream:
            reader = make_reader(stream)
            found += [message.data for _, _, message in reader.iter_messages()]
            found += [attachment.data for attachment in reader.iter_attachments()]
    return found
