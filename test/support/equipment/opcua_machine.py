# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A real OPC UA server that behaves as a control: the program of the guide runs behind it."""

import asyncio
import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from asyncua import Server, ua
from benches.line_control import LineControl
from equipment.field_servers import LOCAL, NAMESPACE, new_opcua, stop_opcua

AXES = ('X', 'Z')
SCAN = 0.02
"""Time between two runs of the control's program [s]."""
TYPE = ua.VariantType
UNITS = {'offset': 1e-6, 'slope': 1e-9, 'reference_position': 1e-3, 'applied': 1e-6}
UNITS |= {'limit': 1e-6, 'position': 1e-3}
WRITTEN = ('sequence', 'heartbeat', 'valid_for', 'owner')
AXIS_WRITTEN = ('offset', 'slope', 'reference_position')
TYPES = {
    'sequence': TYPE.Int16,
    'heartbeat': TYPE.UInt16,
    'valid_for': TYPE.Float,
    'owner': TYPE.String,
    'acknowledged': TYPE.Int16,
    'on': TYPE.Boolean,
    'homed': TYPE.Boolean,
    'allowed': TYPE.Boolean,
    'running': TYPE.Boolean,
    'estop': TYPE.Boolean,
    'alive': TYPE.Boolean,
    'slew': TYPE.Double,
    'spindle_speed': TYPE.Float,
    **{f'X.{name}': TYPE.Double for name in UNITS},
    **{f'Z.{name}': TYPE.Float for name in UNITS},
    'X.slope': TYPE.Int32,
    'Z.offset': TYPE.Int32,
}
"""Variables with their types; Z has no slope."""
for _name in ('Z.slope', 'Z.reference_position'):
    del TYPES[_name]
EXTRA = {
    'text': (TYPE.String, 'a'),
    'byte': (TYPE.Byte, 0),
    'int16': (TYPE.Int16, 0),
    'int32': (TYPE.Int32, 0),
    'float': (TYPE.Float, 0.0),
    'double': (TYPE.Double, 0.0),
    'array': (TYPE.Double, [1.0, 2.0]),
    'shown': (TYPE.Double, 0.0),
    'probe_due': (TYPE.Boolean, False),
}
"""Variables that the program knows nothing of; all but `shown` can be written."""
NANO = 1e-3
"""Offset of one count of `Z.offset`, in the unit of the file."""

FILE = """\
url: opc.tcp://{host}:{port}/
timeout: {timeout}
unit: um
position_unit: mm
hand_shake:
  sequence: ns=2;s=sequence
  heartbeat: ns=2;s=heartbeat
  valid_for: ns=2;s=valid_for
  acknowledged: {{path: "0:Objects/2:Mill/2:acknowledged"}}
  owner: ns=2;s=owner
state:
  on: ns=2;s=on
  homed: ns=2;s=homed
  allowed: ns=2;s=allowed
  running: ns=2;s=running
  estop: ns=2;s=estop
  alive: ns=2;s=alive
  slew: ns=2;s=slew
  spindle_speed: {{node: ns=2;s=spindle_speed, unit: rpm}}
axes:
  X:
    offset: "nsu=urn:fuzzycnc:test;s=X.offset"
    slope: {{node: ns=2;s=X.slope, scale: 1e-9}}
    reference_position: ns=2;s=X.reference_position
    travel: [-200, 300]
    applied: ns=2;s=X.applied
    limit: ns=2;s=X.limit
    position: ns=2;s=X.position
  Z:
    offset: {{node: ns=2;s=Z.offset, scale: 0.001}}
    applied: ns=2;s=Z.applied
    limit: ns=2;s=Z.limit
"""


class ControlServer:
    """The server; stopped and started again it has a new address space and the same control.

    Parameters
    ----------
    control : LineControl
        What stands behind it.
    secure : callable, optional
        Sets up security before the start.
    """

    def __init__(
        self, control: LineControl, secure: Callable[[Server], Any] | None = None
    ) -> None:
        self.control = control
        self._secure = secure
        self.port = 0

    async def start(self) -> None:
        self.server = await new_opcua()
        self.server.set_endpoint(f'opc.tcp://{LOCAL}:{self.port}/')
        if self._secure is not None:
            await self._secure(self.server)
        index = await self.server.register_namespace(NAMESPACE)
        mill = await self.server.nodes.objects.add_object(index, 'Mill')
        self._nodes = {}
        values = {name: (kind, self._value(name)) for name, kind in TYPES.items()}
        for name, (kind, value) in {**values, **EXTRA}.items():
            node = await mill.add_variable(ua.NodeId(name, index), f'{index}:{name}', value, kind)
            if self._writes(name) or (name in EXTRA and name != 'shown'):
                await node.set_writable()
            self._nodes[name] = node
        await self.server.start()
        self.port = self.server.bserver._server.sockets[0].getsockname()[1]
        self._program = asyncio.create_task(self._run())

    async def reset(self, control: LineControl) -> None:
        """Put another control, and nothing written, behind the variables."""
        self.control = control
        for name in TYPES:
            if self._writes(name):
                await self.put(name, self._value(name))

    async def stop(self) -> None:
        self._program.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._program
        await stop_opcua(self.server)

    async def put(self, name: str, value: Any) -> None:
        """Write a variable as another client would."""
        kind = TYPES[name] if name in TYPES else EXTRA[name][0]
        await self._nodes[name].write_value(ua.Variant(value, kind))

    async def get(self, name: str) -> Any:
        """Return what stands in a variable."""
        return await self._nodes[name].read_value()

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()
        before = loop.time()
        while True:
            for name in TYPES:
                if self._writes(name):
                    self._take(name, await self._nodes[name].read_value())
            now = loop.time()
            self.control.scan(now - before)
            before = now
            for name in TYPES:
                if not self._writes(name):
                    await self.put(name, self._value(name))
            await asyncio.sleep(SCAN)

    def _writes(self, name: str) -> bool:
        return name in WRITTEN or name.partition('.')[2] in AXIS_WRITTEN

    def _unit(self, name: str) -> float:
        if name == 'Z.offset':
            return UNITS['offset'] * NANO
        return 1e-6 if name == 'slew' else UNITS.get(name.partition('.')[2], 1.0)

    def _take(self, name: str, value: Any) -> None:
        """Hand a variable that a client has written to the program."""
        axis, _, field = name.rpartition('.')
        if not axis:
            setattr(self.control, field, value)
        elif isinstance(value, (int, float)):
            column = getattr(self.control, field).copy()
            column[AXES.index(axis)] = value * self._unit(name)
            setattr(self.control, field, column)

    def _value(self, name: str) -> Any:
        axis, _, field = name.rpartition('.')
        found = getattr(self.control, field)
        if axis:
            found = found[AXES.index(axis)]
        if isinstance(found, (bool, str, np.bool_)):
            return found
        kind = TYPES[name]
        number = float(found) / self._unit(name)
        return number if kind in (TYPE.Float, TYPE.Double) else round(number)


def control_file(folder: Path, port: int, text: str = FILE, timeout: float = 30.0) -> Path:
    """Write a control file for a server; return its name."""
    path = folder / 'control.yaml'
    path.write_text(text.format(host=LOCAL, port=port, timeout=timeout))
    return path
