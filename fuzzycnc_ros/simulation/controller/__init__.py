# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A controller of the kind of LinuxCNC: path modes, blends, and the motion that it makes."""
