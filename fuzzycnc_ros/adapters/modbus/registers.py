# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values in Modbus registers: which registers to ask for together, and what they mean."""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

from fuzzycnc_ros.adapters.modbus.devices import FORMATS, ORDERS, Register
from fuzzycnc_ros.adapters.readings.devices import SPINDLE
from fuzzycnc_ros.adapters.readings.plausible_value import no_temperature, scaled

REGISTERS_MAX = 125
"""Most registers that one request may ask for, as the Modbus specification lays down."""


@dataclass(frozen=True)
class RegisterBlock:
    """Registers that are asked for in one request, and the channels that lie in them."""

    table: str
    register: int
    count: int
    channels: tuple[int, ...]


def blocks(registers: Sequence[Register]) -> list[RegisterBlock]:
    """Return as few requests as cover all values.

    Only registers that touch are asked for together: many devices refuse a request with a gap
    of registers that they do not have.
    """
    order = sorted(
        range(len(registers)), key=lambda i: (registers[i].table, registers[i].register)
    )
    found: list[RegisterBlock] = []
    for index in order:
        item = registers[index]
        last = found[-1] if found else None
        if last is not None and last.table == item.table:
            end = max(last.register + last.count, item.register + item.count)
            touches = item.register <= last.register + last.count
            if touches and end - last.register <= REGISTERS_MAX:
                channels = (*last.channels, index)
                found[-1] = RegisterBlock(last.table, last.register, end - last.register, channels)
                continue
        found.append(RegisterBlock(item.table, item.register, item.count, (index,)))
    return found


def single_blocks(block: RegisterBlock, registers: Sequence[Register]) -> list[RegisterBlock]:
    """Return one request for each value of a block."""
    return [
        RegisterBlock(block.table, registers[i].register, registers[i].count, (i,))
        for i in block.channels
    ]


def value_of(item: Register, words: Sequence[int]) -> float | str:
    """Return the quantity in the registers of a value, or why there is none.

    What no sensor reads is no temperature: most often its words, or bytes, are in another order.

    Parameters
    ----------
    item : Register
        What the registers mean.
    words : sequence of int
        As many registers as the value has, each from 0 to 65535.

    Examples
    --------
    >>> rtd = Register(name='T1', table='input', register=0, type='int16', scale=0.1)
    >>> value_of(rtd, [215])
    21.5
    """
    raw = raw_of(item, words)
    # A code may be written signed or not: 0x8000 and -32768 are the same bits.
    modulus = 2 ** (16 * item.count)
    for code in item.open_circuit:
        same = raw == code if isinstance(raw, float) else (raw - code) % modulus == 0
        if same:
            return f'open circuit (raw value {raw})'
    value = scaled(item, raw)
    if item.name == SPINDLE or not (trouble := no_temperature(raw, value)):
        return value
    return f'{trouble}; {suspects(item, words)}'


def raw_of(item: Register, words: Sequence[int]) -> int | float:
    """Return the raw value in the registers of a value."""
    if item.word_order == 'little':
        words = tuple(reversed(words))
    packed = b''.join(word.to_bytes(2, item.byte_order) for word in words)  # type: ignore[arg-type]
    (raw,) = struct.unpack(f'>{FORMATS[item.type]}', packed)
    return float(raw) if item.type.startswith('float') else int(raw)


def suspects(item: Register, words: Sequence[int]) -> str:
    """Return what may be wrong in the device file, and what other orders would give."""
    others = []
    for other in _other_orders(item):
        value = scaled(item, raw_of(other, words))
        changed = [
            f'{name} {getattr(other, name)}'
            for name in ('word_order', 'byte_order')
            if getattr(other, name) != getattr(item, name)
        ]
        told = f'{value:.5g}' if isinstance(value, float) else 'nothing'
        others.append(f'{told} with {" and ".join(changed)}')
    orders = 'word_order, byte_order' if item.count > 1 else 'byte_order'
    return (
        f'compare {orders}, type and register with its manual (addresses count from 0); it would '
        f'read {", ".join(others)}'
    )


def jump(item: Register, course: Sequence[Sequence[int]]) -> float:
    """Return by how much readings jump [K] that are steady in another order; 0 if none are.

    Parameters
    ----------
    item : Register
        What the registers mean.
    course : sequence of sequence of int
        The registers in some readings, each other than the last.

    Examples
    --------
    >>> rtd = Register(name='T1', table='input', register=0, type='int16', scale=0.1)
    >>> round(jump(rtd, [[0xEB00], [0xEC00], [0xED00], [0xEC00]]), 3)  # 23.5, 23.6, 23.7, 23.6
    25.6
    """
    if item.ntc is not None:
        return 0.0

    def step(one: Register) -> float:
        raw = [raw_of(one, words) for words in course]
        return abs(item.scale) * sum(abs(b - a) for a, b in pairwise(raw)) / (len(raw) - 1)

    found = step(item)
    if found < JUMP or not any(STEADIER * step(other) < found for other in _other_orders(item)):
        return 0.0
    return found


def lies_at_zero(item: Register, course: Sequence[Sequence[int]]) -> bool:
    """Return whether all readings are next to 0 degC that another order finds in a shop.

    Parameters
    ----------
    item : Register
        What the registers mean.
    course : sequence of sequence of int
        The registers in some readings, each other than the last.

    Examples
    --------
    >>> front = Register(name='T1', table='input', register=0, type='float32')
    >>> lies_at_zero(front, [[0xBC41, 0x0000], [0xBC41, 0x295C]])  # 23.5, 23.52
    True
    """

    def within(one: Register, low: float, high: float) -> bool:
        return all(low < one.scale * raw_of(one, words) + one.offset < high for words in course)

    return within(item, -AT_ZERO, AT_ZERO) and any(
        within(other, *OF_A_SHOP) for other in _other_orders(item)
    )


def _other_orders(item: Register) -> Iterator[Register]:
    """Return what the registers would mean in other orders of words and bytes."""
    of_words = ORDERS if item.count > 1 else (item.word_order,)
    for word_order, byte_order in product(of_words, ORDERS):
        if (word_order, byte_order) != (item.word_order, item.byte_order):
            yield replace(item, word_order=word_order, byte_order=byte_order)


JUMP, STEADIER = 8.0, 16.0
"""Mean step between readings from which their order is doubted [K], and how much smaller it is in
the right one [-]; to swap the bytes makes it 256 times as large."""

AT_ZERO = 1.0
OF_A_SHOP = (5.0, 60.0)
"""Temperatures that bytes of 23 to 24 degC give in a wrong order, and those of machines [degC]."""
