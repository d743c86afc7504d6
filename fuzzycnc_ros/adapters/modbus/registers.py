# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values in Modbus registers: which registers to ask for together, and what they mean."""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from fuzzycnc_ros.adapters.readings.devices import FORMATS, Register

REGISTERS_MAX = 125
"""Most registers that one request may ask for, as the Modbus specification lays down."""


@dataclass(frozen=True)
class Block:
    """Registers that are asked for in one request, and the channels that lie in them."""

    table: str
    register: int
    count: int
    channels: tuple[int, ...]


def blocks(registers: Sequence[Register]) -> list[Block]:
    """Return as few requests as cover all values.

    Only registers that touch are asked for together: many devices refuse a request with a gap
    of registers that they do not have.
    """
    order = sorted(
        range(len(registers)), key=lambda i: (registers[i].table, registers[i].register)
    )
    found: list[Block] = []
    for index in order:
        item = registers[index]
        last = found[-1] if found else None
        if last is not None and last.table == item.table:
            end = max(last.register + last.count, item.register + item.count)
            touches = item.register <= last.register + last.count
            if touches and end - last.register <= REGISTERS_MAX:
                channels = (*last.channels, index)
                found[-1] = Block(last.table, last.register, end - last.register, channels)
                continue
        found.append(Block(item.table, item.register, item.count, (index,)))
    return found


def single_blocks(block: Block, registers: Sequence[Register]) -> list[Block]:
    """Return one request for each value of a block."""
    return [
        Block(block.table, registers[i].register, registers[i].count, (i,)) for i in block.channels
    ]


def value_of(item: Register, words: Sequence[int]) -> float | str:
    """Return the quantity in the registers of a value, or why there is none.

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
    if item.word_order == 'little':
        words = tuple(reversed(words))
    packed = b''.join(word.to_bytes(2, item.byte_order) for word in words)  # type: ignore[arg-type]
    (raw,) = struct.unpack(f'>{FORMATS[item.type]}', packed)
    # A code may be written signed or not: 0x8000 and -32768 are the same bits.
    modulus = 2 ** (16 * item.count)
    for code in item.open_circuit:
        same = raw == code if isinstance(raw, float) else (raw - code) % modulus == 0
        if same:
            return f'open circuit (raw value {raw})'
    return scaled(item.scale, item.offset, raw)


def scaled(scale: float, offset: float, raw: int | float) -> float | str:
    """Return scale * raw + offset, or why that is no temperature."""
    value = scale * raw + offset
    return value if math.isfinite(value) else f'reads {value}, expected a finite number'
