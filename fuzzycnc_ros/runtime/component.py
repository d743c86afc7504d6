# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The declaration of a node's interface and the base of every component.

A component is driven by records and their stamps alone: it asks no clock, never sleeps and
draws no unseeded random number.  The same object therefore runs inside a node, in the
in-process graph, in a bag replay and in offline evaluation.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import Any, ClassVar, Generic, TypeVar, cast

from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.runtime.records import Record, nanoseconds

REQUEST = 'sources'
"""Name of the request; arguments `input` and `node`, names of nodes, none if all is well again."""


class CommandSources:
    """The inputs of a component that several nodes publish at once.

    Parameters
    ----------
    inputs : iterable of str
        Inputs that have to have one source alone.
    """

    def __init__(self, inputs: Iterable[str]) -> None:
        self._known = tuple(inputs)
        self._nodes: dict[str, tuple[str, ...]] = {}

    def note(self, arguments: Mapping[str, Any]) -> str:
        """Take the fact that a host has found; return it in words.

        Raises
        ------
        ValueError
            If it names no such input, or no nodes.
        """
        name, nodes = arguments.get('input'), arguments.get('node')
        if not isinstance(name, str) or name not in self._known:
            known = ', '.join(self._known) or 'none'
            raise ValueError(f'input: expected {known} but found {name}')
        if not _is_names(nodes):
            raise ValueError(f'node: expected a list of node names but found {nodes!r}')
        self._nodes[name] = tuple(nodes or ())
        return self.refusal(name) or f'{name} has one source again'

    def refusal(self, name: str) -> str:
        """Say why nobody is believed on an input; empty if its source is alone."""
        nodes = self._nodes.get(name, ())
        if not nodes:
            return ''
        named = ', '.join(nodes)
        return f'{name} comes from several nodes, all are refused: {named}; end all but one'

    @property
    def refusals(self) -> dict[str, str]:
        """Why nobody is believed, by input; without those that are well."""
        found = {name: self.refusal(name) for name in self._known}
        return {name: text for name, text in found.items() if text}


def _is_names(value: Any) -> bool:
    names = isinstance(value, Sequence) and not isinstance(value, str)
    return names and all(isinstance(item, str) for item in value)


ConfigT = TypeVar('ConfigT', bound=Config)
ComponentT = TypeVar('ComponentT', bound='Component[Any]')
RecordT = TypeVar('RecordT', bound=Record)


class Durability(Enum):
    """Durability of a topic; the host maps it to QoS (docs/explanation/architecture.md)."""

    STREAM = 'stream'
    """Reliable, volatile; deep on the publisher's side."""
    LATCHED = 'latched'
    """Transient local: a late reader gets the newest message."""
    HISTORY = 'history'
    """Transient local, deeper: a late reader gets all that was said, for rare events."""


STREAM, LATCHED, HISTORY = Durability.STREAM, Durability.LATCHED, Durability.HISTORY


@dataclass(frozen=True)
class Input(Generic[RecordT]):
    """One input of a component.

    Attributes
    ----------
    name : str
        Topic, a relative noun, and the suffix of the method `on_<name>` that takes it.
    record : type
        Record type.
    durability : Durability
        How the topic is kept.
    driving : bool
        Whether a record makes the component act.  Each component has at most one such input.
    max_age : float
        Age [s] beyond which a record no longer counts; infinite for latched facts.
    quiet : bool
        Whether a record is only noted for the next driving one: nothing follows from it alone,
        so that in lock-step it gives no turn.
    sole : bool
        Whether a machine depends on it, so that two nodes that publish it at once are both
        refused; the host tells the component by the request `sources`.
    paced : bool
        Whether records come at a pace, so that silence is a fault.  News, probes and commands of
        a person come when there are some.
    """

    name: str
    record: type[RecordT]
    durability: Durability = STREAM
    driving: bool = False
    max_age: float = float('inf')
    quiet: bool = False
    sole: bool = False
    paced: bool = True


@dataclass(frozen=True)
class Output:
    """One output of a component; `persistent` asks the host to keep its newest record on disk."""

    name: str
    record: type[Record]
    durability: Durability = STREAM
    persistent: bool = False


@dataclass(frozen=True)
class Emission:
    """A record that a component publishes."""

    output: str
    record: Record


class Level(IntEnum):
    """Severity of a health item, as in `diagnostic_msgs/DiagnosticStatus`."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Health:
    """One line of a component's health."""

    name: str
    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Answer:
    """Outcome of a request: whether it was carried out, why, and what it published."""

    success: bool
    message: str
    emissions: tuple[Emission, ...] = ()


class Component(Generic[ConfigT]):
    """Base of all components, generic in its configuration.

    Subclasses set the class attributes and write `on_<input>` for their driving input.  Such a
    method may also exist for a side input, to take note of it; only driving inputs, deadlines
    and requests emit.
    """

    NAME: ClassVar[str]
    """Node, module, executable and parameter file."""
    SUMMARY: ClassVar[str]
    """One sentence for the tables of the docs."""
    CONFIG: ClassVar[type[Config]]  # a class variable cannot name ConfigT
    INPUTS: ClassVar[tuple[Input[Any], ...]] = ()
    OUTPUTS: ClassVar[tuple[Output, ...]] = ()
    MANAGED: ClassVar[bool] = False
    """True if the node has a managed lifecycle."""
    MACHINE_SIDE: ClassVar[bool] = False
    """True if its inputs make something move."""

    def __init__(self, config: ConfigT | None = None) -> None:
        self._config: ConfigT = cast('ConfigT', self.CONFIG()) if config is None else config
        self._newest: dict[str, Record] = {}
        self.sources = CommandSources(item.name for item in self.INPUTS if item.sole)
        self.machine = 'machine'
        """Name of the machine, the first part of every frame id; the host sets it."""

    @property
    def configuration(self) -> ConfigT:
        """The configuration in force."""
        return self._config

    def reconfigure(self, config: ConfigT) -> None:
        """Take a configuration whose live parameters changed."""
        if not isinstance(config, self.CONFIG):
            found = type(config).__name__
            raise TypeError(f'expected {self.CONFIG.__name__} but found {found}')
        self._config = config

    def prepare(self, model: str, run_reader: Callable[..., Any]) -> None:
        """Take what a host has for it before the first record; most components need nothing.

        Parameters
        ----------
        model : str
            Text of the model file to begin with, empty for none.
        run_reader : callable
            Reads a bag as a run, as `bags.runs.read_run` does.
        """

    @property
    def next_deadline(self) -> int | None:
        """Machine time [ns] at which the component wants to act without an input."""
        return None

    def receive(self, name: str, record: Record) -> Iterator[Emission]:
        """Take one record of input `name`; yield what it causes.

        Where several nodes publish what one alone may, nobody knows which of them is right.
        """
        if self.sources.refusal(name):
            return
        self._newest[name] = record
        handler = getattr(self, f'on_{name}', None)
        if handler is not None:
            yield from handler(record) or ()

    def on_deadline(self, stamp: int) -> Iterable[Emission]:
        """Act at a deadline that the component asked for; yield what it causes."""
        return ()

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """Carry out a service call or lifecycle transition at machine time `stamp` [ns]."""
        if name == REQUEST:
            try:
                return Answer(True, self.sources.note(arguments))
            except ValueError as error:
                return Answer(False, str(error))
        return Answer(False, f'{self.NAME} knows no request {name}')

    def renewed(self, step: int) -> tuple['Component[ConfigT]', list[Emission]]:
        """Return what goes on after the clock has stepped, and what it says at once.

        Stamps begin a new series then, so what rests on times of the old one is forgotten; the
        host activates a component anew that was active.

        Parameters
        ----------
        step : int
            By how much the clock went forward [ns]; negative if it went back.
        """
        return self._afresh(), []

    def _afresh(self: ComponentT) -> ComponentT:
        """Return a component of the same machine and parameters that has heard nothing yet."""
        fresh = type(self)(self._config)
        fresh.machine, fresh.sources = self.machine, self.sources
        return fresh

    def restore(self, output: str, record: Record) -> None:
        """Take back a record that the component published earlier.

        That is a persistent one of an earlier life, or, in the replay of a bag that begins in the
        middle of a recording, what it published first there.
        """

    def silence(self, name: str, last: Record) -> str:
        """Say what it means that nothing came after `last`; empty if it is nothing but late."""
        return ''

    def health(self) -> list[Health]:
        """Report on inputs, sensors and limits; the host adds timing and publishes it."""
        return []

    @property
    def model_text(self) -> str:
        """Text of the model file in use, empty if there is none."""
        return ''

    def newest(self, source: 'Input[RecordT]', stamp: int) -> RecordT | None:
        """Return the newest record of a side input that is not too old at `stamp` [ns]."""
        record = self.last(source)
        if record is None:
            return None
        age_max = source.max_age
        if age_max != float('inf') and stamp - record.stamp > nanoseconds(age_max):
            return None
        return record

    def last(self, source: 'Input[RecordT]') -> RecordT | None:
        """Return the newest record of an input, however old."""
        record = self._newest.get(source.name)
        return record if isinstance(record, source.record) else None

    @classmethod
    def input(cls, name: str) -> 'Input[Any]':
        """Return the declaration of an input."""
        return next(item for item in cls.INPUTS if item.name == name)

    @classmethod
    def output(cls, name: str) -> Output:
        """Return the declaration of an output."""
        return next(item for item in cls.OUTPUTS if item.name == name)

    def frame(self, part: str) -> str:
        """Return the frame id of a part of this machine: machine, workpiece or tool."""
        return f'{self.machine}/{part}'


class TickingComponent(Component[ConfigT], ABC):
    """A component that makes machine time, tick by tick, for all others of its graph."""

    @property
    @abstractmethod
    def next_tick(self) -> int | None:
        """Machine time of the next tick [ns]; None when the programme is over."""

    @property
    @abstractmethod
    def total_ticks(self) -> int:
        """Number of ticks of the whole programme, or an estimate."""

    @property
    @abstractmethod
    def ticks_done(self) -> int:
        """Number of `total_ticks` that are over."""

    @abstractmethod
    def tick(self) -> Iterator[Emission]:
        """Move on to the next tick and report everything that is measured there."""
