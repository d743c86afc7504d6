# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Variables of an OPC UA server that are read and written by name, their types checked first."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.adapters.link import LinkError
from fuzzycnc_ros.adapters.opcua.session import (
    NODES_MAX,
    UNKNOWN_NODE,
    Address,
    OpcUaSession,
    unknown,
    value_of,
)

if TYPE_CHECKING:
    from asyncua import ua

REALS = ('Float', 'Double')
WHOLE = {
    'SByte': (8, True),
    'Byte': (8, False),
    'Int16': (16, True),
    'UInt16': (16, False),
    'Int32': (32, True),
    'UInt32': (32, False),
    'Int64': (64, True),
    'UInt64': (64, False),
}
"""Bits, and whether there is a sign."""
NUMBER_BITS = 16
"""Least size of a whole number that counts."""
NAMED_MAX = 5
"""Most variables that a message names."""
CAN_READ, CAN_WRITE = 1, 2
"""Bits of an access level."""


NOT_READABLE = ('BadNotReadable', 'BadUserAccessDenied')


class VariableType(Enum):
    """Types of the values of a variable."""

    QUANTITY = 'a number (Float, Double, or an integer with a scale)'
    COUNT = 'a whole number of 16 bits or more (Int16, UInt16, Int32, UInt32, Int64, UInt64)'
    SWITCH = 'a switch (Boolean, or an integer)'
    TEXT = 'a text (String)'


@dataclass(frozen=True, kw_only=True)
class ControlVariable(Address):
    """A variable of a control.

    Parameters
    ----------
    kind : Kind
        What it holds.
    written : bool
        Whether the bridge writes it.
    scale : float
        From its value to the SI unit; negative where the control counts the other way.
    scaled : bool
        Whether the file gives a scale, which an integer needs.
    """

    kind: VariableType
    written: bool = False
    scale: float = 1.0
    scaled: bool = False


class Variables:
    """The variables of one connection, found and checked.

    Attributes
    ----------
    steps : dict of str to float
        Smallest step of each quantity, in SI units.
    """

    def __init__(
        self,
        session: OpcUaSession,
        variables: Mapping[str, ControlVariable],
        nodes: 'Mapping[str, ua.NodeId]',
        types: 'Mapping[str, ua.VariantType]',
    ) -> None:
        self._session, self._variables = session, variables
        self._nodes, self._types = nodes, types
        self.steps = {
            name: abs(item.scale) if types[name].name in WHOLE else 0.0
            for name, item in variables.items()
            if item.kind is VariableType.QUANTITY
        }

    @classmethod
    async def find(
        cls, session: OpcUaSession, variables: Mapping[str, ControlVariable]
    ) -> 'Variables':
        """Find the variables; check types and access.

        Raises
        ------
        LinkError
            If some are not there or of no use; the text names them and the remedy.
        """
        from asyncua import ua

        names = list(variables)
        found = await session.find([variables[name] for name in names])
        nodes = {
            n: node for n, node in zip(names, found, strict=True) if not isinstance(node, str)
        }
        _refuse(
            [f'{n}: {why}' for n, why in zip(names, found, strict=True) if isinstance(why, str)]
        )
        kinds = ua.AttributeIds
        order = list(nodes.values())
        columns = [
            await _read(session, order, attribute)
            for attribute in (kinds.DataType, kinds.UserAccessLevel, kinds.Value)
        ]
        troubles, types = [], {}
        for name, data_type, access, value in zip(names, *columns, strict=True):
            item = variables[name]
            if _name_of(data_type) in UNKNOWN_NODE:
                troubles.append(f'{name}: {unknown(item, _name_of(data_type))}')
                continue
            kind = _type_of(data_type, value)
            trouble = _type_trouble(item, kind, value_of(value)) or _access_trouble(
                item, value_of(access), _name_of(value)
            )
            if trouble or kind is None:
                troubles.append(f'{name}: {item.place}: {trouble}')
            else:
                types[name] = kind
        _refuse(troubles)
        return cls(session, variables, nodes, types)

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes."""
        return -(-len(self._nodes) // NODES_MAX)

    async def read(self) -> dict[str, Any]:
        """Return the value of each variable, in SI units.

        Raises
        ------
        LinkError
            If one has none that is of use.
        """
        from asyncua import ua

        names, nodes = list(self._nodes), list(self._nodes.values())
        values = await _read(self._session, nodes, ua.AttributeIds.Value)
        found = {}
        for name, data in zip(names, values, strict=True):
            item = self._variables[name]
            status = data.StatusCode
            if status is not None and not status.is_good():
                raise LinkError(f'{name}: {item.place}: the server reports {status.name}')
            found[name] = _si(name, item, value_of(data))
        return found

    async def write(self, values: Mapping[str, Any]) -> None:
        """Write values, given in SI units, in one request.

        Raises
        ------
        LinkError
            If the server refuses one of them.
        """
        from asyncua import ua

        nodes, data = [], []
        for name, value in values.items():
            kind = self._types[name]
            raw = _raw(name, self._variables[name], kind.name, value)
            nodes.append(self._nodes[name])
            data.append(ua.DataValue(ua.Variant(raw, kind)))
        client = self._session.client.uaclient
        codes = await client.write_attributes(nodes, data, ua.AttributeIds.Value)
        for name, code in zip(values, codes, strict=True):
            if not code.is_good():
                raise LinkError(
                    f'{name}: {self._variables[name].place}: the server refuses to be written '
                    f'({code.name}); compare access rights and type'
                )


async def _read(session: OpcUaSession, nodes: Sequence[Any], attribute: Any) -> list[Any]:
    """Return an attribute of all nodes."""
    found: list[Any] = []
    client = session.client
    for start in range(0, len(nodes), NODES_MAX):
        part = [client.get_node(node) for node in nodes[start : start + NODES_MAX]]
        found += await client.read_attributes(part, attribute)
    if len(found) != len(nodes):
        raise LinkError(f'expected {len(nodes)} values but the server sent {len(found)}')
    return found


def _refuse(troubles: Sequence[str]) -> None:
    """Raise what is wrong with variables, the first of them named."""
    if troubles:
        more = len(troubles) - NAMED_MAX
        rest = [f'and {more} more'] if more > 0 else []
        raise LinkError('; '.join([*troubles[:NAMED_MAX], *rest]))


def _name_of(data: Any) -> str:
    """Return the name of the status of what a server sent."""
    return 'Good' if data.StatusCode is None else str(data.StatusCode.name)


def _type_of(data_type: Any, value: Any) -> 'ua.VariantType | None':
    """Return the type of a variable: its declared one if that is built in, else its value's."""
    from asyncua import ua

    declared = value_of(data_type)
    if declared is not None and declared.NamespaceIndex == 0:
        try:
            return ua.VariantType(declared.Identifier)
        except ValueError:
            pass  # a subtype: the value tells what is below it
    return value.Value.VariantType if value.Value is not None else None


def _type_trouble(item: ControlVariable, kind: 'ua.VariantType | None', value: Any) -> str:
    """Say why a type is of no use; empty if it fits."""
    name = kind.name if kind is not None else 'nothing'
    if isinstance(value, (list, tuple)):
        return f'expected {item.kind.value} but it holds an array; name one element'
    fits = {
        VariableType.QUANTITY: name in REALS or name in WHOLE,
        VariableType.COUNT: name in WHOLE and WHOLE[name][0] >= NUMBER_BITS,
        VariableType.SWITCH: name == 'Boolean' or name in WHOLE,
        VariableType.TEXT: name == 'String',
    }
    if not fits[item.kind]:
        return (
            f'expected {item.kind.value} but it is {name}; change its type in the control, or '
            'name another variable'
        )
    if item.kind is VariableType.QUANTITY and name in WHOLE and not item.scaled:
        return (
            f'{name} without a scale would round to whole units; give scale, the unit of one '
            'count, or use Float or Double'
        )
    return ''


def _access_trouble(item: ControlVariable, level: Any, status: str) -> str:
    """Say why a variable cannot be read or written by this user; empty if it can."""
    level = level if isinstance(level, int) else CAN_READ | CAN_WRITE  # the server does not tell
    if item.written and not level & CAN_WRITE:
        return (
            'expected a variable that this user can write but the server lets him read only; give '
            'him the right, or name another variable'
        )
    if status in NOT_READABLE or not level & CAN_READ:
        return (
            'expected a variable that this user can read but the server does not let him; give '
            'him the right, or name another variable'
        )
    return ''


def _si(name: str, item: ControlVariable, raw: Any) -> Any:
    """Return a value in its SI unit."""
    if item.kind is VariableType.TEXT:
        return '' if raw is None else str(raw)
    if not isinstance(raw, (bool, int, float)):
        raise LinkError(f'{name}: {item.place}: expected {item.kind.value} but found {raw!r}')
    if item.kind is VariableType.SWITCH:
        return bool(raw)
    if item.kind is VariableType.COUNT:
        return int(raw)
    number = item.scale * float(raw)
    if not math.isfinite(number):
        raise LinkError(f'{name}: {item.place}: expected a finite number but found {raw}')
    return number


def _raw(name: str, item: ControlVariable, kind: str, value: Any) -> Any:
    """Return what is written for a value in its SI unit."""
    if item.kind is VariableType.TEXT:
        return str(value)
    number = value if item.kind is VariableType.COUNT else value / item.scale
    if kind not in WHOLE:
        return float(number)
    bits, signed = WHOLE[kind]
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    whole = round(number)
    if not low <= whole <= high:
        raise LinkError(
            f'{name}: {item.place}: {whole} counts do not fit into {kind}; use a coarser scale or '
            'a longer type'
        )
    return whole
