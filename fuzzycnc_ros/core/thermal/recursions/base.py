# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recursions from rises to thermal error: fitted models at run time.

Here are what all forms share, the linear form, and the forms made of others.

Every model ends up as a recursion, so that batch prediction, streaming, the model file and the
conversion between sampling intervals are written once.  Batch and stream execute the same
operations and therefore agree to the last digits.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from math import prod
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import NUMBER_MAX, Array, check_bounds, check_shapes
from fuzzycnc_ros.core.document import Node

_Self = TypeVar('_Self', bound='Recursion')


def axes(names: str, low: float = -NUMBER_MAX, high: float = NUMBER_MAX) -> dict[str, Any]:
    """Return what a field that is an array of a recursion declares.

    Parameters
    ----------
    names : str
        A name for each axis: `c` is the channels, `p` the inputs, others are the form's own.  A
        name of several letters is the product of their lengths.
    low, high : float
        Bounds of its numbers, which are allowed themselves.
    """
    return {'axes': tuple(names.split()), 'bounds': (low, high)}


def part(*refused: str, but: str) -> dict[str, Any]:
    """Return what a field that is a recursion of the same channels and inputs declares.

    Parameters
    ----------
    refused : str
        Forms that it may not have: a document must not nest without end.
    but : str
        What it may be instead, for messages.
    """
    return {'refused': refused, 'but': but}


class Recursion(ABC):
    """A fitted model of one or more channels: numbers only, no training data, no estimator.

    A subclass is a frozen dataclass.  It declares its arrays by their axes, its parts, and flags;
    what every form needs follows from that: the refusal of arrays that do not fit together (they
    may come from a file), the choice of a channel, the union of channels, the document.
    """

    FORM: ClassVar[str]
    """Name of the form in model files."""

    GROUP: ClassVar[str] = ''
    """Member of the document that lists the arrays by channels; empty: each is written whole."""

    STATIC: ClassVar[bool] = False
    """True if it holds at any interval, since it has no memory."""

    _sizes: dict[str, int]
    """Length of each axis, found when the recursion is made."""

    @classmethod
    def _arrays(cls) -> dict[str, tuple[str, ...]]:
        """Return the axes of each declared array."""
        return cls._declared('axes')

    @classmethod
    def _declared(cls, what: str) -> dict[str, Any]:
        """Return what `axes` says of each declared array."""
        found = fields(cls)  # type: ignore[arg-type]
        return {item.name: item.metadata[what] for item in found if what in item.metadata}

    @classmethod
    def _parts(cls) -> dict[str, Mapping[str, Any]]:
        """Return what is declared of each part."""
        found = fields(cls)  # type: ignore[arg-type]
        return {item.name: item.metadata for item in found if 'refused' in item.metadata}

    @classmethod
    def _flags(cls) -> list[str]:
        """Return the names of the fields that are neither arrays nor parts."""
        return [item.name for item in fields(cls) if not item.metadata]  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        """Refuse arrays and parts that do not fit together, and what `_check` finds.

        Raises
        ------
        ValueError
            The message names the array.
        """
        sizes: dict[str, int] = {}
        for name in self._parts():
            inner: Recursion = getattr(self, name)
            sizes = sizes or {'c': inner.channels, 'p': inner.inputs}
            if (inner.channels, inner.inputs) != (sizes['c'], sizes['p']):
                raise ValueError(
                    f'{name}: expected {sizes["c"]} channels and {sizes["p"]} inputs as the base '
                    f'has, but found {inner.channels} and {inner.inputs}'
                )
        for name, names in self._arrays().items():
            values = getattr(self, name)
            for axis, length in zip(names, values.shape, strict=False):
                sizes.setdefault(axis, length)
            check_shapes(self, **{name: tuple(sizes.get(axis, -1) for axis in names)})
        check_bounds(self, **self._declared('bounds'))
        object.__setattr__(self, '_sizes', sizes)
        self._check()

    def _check(self) -> None:  # noqa: B027 (most forms have nothing more to refuse)
        """Refuse values that mean nothing in this form."""

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return self._sizes['p']

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return self._sizes['c']

    def initial_state(self) -> Array:
        """Return the state before the first sample of a run, where every rise is zero, flat."""
        states = [getattr(self, name).initial_state() for name in self._parts()]
        return np.concatenate([np.zeros(0), *states])

    @abstractmethod
    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        state = self.initial_state()
        values = np.empty((len(rise), self.channels))
        for k, sample in enumerate(rise):
            values[k], state = self.step(sample, state)
        return values

    def with_interval(self: _Self, ratio: float) -> _Self:
        """Return the recursion for an interval `ratio` times as long.

        Raises
        ------
        ValueError
            If the form has no meaning at another interval.
        """
        if self.STATIC:
            return self
        parts = {name: getattr(self, name).with_interval(ratio) for name in self._parts()}
        if parts:
            return replace(self, **parts)  # type: ignore[type-var]
        raise ValueError(
            f'interval: expected the interval of the training, but found {ratio:g} times that; '
            f'a model of the form {self.FORM!r} holds for one interval: train it anew'
        )

    def channel(self: _Self, channel: int) -> _Self:
        """Return the recursion of one channel out of several."""
        own: dict[str, Any] = {
            name: getattr(self, name)[channel : channel + 1] for name in self._by_channel()
        }
        own |= {name: getattr(self, name).channel(channel) for name in self._parts()}
        return replace(self, **own)  # type: ignore[type-var]

    @classmethod
    def _by_channel(cls) -> list[str]:
        """Return the names of the arrays that each channel has its own of."""
        return [name for name, names in cls._arrays().items() if names[0] == 'c']

    @classmethod
    def merge(cls: type[_Self], items: Sequence[_Self]) -> _Self | None:
        """Return one recursion for the channels of several of this form, None if it cannot be.

        The inputs are the same.  What cannot be merged runs side by side.
        """
        first, own = items[0], cls._by_channel()
        alike = [*cls._flags(), *(name for name in cls._arrays() if name not in own)]
        for item in items[1:]:
            same = all(np.array_equal(getattr(item, n), getattr(first, n)) for n in alike)
            if not same or any(
                getattr(item, n).shape[1:] != getattr(first, n).shape[1:] for n in own
            ):
                return None
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(item, name) for item in items]) for name in own
        }
        for name, declared in cls._parts().items():
            joined[name] = combine([getattr(item, name) for item in items])
            if joined[name].FORM in declared['refused']:
                return None
        return replace(first, **joined)  # type: ignore[type-var]

    def document(self) -> dict[str, Any]:
        """Return the numbers as JSON values; `read` takes them back."""
        values: dict[str, Any] = {name: getattr(self, name) for name in self._flags()}
        values |= {name: write_recursion(getattr(self, name)) for name in self._parts()}
        arrays = {name: getattr(self, name).tolist() for name in self._arrays()}
        if self.GROUP:
            rows = zip(*arrays.values(), strict=True)
            return {**values, self.GROUP: [dict(zip(arrays, row, strict=True)) for row in rows]}
        return values | arrays

    @classmethod
    def read(cls: type[_Self], node: Node, inputs: int) -> _Self:
        """Return the recursion of a document, believing nothing in it.

        Raises
        ------
        ModelFileError, ValueError
            If a value is missing, of another type or shape, or not finite.
        """
        values: dict[str, Any] = {}
        for item in fields(cls):  # type: ignore[arg-type]
            if not item.metadata:
                flag = node.get(item.name)
                values[item.name] = flag.boolean() if item.type is bool else flag.text()
        for name, declared in cls._parts().items():
            inner = node.get(name)
            if inner.get('form').value in declared['refused']:
                inner.refuse(declared['but'])
            values[name] = read_recursion(inner, inputs)
        sizes = {'p': inputs}
        if not cls.GROUP:
            for name, names in cls._arrays().items():
                values[name] = cls._read_array(name, node.get(name), names, sizes)
            return cls(**values)
        rows = node.get(cls.GROUP).list()
        if not rows:
            node.get(cls.GROUP).refuse('the numbers of at least one channel')
        for name, names in cls._arrays().items():
            own = [cls._read_array(name, row.get(name), names[1:], sizes) for row in rows]
            values[name] = np.array(own)
        return cls(**values)

    @classmethod
    def _read_array(
        cls, name: str, node: Node, names: tuple[str, ...], sizes: dict[str, int]
    ) -> Array:
        """Return an array of a document and note the lengths of its axes in `sizes`.

        Parameters
        ----------
        name : str
            Its name.
        node : Node
            Its values.
        names : tuple of str
            Its axes; none for a single number.
        sizes : dict of str to int
            Lengths that are known already.
        """
        if not names:
            return np.array(node.number())
        known = [
            sizes.get(axis, prod(sizes[letter] for letter in axis) if len(axis) > 1 else None)
            for axis in names
        ]
        values = node.array(*known)
        sizes.update(zip(names, values.shape, strict=True))
        return values


class Stream:
    """One pass of a recursion over samples as they come.

    Parameters
    ----------
    recursion : Recursion
        What to run.
    """

    def __init__(self, recursion: Recursion) -> None:
        self._recursion = recursion
        self._state = recursion.initial_state()

    def step(self, rise: ArrayLike) -> Array:
        """Take one sample of rises, shape (p,) [K], and return the thermal errors, shape (c,) [m].

        Raises
        ------
        ValueError
            If the sample has another length or holds NaN; the state then stays as it was.
        """
        sample = np.asarray(rise, dtype=np.float64)
        if sample.shape != (self._recursion.inputs,):
            raise ValueError(
                f'rise: expected {self._recursion.inputs} values, but found shape {sample.shape}'
            )
        # One sum is far cheaper than a test of each element; it is finite if all of them are.
        if not np.isfinite(sample.sum()):
            raise ValueError(f'rise: expected finite values, but found {sample}')
        value, self._state = self._recursion.step(sample, self._state)
        return value

    @property
    def state(self) -> Array:
        """Copy of the state, a flat array of doubles."""
        return np.array(self._state)

    @state.setter
    def state(self, values: ArrayLike) -> None:
        state = np.array(values, dtype=np.float64)
        if state.shape != self._state.shape or not np.isfinite(state).all():
            raise ValueError(
                f'state: expected {self._state.size} finite numbers, but found {state.tolist()}'
            )
        self._state = state


def clipped(values: Array, bound: Array) -> Array:
    """Return values cut at plus and minus a bound."""
    # np.clip takes four times as long on arrays as small as these.
    return np.asarray(np.minimum(np.maximum(values, -bound), bound))


def run_slices(runs: ArrayLike | None, samples: int) -> list[slice]:
    """Return the rows of each run.

    Parameters
    ----------
    runs : array_like, shape (n,), or None
        Label of the run that each sample belongs to; None is one run.
    samples : int
        Number n of samples.

    Raises
    ------
    ValueError
        If the length differs or the samples of one run do not lie together.
    """
    if runs is None:
        return [slice(0, samples)]
    labels: NDArray[np.generic] = np.asarray(runs)
    if labels.shape != (samples,):
        raise ValueError(f'runs: expected {samples} labels, but found shape {labels.shape}')
    cuts = [0, *(np.flatnonzero(labels[1:] != labels[:-1]) + 1).tolist(), samples]
    if len(cuts) - 1 != len(np.unique(labels)):
        raise ValueError('runs: expected the samples of each run together, but found them split')
    return [slice(first, last) for first, last in pairwise(cuts)]


INTERVAL_MIN, INTERVAL_MAX = 1e-3, 86400.0
"""Bounds of a sampling interval [s]: a millisecond, a day."""


def check_interval(interval: float) -> None:
    """Refuse an interval at which no machine is measured."""
    if not INTERVAL_MIN <= interval <= INTERVAL_MAX:
        raise ValueError(
            f'interval: expected from {INTERVAL_MIN:g} to {INTERVAL_MAX:g} s, but found '
            f'{interval:g}'
        )


@dataclass(frozen=True, eq=False)
class LinearRecursion(Recursion):
    """Parallel first-order lags.

    u(k) = pole u(k-1) + drive x(k),  y(k) = readout u(k) + direct x(k) + offset.

    Parameters
    ----------
    pole : ndarray, shape (q,)
        Pole of each lag, in [0, 1) [-].
    drive : ndarray, shape (q, p)
        Input of each lag per kelvin.
    readout : ndarray, shape (c, q)
        Weight of each lag in each channel.
    direct : ndarray, shape (c, p)
        Weight of each rise in each channel [m/K].
    offset : ndarray, shape (c,)
        Constant of each channel [m].
    """

    FORM: ClassVar[str] = 'linear'

    pole: Array = field(metadata=axes('q', 0.0, 1.0))
    drive: Array = field(metadata=axes('q p'))
    readout: Array = field(metadata=axes('c q'))
    direct: Array = field(metadata=axes('c p'))
    offset: Array = field(metadata=axes('c'))

    def _check(self) -> None:
        if not (self.pole < 1.0).all():
            raise ValueError(f'pole: expected poles in [0, 1), but found {self.pole}')

    def initial_state(self) -> Array:
        """Return the state at the start of a run, where every rise is zero, shape (q,)."""
        return np.zeros(len(self.pole))

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        state = self.pole * state + portable.matmul(self.drive, rise)
        return portable.matmul(self.readout, state) + portable.matmul(
            self.direct, rise
        ) + self.offset, state

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        lagged = first_order_lags(self.pole, portable.matmul(rise, self.drive.T))
        return np.asarray(
            portable.matmul(lagged, self.readout.T)
            + portable.matmul(rise, self.direct.T)
            + self.offset
        )

    def with_interval(self, ratio: float) -> 'LinearRecursion':
        """Return the recursion for an interval `ratio` times as long."""
        pole = portable.power(self.pole, ratio)
        gain = (1.0 - pole) / (1.0 - self.pole)
        return replace(self, pole=pole, drive=self.drive * gain[:, np.newaxis])

    def channel(self, channel: int) -> 'LinearRecursion':
        """Return the recursion of one channel, without the lags that it does not read."""
        one = slice(channel, channel + 1)
        used = self.readout[channel] != 0.0
        return LinearRecursion(
            pole=self.pole[used],
            drive=self.drive[used],
            readout=self.readout[one, used],
            direct=self.direct[one],
            offset=self.offset[one],
        )

    @staticmethod
    def of_nothing(channels: int, inputs: int) -> 'LinearRecursion':
        """Return the recursion that predicts no error from any input."""
        return LinearRecursion(
            pole=np.empty(0),
            drive=np.empty((0, inputs)),
            readout=np.empty((channels, 0)),
            direct=np.zeros((channels, inputs)),
            offset=np.zeros(channels),
        )

    @classmethod
    def merge(cls, items: Sequence['LinearRecursion']) -> 'LinearRecursion':
        """Return one recursion for all channels; the same lags of the same inputs are shared."""
        direct = np.concatenate([item.direct for item in items])
        offset = np.concatenate([item.offset for item in items])
        first = items[0]
        if all(
            np.array_equal(item.pole, first.pole) and np.array_equal(item.drive, first.drive)
            for item in items
        ):
            readout = np.concatenate([item.readout for item in items])
            return LinearRecursion(first.pole, first.drive, readout, direct, offset)
        # Here, since nodes without a model do without: they start sooner.
        from scipy.linalg import block_diag

        return LinearRecursion(
            pole=np.concatenate([item.pole for item in items]),
            drive=np.concatenate([item.drive for item in items]),
            readout=block_diag(*[item.readout for item in items]),
            direct=direct,
            offset=offset,
        )


def first_order_lags(pole: Array, drive: Array) -> Array:
    """Return u(k) = pole u(k-1) + drive(k) from u(0) = 0.

    Parameters
    ----------
    pole : ndarray, broadcast over the trailing axes of `drive`
        Poles [-].
    drive : ndarray, shape (n, ...)
        Inputs by rows.

    Returns
    -------
    ndarray, shape of `pole` and `drive` broadcast
        Lagged values in the units of `drive`.
    """
    shape = np.broadcast_shapes(np.shape(pole), drive.shape[1:])
    lagged = np.empty((len(drive), *shape))
    state = np.zeros(shape)
    for k, sample in enumerate(drive):
        state = pole * state + sample
        lagged[k] = state
    return lagged


FORMS: Mapping[str, str] = MappingProxyType(
    {
        'linear': 'base.LinearRecursion',
        'grey': 'grey.GreyRecursion',
        'series': 'base.SeriesRecursion',
        'corrected': 'rules.CorrectedRecursion',
        'rules': 'rules.RulesRecursion',
        'filter_network': 'filters.FilterNetworkRecursion',
        'bounded': 'base.BoundedRecursion',
        'parallel': 'base.ParallelRecursion',
    }
)
"""All forms that a model file may hold, and their classes; one is imported when a file has it."""

DEPTH_MAX = 16
"""Deepest level of a model file on which a recursion may stand; those of training reach 8."""


@dataclass(frozen=True, eq=False)
class ParallelRecursion(Recursion):
    """Several recursions of the same inputs.

    Parameters
    ----------
    parts : tuple of Recursion
        Recursions of one or more channels each.
    order : ndarray, shape (c,)
        Where each channel stands when the channels of the parts are lined up.
    """

    FORM: ClassVar[str] = 'parallel'

    parts: tuple[Recursion, ...]
    order: NDArray[np.int64]

    def __post_init__(self) -> None:
        """Refuse parts of different inputs and an order that is none."""
        if not self.parts or len({part.inputs for part in self.parts}) > 1:
            raise ValueError('parts: expected recursions of the same inputs, but found others')
        channels = sum(part.channels for part in self.parts)
        if sorted(self.order.tolist()) != list(range(channels)):
            raise ValueError(
                f'order: expected each of {channels} channels once, but found {self.order}'
            )

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return self.parts[0].inputs

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return len(self.order)

    @cached_property
    def _cuts(self) -> list[slice]:
        """Return the slice of the state that belongs to each part."""
        ends = np.cumsum([len(part.initial_state()) for part in self.parts])
        starts = np.concatenate([[0], ends[:-1]])
        return [slice(first, last) for first, last in zip(starts, ends, strict=True)]

    def initial_state(self) -> Array:
        """Return the states of all parts, one after the other."""
        return np.concatenate([part.initial_state() for part in self.parts])

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        values, states = [], []
        for part, cut in zip(self.parts, self._cuts, strict=True):
            value, after = part.step(rise, state[cut])
            values.append(value)
            states.append(after)
        return np.concatenate(values)[self.order], np.concatenate(states)

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        return np.concatenate([part.run(rise) for part in self.parts], axis=1)[:, self.order]

    def with_interval(self, ratio: float) -> 'ParallelRecursion':
        """Return the recursions for an interval `ratio` times as long."""
        return ParallelRecursion(
            tuple(part.with_interval(ratio) for part in self.parts), self.order
        )

    def channel(self, channel: int) -> Recursion:  # type: ignore[override]
        """Return the recursion of one channel, in its own form."""
        wanted = int(self.order[channel])
        for part in self.parts:
            if wanted < part.channels:
                return part.channel(wanted)
            wanted -= part.channels
        raise IndexError(channel)

    def document(self) -> dict[str, Any]:
        """Return the parts as JSON values."""
        return {
            'order': self.order.tolist(),
            'parts': [write_recursion(part) for part in self.parts],
        }

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'ParallelRecursion':
        """Return the recursions of a document."""
        parts = []
        for item in node.get('parts').list():
            if item.get('form').value == cls.FORM:
                item.refuse('a single recursion')
            parts.append(read_recursion(item, inputs))
        order = node.get('order').vector()
        if (order != np.rint(order)).any():
            node.get('order').refuse('whole numbers')
        return cls(tuple(parts), order.astype(np.int64))


def combine(recursions: Sequence[Recursion]) -> Recursion:
    """Return one recursion whose channels are those of `recursions`, which share their inputs.

    Parameters
    ----------
    recursions : sequence of Recursion
        Recursions of one or more channels each.

    Returns
    -------
    Recursion
        Of their own form where they have one and it can hold all, else of several side by side.

    Raises
    ------
    ValueError
        If there is none, or their inputs differ.
    """
    if not recursions:
        raise ValueError('recursions: expected at least one, but found none')
    recursions = [
        part
        for item in recursions
        for part in (
            map(item.channel, range(item.channels))
            if isinstance(item, ParallelRecursion)
            else (item,)
        )
    ]
    groups: dict[type[Recursion], list[int]] = {}
    for number, item in enumerate(recursions):
        groups.setdefault(type(item), []).append(number)
    parts: list[Recursion] = []
    lined_up: list[int] = []
    for form, numbers in groups.items():
        items = [recursions[number] for number in numbers]
        merged = items[0] if len(items) == 1 else form.merge(items)
        parts.extend(items if merged is None else [merged])
        lined_up.extend(numbers)
    starts = np.cumsum([0, *(item.channels for item in recursions)])
    # Position of each channel of `recursions` once the groups are lined up.
    channel = np.concatenate([np.arange(starts[n], starts[n + 1]) for n in lined_up])
    order = np.argsort(channel, kind='stable')
    if len(parts) == 1 and np.array_equal(order, np.arange(len(order))):
        return parts[0]
    return ParallelRecursion(tuple(parts), order)


def write_recursion(recursion: Recursion) -> dict[str, Any]:
    """Return a recursion as JSON values, with its form."""
    return {'form': recursion.FORM, **recursion.document()}


def read_recursion(node: Node, inputs: int) -> Recursion:
    """Return the recursion of a document.

    Parameters
    ----------
    node : Node
        What `write_recursion` returned.
    inputs : int
        Number of inputs that it must have.

    Raises
    ------
    ModelFileError
        If the form is unknown or a value is missing, of another type or shape.
    """
    if node.depth > DEPTH_MAX:
        node.refuse(f'at most {DEPTH_MAX} levels')
    name = node.get('form').text()
    if name not in FORMS:
        node.get('form').refuse(f'one of {", ".join(FORMS)}')
    module, _, kind = FORMS[name].rpartition('.')
    form: type[Recursion] = getattr(import_module(f'{__package__}.{module}'), kind)
    with node.named():
        return form.read(node, inputs)


@dataclass(frozen=True, eq=False)
class SeriesRecursion(Recursion):
    """A bank of lags, or a choice of inputs, in front of a model.

    Parameters
    ----------
    bank : LinearRecursion
        Its outputs are the inputs of the model.
    model : Recursion
        Any form but this one.
    """

    FORM: ClassVar[str] = 'series'

    bank: LinearRecursion
    model: Recursion

    def __post_init__(self) -> None:
        """Refuse parts that do not fit together."""
        if self.model.inputs != self.bank.channels:
            raise ValueError(
                f'model: expected {self.bank.channels} inputs, as many as the bank has outputs, '
                f'but found {self.model.inputs}'
            )

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return self.bank.inputs

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return self.model.channels

    def initial_state(self) -> Array:
        """Return the states of the bank and the model, one after the other."""
        return np.concatenate([self.bank.initial_state(), self.model.initial_state()])

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of inputs (p,)."""
        cut = len(self.bank.pole)
        made, before = self.bank.step(rise, state[:cut])
        value, after = self.model.step(made, state[cut:])
        return value, np.concatenate([before, after])

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of inputs (n, p)."""
        return self.model.run(self.bank.run(rise))

    def with_interval(self, ratio: float) -> 'SeriesRecursion':
        """Return the recursion for an interval `ratio` times as long."""
        return SeriesRecursion(self.bank.with_interval(ratio), self.model.with_interval(ratio))

    def channel(self, channel: int) -> 'SeriesRecursion':
        """Return the recursion of one channel out of several."""
        return SeriesRecursion(self.bank, self.model.channel(channel))

    @classmethod
    def merge(cls, items: Sequence['SeriesRecursion']) -> 'SeriesRecursion | None':
        """Return one recursion for all channels if they share a bank."""
        bank = items[0].bank
        if any(item.bank.document() != bank.document() for item in items[1:]):
            return None
        return cls(bank, combine([item.model for item in items]))

    def document(self) -> dict[str, Any]:
        """Return the parts as JSON values."""
        return {'bank': self.bank.document(), 'model': write_recursion(self.model)}

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'SeriesRecursion':
        """Return the recursion of a document."""
        bank = LinearRecursion.read(node.get('bank'), inputs)
        model = node.get('model')
        if model.get('form').value == cls.FORM:
            model.refuse('a recursion that is no series')
        return cls(bank, read_recursion(model, bank.channels))


BOUND_FACTOR = 1.5
"""Bound of the output as a multiple of the largest deformation measured in training [-]."""


BOUND_MIN = 1e-9
"""Smallest bound on the deformation of a channel [m]: that of one that never moved."""


BOUND_MAX = 1.0
"""Largest bound of an output [m]: no machine grows so much."""


@dataclass(frozen=True, eq=False)
class BoundedRecursion(Recursion):
    """A recursion whose output is cut at a bound.

    What feeds back inside the base is not cut: the bound changes what is published, never what
    the model believes, and lets go as soon as the base returns.

    Parameters
    ----------
    base : Recursion
        What is bounded; not itself bounded.
    bound : ndarray, shape (c,)
        Largest absolute output of each channel, positive [m].
    """

    FORM: ClassVar[str] = 'bounded'

    base: Recursion = field(metadata=part('bounded', but='a recursion that is not bounded'))
    bound: Array = field(metadata=axes('c', BOUND_MIN, BOUND_MAX))

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        value, state = self.base.step(rise, state)
        return clipped(value, self.bound), state

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        return clipped(self.base.run(rise), self.bound)


def bound_of(displacement: Array) -> Array:
    """Return the bound of each channel, (c,) [m]: 1.5 times the largest measured in training.

    Parameters
    ----------
    displacement : ndarray, shape (n, c)
        Deformation measured in training, NaN where it was not [m]; each channel at least once.
    """
    return np.asarray(BOUND_FACTOR * np.fmax(np.nanmax(np.abs(displacement), axis=0), BOUND_MIN))
