# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a machine does, as messages to a broker of MQTT."""
