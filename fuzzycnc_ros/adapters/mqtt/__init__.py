# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A broker of MQTT: what a machine does, to it, and what sensors say, from it."""
