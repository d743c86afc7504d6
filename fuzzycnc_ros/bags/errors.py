# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the bag machinery: each is one clear line with the way out."""


class BagError(ValueError):
    """A bag or recording cannot be used as asked; base of every error of this package."""


class MissingLibraryError(BagError):
    """A library that is loaded on use is not installed."""


class BagFormatError(BagError):
    """A file is not a bag, is damaged, or is of a kind that is not read here."""


class BagTruncatedError(BagFormatError):
    """A bag file was cut off: its recorder was killed, or still writes."""


class BagCountError(BagError):
    """A bag promises another number of messages than it yields."""


class BagTopicError(BagError):
    """A bag lacks a topic, or has it with another type."""


class BagTypeError(BagError):
    """A message type is unknown, or its definition cannot be used."""


class BagDataError(BagError):
    """A message does not fit its type."""


class BagVersionError(BagError):
    """A bag was recorded with a message set that cannot be read here."""


class BagExistsError(BagError):
    """A bag would overwrite something."""


class BagWriteError(BagError):
    """A bag could not be written further, for example because the disk is full."""


class CsvError(BagError):
    """A CSV recording cannot be imported."""


class RunError(BagError):
    """A bag holds no usable thermal run."""
