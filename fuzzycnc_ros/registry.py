# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""All components by node name, in the order of their turns."""

from typing import Any

from fuzzycnc_ros.adapters.linuxcnc.linuxcnc_bridge import LinuxcncBridge
from fuzzycnc_ros.adapters.opcua.opcua_bridge import OpcuaBridge
from fuzzycnc_ros.components.machine.simulated_body import SimulatedBody
from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachine
from fuzzycnc_ros.components.motion.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.components.motion.joint_trajectory_bridge import JointTrajectoryBridge
from fuzzycnc_ros.components.probing.probe_cycle import ProbeCycle
from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.components.soft.deformation_compensator import DeformationCompensator
from fuzzycnc_ros.components.thermal.compensator import Compensator
from fuzzycnc_ros.components.thermal.sensor_selector import SensorSelector
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisition
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.runtime.component import Component

MACHINES = (SimulatedMachine.NAME, LinuxcncBridge.NAME, OpcuaBridge.NAME, SimulatedBody.NAME)
"""Nodes in a machine's place, the last one beside a bridge; no recording gives them back."""

COMPONENTS: dict[str, type[Component[Any]]] = {
    item.NAME: item
    for item in (
        SimulatedMachine,
        LinuxcncBridge,
        OpcuaBridge,
        SimulatedBody,
        TemperatureAcquisition,
        ProbeCycle,
        SensorSelector,
        ThermalPredictor,
        Compensator,
        DeformationCompensator,
        FeedrateScheduler,
        JointTrajectoryBridge,
        ServoController,
    )
}
