# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Readings that temperature_acquisition sustains from Modbus TCP devices and OPC UA servers.

Servers, node and listener are processes of their own on this host.  Each case is a node that reads
one device: the sets that arrive on `sensor_readings` are counted, with the longest time between
two and the share of a core that the node takes.  Wanted are 76 sensors at 1 Hz and 10 at 100 Hz,
without a set that lacks a value.  Run with `python benchmarks/bench_sources.py [SECONDS]`.
"""

import asyncio
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

LOCAL = '127.0.0.1'
SENSORS = 76
CASES = (
    ('modbus_tcp', 76, 1.0),
    ('opc_ua', 76, 1.0),
    ('modbus_tcp', 10, 100.0),
    ('opc_ua', 10, 100.0),
)
SUSTAINED = 0.98
"""Least share of the wanted sets."""


async def serve(pipe: Connection) -> None:
    """Run both servers and tell their ports, for ever."""
    from asyncua import Server, ua
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    words = [SimData(0, count=SENSORS, values=215, datatype=DataType.REGISTERS)]
    bits = [SimData(0, count=8, values=False, datatype=DataType.BITS)]
    device = SimDevice(1, simdata=(bits, bits, words, words))
    modbus = ModbusTcpServer(device, address=(LOCAL, 0))
    await modbus.serve_forever(background=True)
    server = Server()
    await server.init()
    server.set_endpoint(f'opc.tcp://{LOCAL}:0/')
    index = await server.register_namespace('urn:fuzzycnc:benchmark')
    for place in range(SENSORS):
        node = ua.NodeId(f'T{place}', index)
        await server.nodes.objects.add_variable(node, f'{index}:T{place}', 21.5)
    await server.start()
    ports = {
        'modbus_tcp': modbus.transport.sockets[0].getsockname()[1],
        'opc_ua': server.bserver._server.sockets[0].getsockname()[1],
    }
    pipe.send((ports, index))
    await asyncio.Event().wait()


def run_servers(pipe: Connection) -> None:
    """Run the servers in this process."""
    asyncio.run(serve(pipe))


def device_file(
    folder: Path, protocol: str, count: int, rate: float, port: int, index: int
) -> str:
    """Write the file of a case; return its name."""
    modbus = protocol == 'modbus_tcp'
    where = f'host: {LOCAL}, port: {port}' if modbus else f'url: "opc.tcp://{LOCAL}:{port}/"'
    place = '{0}' if modbus else f'ns={index};s=T{{0}}'
    sensors = ', '.join(f'T{k}: {place.format(k)}' for k in range(count))
    path = folder / 'devices.yaml'
    path.write_text(
        f'devices:\n  - {{name: bench, protocol: {protocol}, {where}, period: {1.0 / rate}, '
        f'sensors: {{{sensors}}}}}\n'
    )
    return str(path)


def measure(
    folder: Path, file: str, rate: float, seconds: float
) -> tuple[float, float, float, int]:
    """Return sets per second, longest gap [s], share of a core, and sets that lack a value."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    from fuzzycnc_ros.cli.live.graph_processes import parameter_file, ros_arguments
    from fuzzycnc_ros.graph.bring_up import NodeSpec
    from fuzzycnc_ros.ros.processes import processor_time
    from fuzzycnc_ros.ros.topics import message_class, subscription_qos
    from fuzzycnc_ros.runtime.component import STREAM
    from fuzzycnc_ros.runtime.convert import decode
    from fuzzycnc_ros.runtime.records import SECOND, Temperatures

    spec = NodeSpec('temperature_acquisition', {'source': 'devices', 'device_file': file})
    arguments = ros_arguments('/bench', [parameter_file(folder, '/bench', [spec])])
    command = [sys.executable, '-m', 'fuzzycnc_ros.nodes.temperature_acquisition', *arguments]
    rclpy.init()
    node = rclpy.create_node('listener', namespace='/bench')
    heard: list[Temperatures] = []
    node.create_subscription(
        message_class(Temperatures.TYPE),
        'sensor_readings',
        lambda message: heard.append(decode(Temperatures, message)),
        subscription_qos(STREAM, lockstep=True),
    )
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    started = subprocess.Popen(command)
    try:
        while len(heard) < 2:
            executor.spin_once(timeout_sec=1.0)
            if started.poll() is not None:
                raise RuntimeError(f'the node ended with code {started.returncode}')
        heard.clear()
        taken, begin = processor_time(started.pid), time.monotonic()
        while time.monotonic() - begin < seconds:
            executor.spin_once(timeout_sec=0.1)
        taken, lasted = processor_time(started.pid) - taken, time.monotonic() - begin
    finally:
        started.send_signal(signal.SIGINT)
        started.wait(20.0)
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
    stamps = np.array([item.stamp for item in heard])
    lacking = sum(not np.isfinite(item.temperature).all() for item in heard)
    gap = float(np.diff(stamps).max()) / SECOND
    return len(heard) / lasted, gap, taken / lasted, lacking


def main() -> int:
    """Print all cases; fail if one is not sustained."""
    from fuzzycnc_ros.ros.processes import prepare_environment

    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    prepare_environment()
    here, there = multiprocessing.Pipe()
    servers = multiprocessing.get_context('spawn').Process(
        target=run_servers, args=(there,), daemon=True
    )
    servers.start()
    failed = 0
    try:
        ports, index = here.recv()
        print(f'load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors')
        with tempfile.TemporaryDirectory() as name:
            for protocol, count, rate in CASES:
                folder = Path(name)
                file = device_file(folder, protocol, count, rate, ports[protocol], index)
                found, gap, share, lacking = measure(folder, file, rate, seconds)
                sustained = found >= SUSTAINED * rate - 1.0 / seconds and lacking == 0
                failed += not sustained
                print(
                    f'{protocol:10} {count:3} sensors at {rate:5.0f} Hz: {found:6.1f} sets/s, '
                    f'longest gap {1e3 * gap:6.0f} ms, {100.0 * share:4.0f} % of a core, '
                    f'{lacking} sets lack a value{"" if sustained else "  NOT SUSTAINED"}'
                )
    finally:
        servers.terminate()
        servers.join()
    return int(failed > 0)


if __name__ == '__main__':
    sys.exit(main())
