# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Every component at work, by name: what hostile messages are sent to."""

from benches import line_rig, linuxcnc_rig
from fuzzing.machine_targets import (
    BodyTarget,
    BridgeTarget,
    MachineTarget,
    ServoMachineTarget,
    StitchingTarget,
)
from fuzzing.motion_targets import JointTarget, SchedulerTarget, ServoTarget
from fuzzing.pattern_targets import DeformationTarget, LearntTarget
from fuzzing.probing_targets import ProbeCycleTarget
from fuzzing.targets import Target
from fuzzing.thermal_targets import (
    AcquisitionTarget,
    CompensatorTarget,
    PredictorTarget,
    ProbingTarget,
    SelectorTarget,
)

TARGETS: dict[str, Target] = {
    'compensator': CompensatorTarget(),
    'temperature_acquisition': AcquisitionTarget(),
    'sensor_selector': SelectorTarget(),
    'probe_cycle': ProbeCycleTarget(),
    'thermal_predictor': PredictorTarget(),
    'thermal_predictor that probes': ProbingTarget(),
    'feedrate_scheduler': SchedulerTarget(),
    'joint_trajectory_bridge': JointTarget(),
    'servo_controller': ServoTarget(),
    'simulated_machine': MachineTarget(),
    'simulated_machine with servo axes': ServoMachineTarget(),
    'simulated_machine that stitches': StitchingTarget(),
    'deformation_compensator': DeformationTarget(),
    'deformation_compensator with learnt offsets': LearntTarget(),
    'simulated_body': BodyTarget(),
    'linuxcnc_bridge': BridgeTarget('linuxcnc_bridge', linuxcnc_rig),
    'opcua_bridge': BridgeTarget('opcua_bridge', line_rig),
}
