# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `compensator`: the only source of offsets, as a managed lifecycle node.

Deactivation takes effect at once as a state, while the offsets go to zero at the ramp rate; the
node goes on publishing until they are there.  Should it be killed meanwhile, the machine side
lets its last command expire.
"""

from fuzzycnc_ros.components.thermal.compensator import Compensator
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.lifecycle import ManagedComponentNode


def make() -> ManagedComponentNode:
    """Create the node."""
    return ManagedComponentNode(Compensator)


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
