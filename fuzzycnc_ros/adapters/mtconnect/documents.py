# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Documents of an MTConnect agent: which data items there are, and what they observed.

MTConnect Standard, part 1 (headers, error codes, sequence numbers) and part 3 (streams).
"""

from dataclasses import dataclass
from xml.etree import ElementTree

from fuzzycnc_ros.adapters.link import LinkError

KINDS = ('MTConnectDevices', 'MTConnectStreams', 'MTConnectError')
"""Documents that are read; `MTConnectAssets` is none of them."""
SEQUENCE_MAX = 2**64
"""Bound of the sequence numbers of an agent."""
DEPTH_MAX = 100
"""Deepest nesting of elements; machines have about ten levels."""


@dataclass(frozen=True)
class DataItem:
    """Data item of an agent.

    Attributes
    ----------
    identifier : str
        Its id, unique in the agent.
    name : str
        Its name; devices may share one.  Empty if it has none.
    units : str
        What its values are in, as `CELSIUS`; empty if that is not stated.
    """

    identifier: str
    name: str
    units: str


@dataclass(frozen=True)
class Document:
    """One document.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    instance : str
        The run of the agent; another one begins with its own sequence numbers.
    created : str
        Time of day on the clock of the agent.
    buffer_size : int
        Most observations that it keeps; 0 if not stated.
    first, following : int, optional
        Sequence number of the oldest observation that it keeps, and of the next to ask for.
    items : tuple of DataItem
        Data items, of `MTConnectDevices`.
    observations : dict
        Id of a data item to the text of its newest observation, of `MTConnectStreams`.
    errors : dict
        Error code to its text, of `MTConnectError`.
    """

    kind: str
    instance: str
    created: str
    buffer_size: int
    first: int | None
    following: int | None
    items: tuple[DataItem, ...]
    observations: dict[str, str]
    errors: dict[str, str]


def parse(data: bytes) -> Document:
    """Return what a document says.

    Raises
    ------
    LinkError
        If it is no document of MTConnect, or declares a document type: that is where entities
        come from, which grow without bounds or name other files.
    """
    reader = _Reader()
    parser = ElementTree.XMLParser(target=reader)
    try:
        parser.feed(data)
        parser.close()
    except ElementTree.ParseError as error:
        raise LinkError(f'expected a document of MTConnect but found no XML ({error})') from error
    return reader.document()


class _Reader:
    """Takes what the parser finds; keeps what is of use and no tree."""

    def __init__(self) -> None:
        self._path: list[str] = []
        self._text: list[str] = []
        self._header: dict[str, str] = {}
        self._items: list[DataItem] = []
        self._newest: dict[str, tuple[int, str]] = {}
        self._errors: dict[str, str] = {}
        self._kind = ''
        self._open: tuple[str, int] | None = None
        self._code = ''

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        """Refuse a document type."""
        raise LinkError('expected a document of MTConnect but it declares a document type')

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Take the beginning of an element."""
        word = tag.rpartition('}')[2]
        if not self._path:
            if word not in KINDS:
                raise LinkError(
                    f'expected one of {", ".join(KINDS)} but found {word[:60]!r}; is it an agent '
                    'of MTConnect?'
                )
            self._kind = word
        self._path.append(word)
        if len(self._path) > DEPTH_MAX:
            raise LinkError(f'expected at most {DEPTH_MAX} levels of elements but found more')
        self._text.clear()
        self._open, self._code = None, ''
        if word == 'Header' and not self._header:
            self._header = attributes
        elif self._kind == 'MTConnectDevices' and word == 'DataItem':
            units = attributes.get('units') or attributes.get('nativeUnits') or ''
            found = DataItem(attributes.get('id', ''), attributes.get('name', ''), units)
            self._items.append(found)
        elif self._kind == 'MTConnectStreams' and 'dataItemId' in attributes:
            number = _sequence(attributes, 'sequence')
            self._open = (attributes['dataItemId'], -1 if number is None else number)
        elif self._kind == 'MTConnectError' and 'errorCode' in attributes:
            self._code = attributes['errorCode']

    def data(self, text: str) -> None:
        """Take text."""
        self._text.append(text)

    def end(self, tag: str) -> None:
        """Take the end of an element."""
        self._path.pop()
        text = ''.join(self._text).strip()
        self._text.clear()
        if self._open is not None:
            identifier, number = self._open
            if identifier not in self._newest or number >= self._newest[identifier][0]:
                self._newest[identifier] = number, text
        elif self._code:
            self._errors[self._code] = text
        self._open, self._code = None, ''

    def close(self) -> None:
        """Do nothing more at the end."""

    def document(self) -> Document:
        """Return what was found."""
        header = self._header
        return Document(
            kind=self._kind,
            instance=header.get('instanceId', ''),
            created=header.get('creationTime', ''),
            buffer_size=_sequence(header, 'bufferSize') or 0,
            first=_sequence(header, 'firstSequence'),
            following=_sequence(header, 'nextSequence'),
            items=tuple(self._items),
            observations={name: text for name, (_, text) in self._newest.items()},
            errors=self._errors,
        )


def _sequence(attributes: dict[str, str], name: str) -> int | None:
    """Return a sequence number, None if there is none."""
    text = attributes.get(name)
    if text is None:
        return None
    if not (text.isascii() and text.isdecimal() and len(text) <= 20 and int(text) < SEQUENCE_MAX):
        raise LinkError(f'{name}: expected a number below 2^64 but found {text[:40]!r}')
    return int(text)
