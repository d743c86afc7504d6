# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The `metadata.yaml` of a rosbag2 directory, version 9 as Jazzy writes it, and its QoS text."""

import stat
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.files.atomic import write_text

METADATA_FILE = 'metadata.yaml'
VERSION = 9
"""Version of `metadata.yaml` that rosbag2 of Jazzy writes and the newest that is read here."""

METADATA_MAX = 8 * 1024 * 1024
"""Largest `metadata.yaml` that is read [bytes]."""

METADATA_RECORD = 'fuzzycnc'
"""Name of the MCAP metadata record that holds the message-set version and the part's number."""
PART = 'part'
"""Its entry with the number of a part; absent in the first."""

MESSAGE_SET_KEY = 'fuzzycnc_message_set'
DELETED_PARTS_KEY, DELETED_MESSAGES_KEY = 'fuzzycnc_deleted_parts', 'fuzzycnc_deleted_messages'
DELETED_UNTIL_KEY = 'fuzzycnc_deleted_until'
"""Metadata key of the deleted beginning of a bag within a budget; its end in ns of log time."""
STATE_KEY = 'fuzzycnc_state'
STATE_RECORDING, STATE_CLOSED = 'recording', 'closed'

_DEPTH_MAX = 32  # rosbag2 nests 7 levels
_NODES_MAX = 400_000  # rosbag2 writes about 30 for a topic, and 14 for a part of the bag
_NEVER = {'sec': 9223372036, 'nsec': 854775807}  # rmw's infinite duration
_EMPTY_START = 2**63 - 1  # what rosbag2 writes as the start of a bag without messages


@dataclass(frozen=True)
class Qos:
    """Quality of service that a topic's publisher offered.

    Parameters
    ----------
    history : {'keep_last', 'keep_all'}
    depth : int
        Number of messages kept, 0 with `keep_all`.
    reliability : {'reliable', 'best_effort'}
    durability : {'volatile', 'transient_local'}
    """

    history: str = 'keep_last'
    depth: int = 10
    reliability: str = 'reliable'
    durability: str = 'volatile'

    def __post_init__(self) -> None:
        """Refuse words that rosbag2 would not understand."""
        allowed = {
            'history': ('keep_last', 'keep_all'),
            'reliability': ('reliable', 'best_effort'),
            'durability': ('volatile', 'transient_local'),
        }
        for name, words in allowed.items():
            if getattr(self, name) not in words:
                raise ValueError(
                    f'{name}: expected {" or ".join(words)} but found {getattr(self, name)!r}'
                )

    def profile(self) -> dict[str, Any]:
        """Return the profile in the order and words of rosbag2."""
        return {
            'history': self.history,
            'depth': self.depth,
            'reliability': self.reliability,
            'durability': self.durability,
            'deadline': dict(_NEVER),
            'lifespan': dict(_NEVER),
            'liveliness': 'automatic',
            'liveliness_lease_duration': dict(_NEVER),
            'avoid_ros_namespace_conventions': False,
        }


STREAM = Qos(depth=2000)
LATCHED = Qos(depth=1, durability='transient_local')

Profiles = list[dict[str, Any]]
"""QoS profiles as rosbag2 writes them, one for each publisher of a topic."""


@dataclass
class TopicInfo:
    """Properties of one topic of a bag.

    Parameters
    ----------
    name, type : str
        Topic and type, `package/msg/Name`.
    profiles : list of dict
        Offered QoS profiles in rosbag2's own words; empty if unknown.
    type_hash : str
        REP 2011 hash of the type, empty if unknown.
    message_count : int
        Number of messages; as the bag promises where it is read.
    definition : str
        Definition that the bag embeds, empty if there is none.
    """

    name: str
    type: str
    profiles: Profiles = field(default_factory=list)
    type_hash: str = ''
    message_count: int = 0
    definition: str = ''


def is_latched(profiles: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether all publishers of a topic keep their last message for late readers."""
    return bool(profiles) and all(
        item.get('durability') in ('transient_local', 1) for item in profiles
    )


def qos_text(profiles: Sequence[Mapping[str, Any]]) -> str:
    """Return QoS profiles as the YAML text that an MCAP channel carries."""
    if not profiles:
        return ''
    return str(_dump([dict(p) for p in profiles])).strip()


def parse_qos(value: object) -> Profiles:
    """Return QoS profiles from an MCAP channel's text or an entry of `metadata.yaml`.

    Old bags hold the numbers of rmw where newer ones hold words; both are passed on as found.
    Anything unreadable counts as unknown: how a topic was offered does not change its messages.
    """
    if isinstance(value, str):
        yaml = load('yaml')
        if len(value) > METADATA_MAX:
            return []
        try:
            value = _load(value)
        except (yaml.YAMLError, ValueError):
            return []
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        return []
    return [dict(item) for item in value]


@dataclass(frozen=True)
class Part:
    """A storage file of a bag.

    Parameters
    ----------
    path : str
        Its path, relative to the bag.
    start, stop : int
        Log time of its first and last message [ns]; both 0 without messages.
    message_count : int
        Number of its messages.
    """

    path: str
    start: int = 0
    stop: int = 0
    message_count: int = 0


@dataclass
class Metadata:
    """Content of a `metadata.yaml`.

    Parameters
    ----------
    storage : str
        `mcap` or `sqlite3`.
    parts : list of Part
        The storage files, in recording order.
    start, stop : int
        Log time of the first and last message [ns]; both 0 without messages.
    topics : list of TopicInfo
        All topics with their message counts.
    custom : dict
        Further facts, text to text.
    compression : str
        rosbag2's own compression of whole files or messages, mode and format; empty if there is
        none.
    version : int
        Version of the file.
    stated : int, optional
        Number of messages on all topics that the file states.
    """

    storage: str
    parts: list[Part]
    start: int = 0
    stop: int = 0
    topics: list[TopicInfo] = field(default_factory=list)
    custom: dict[str, str] = field(default_factory=dict)
    compression: str = ''
    version: int = VERSION
    stated: int | None = None

    @property
    def message_count(self) -> int:
        """Number of messages on all topics."""
        return sum(topic.message_count for topic in self.topics)

    def text(self) -> str:
        """Return the content of `metadata.yaml` in version 9."""
        return str(_dump({'rosbag2_bagfile_information': self._information()}))

    def inner_text(self) -> str:
        """Return what rosbag2 stores inside an MCAP file for `ros2 bag reindex`."""
        return str(_dump(self._information()))

    def _information(self) -> dict[str, Any]:
        return {
            'version': VERSION,
            'storage_identifier': self.storage,
            **_span(self.start, self.stop, self.message_count),
            'message_count': self.message_count,
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': topic.name,
                        'type': topic.type,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': topic.profiles,
                        'type_description_hash': topic.type_hash,
                    },
                    'message_count': topic.message_count,
                }
                for topic in self.topics
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [part.path for part in self.parts],
            'files': [
                {
                    'path': part.path,
                    **_span(part.start, part.stop, part.message_count),
                    'message_count': part.message_count,
                }
                for part in self.parts
            ],
            'custom_data': self.custom,
            'ros_distro': 'jazzy',
        }

    def write(self, folder: Path) -> None:
        """Write `metadata.yaml` into a folder, whole or not at all."""
        write_text(folder / METADATA_FILE, self.text())


def _span(start: int, stop: int, count: int) -> dict[str, dict[str, int]]:
    """Return when something lasted, in the words of rosbag2."""
    return {
        'duration': {'nanoseconds': stop - start},
        'starting_time': {'nanoseconds_since_epoch': start if count else _EMPTY_START},
    }


def read_metadata(folder: Path) -> Metadata | None:
    """Read the `metadata.yaml` of a bag directory, None if there is none.

    Raises
    ------
    BagFormatError
        If it is too large, no YAML, of a newer version, or lacks an entry.
    """
    path = folder / METADATA_FILE
    if not path.exists():
        return None
    if not stat.S_ISREG(path.stat().st_mode) or path.stat().st_size > METADATA_MAX:
        raise BagFormatError(
            f'{path}: expected a file of at most {METADATA_MAX} bytes; remove it to read the '
            'storage files without it'
        )
    yaml = load('yaml')
    try:
        content = _load(path.read_text(encoding='utf-8'))
        return _metadata(content['rosbag2_bagfile_information'])
    except BagFormatError as error:
        raise BagFormatError(f'{path}: {error}') from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        line = ' '.join(str(error).split())
        raise BagFormatError(
            f'{path}: expected YAML but found: {line}; run `fuzzycnc info --repair`'
        ) from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise BagFormatError(
            f'{path}: expected the entries of rosbag2 but one is missing or wrong '
            f'({type(error).__name__}: {error}); run `fuzzycnc info --repair`'
        ) from error


def _metadata(content: dict[str, Any]) -> Metadata:
    version = int(content['version'])
    if version > VERSION:
        raise BagFormatError(f'expected version {VERSION} or older but found {version}')
    count = int(content['message_count'])
    start = int(content['starting_time']['nanoseconds_since_epoch']) if count else 0
    topics = [
        TopicInfo(
            name=str(entry['topic_metadata']['name']),
            type=str(entry['topic_metadata']['type']),
            profiles=parse_qos(entry['topic_metadata'].get('offered_qos_profiles', [])),
            type_hash=str(entry['topic_metadata'].get('type_description_hash', '')),
            message_count=int(entry['message_count']),
        )
        for entry in content['topics_with_message_count']
    ]
    entries = (str(content.get(f'compression_{name}') or '') for name in ('mode', 'format'))
    compression = ' '.join(text for text in entries if text.lower() not in ('', 'none'))
    custom = content.get('custom_data') or {}
    return Metadata(
        storage=str(content['storage_identifier']),
        parts=_parts(content),
        start=start,
        stop=start + int(content['duration']['nanoseconds']) if count else 0,
        topics=topics,
        custom={str(key): str(value) for key, value in custom.items()},
        compression=compression.lower(),
        version=version,
        stated=count,
    )


def _parts(content: dict[str, Any]) -> list[Part]:
    """Return the storage files; versions before 5 say of each nothing but where it is."""
    said = {str(entry['path']): entry for entry in content.get('files') or ()}
    parts = []
    for name in map(str, content['relative_file_paths']):
        entry = said.get(name, {'message_count': 0})
        count = int(entry['message_count'])
        start = int(entry['starting_time']['nanoseconds_since_epoch']) if count else 0
        stop = start + int(entry['duration']['nanoseconds']) if count else 0
        parts.append(Part(name, start, stop, count))
    return parts


def _load(text: str) -> Any:
    """Load YAML that is neither too deep nor too much, references counted for what they stand for.

    The fast loader crashes the process on deep nesting; ten lines of references to references
    stand for more than any memory holds.
    """
    yaml = load('yaml')
    loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
    sizes: dict[str, int] = {}
    opened: list[tuple[str | None, int]] = []
    total = 0
    for event in yaml.parse(text, Loader=loader):
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in sizes:  # of what it is a part of itself
                raise yaml.YAMLError(f'expected no *{event.anchor} in its own definition')
            total += sizes[event.anchor]
        elif isinstance(event, yaml.CollectionStartEvent):
            opened.append((event.anchor, total))
            total += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = opened.pop()
            if anchor is not None:
                sizes[anchor] = total - before
        elif isinstance(event, yaml.ScalarEvent):
            total += 1
            if event.anchor is not None:
                sizes[event.anchor] = 1
        if len(opened) > _DEPTH_MAX:
            raise yaml.YAMLError(f'expected at most {_DEPTH_MAX} levels')
        if total > _NODES_MAX:
            raise yaml.YAMLError(f'expected at most {_NODES_MAX} values')
    return yaml.load(text, Loader=loader)


def _dump(value: object) -> str:
    yaml = load('yaml')

    # rosbag2's files repeat equal values where YAML would refer back to the first.
    fast = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)
    dumper = type('Dumper', (fast,), {'ignore_aliases': lambda self, data: True})
    return str(yaml.dump(value, Dumper=dumper, sort_keys=False, allow_unicode=True))


def bag_files(folder: Path, metadata: Metadata) -> list[Path]:
    """Return the storage files that a `metadata.yaml` names.

    Raises
    ------
    BagFormatError
        If one is missing, or lies outside of the bag's directory.
    """
    files = []
    for name in (part.path for part in metadata.parts):
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
