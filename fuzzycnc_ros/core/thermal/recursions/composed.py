# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recursions made of others: side by side for some channels each, in a row, bounded."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, check_shapes, clipped
from fuzzycnc_ros.core.thermal.recursions.linear import LinearRecursion

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
        """Where the state of each part lies."""
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

    def standard_deviation(self, rise: Array) -> Array:
        """Return what each part says of its channels, shape (..., c) [m]; NaN where nothing."""
        said = [part.standard_deviation(rise) for part in self.parts]
        return np.asarray(np.concatenate(said, axis=-1)[..., self.order])

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
    order = np.argsort(channel)
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
    # The forms import this module's neighbours; a table made here needs no order of loading.
    from fuzzycnc_ros.core.thermal.recursions import FORMS

    if node.depth > DEPTH_MAX:
        node.refuse(f'at most {DEPTH_MAX} levels')
    forms = {form.FORM: form for form in FORMS}
    name = node.get('form').text()
    if name not in forms:
        node.get('form').refuse(f'one of {", ".join(forms)}')
    return forms[name].read(node, inputs)


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

    def standard_deviation(self, rise: Array) -> Array:
        """Return what the model says of its deviation, NaN behind lags, shape (..., c) [m]."""
        if len(self.bank.pole):
            return super().standard_deviation(rise)
        return self.model.standard_deviation(rise @ self.bank.direct.T + self.bank.offset)

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


def leading(recursion: Recursion, inputs: int) -> Recursion:
    """Return a recursion that reads the first of `inputs` inputs and ignores the others."""
    ignored = inputs - recursion.inputs
    if not ignored:
        return recursion
    if isinstance(recursion, LinearRecursion):
        return replace(
            recursion,
            drive=np.pad(recursion.drive, ((0, 0), (0, ignored))),
            direct=np.pad(recursion.direct, ((0, 0), (0, ignored))),
        )
    bank = LinearRecursion(
        pole=np.empty(0),
        drive=np.empty((0, inputs)),
        readout=np.empty((recursion.inputs, 0)),
        direct=np.eye(recursion.inputs, inputs),
        offset=np.zeros(recursion.inputs),
    )
    return SeriesRecursion(bank, recursion)


BOUND_FACTOR = 1.5
"""Bound of the output as a multiple of the largest deformation measured in training [-]."""


BOUND_MIN = 1e-9
"""What counts as the largest deformation of a channel that never moved [m]."""


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

    base: Recursion
    bound: Array

    def __post_init__(self) -> None:
        """Refuse bounds that are not one positive number per channel."""
        check_shapes(self, bound=(self.base.channels,))
        if not (self.bound > 0.0).all():
            raise ValueError(f'bound: expected positive numbers, but found {self.bound}')

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return self.base.inputs

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return self.base.channels

    def initial_state(self) -> Array:
        """Return the state of the base."""
        return self.base.initial_state()

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        value, state = self.base.step(rise, state)
        return clipped(value, self.bound), state

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        return clipped(self.base.run(rise), self.bound)

    def standard_deviation(self, rise: Array) -> Array:
        """Return what the base says of its deviation, shape (..., c) [m]."""
        return self.base.standard_deviation(rise)

    def with_interval(self, ratio: float) -> 'BoundedRecursion':
        """Return the recursion for an interval `ratio` times as long."""
        return BoundedRecursion(self.base.with_interval(ratio), self.bound)

    def channel(self, channel: int) -> 'BoundedRecursion':
        """Return the recursion of one channel out of several."""
        return BoundedRecursion(self.base.channel(channel), self.bound[channel : channel + 1])

    @classmethod
    def merge(cls, items: Sequence['BoundedRecursion']) -> 'BoundedRecursion':
        """Return one recursion for all channels."""
        return BoundedRecursion(
            combine([item.base for item in items]), np.concatenate([item.bound for item in items])
        )

    def document(self) -> dict[str, Any]:
        """Return base and bounds as JSON values."""
        return {'base': write_recursion(self.base), 'bound': self.bound.tolist()}

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'BoundedRecursion':
        """Return the recursion of a document."""
        base = node.get('base')
        if base.get('form').value == cls.FORM:
            base.refuse('a recursion that is not bounded')
        return cls(read_recursion(base, inputs), node.get('bound').vector())


def bound_of(displacement: Array) -> Array:
    """Return the bound of each channel, (c,) [m]: 1.5 times the largest measured in training.

    Parameters
    ----------
    displacement : ndarray, shape (n, c)
        Deformation measured in training, NaN where it was not [m]; each channel at least once.
    """
    return np.asarray(BOUND_FACTOR * np.fmax(np.nanmax(np.abs(displacement), axis=0), BOUND_MIN))
