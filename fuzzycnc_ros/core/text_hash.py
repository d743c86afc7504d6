# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The identity of a model file: the hash of its text."""

import hashlib


def text_hash(text: str) -> str:
    """Return the SHA-256 of a text in UTF-8, 64 hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()
