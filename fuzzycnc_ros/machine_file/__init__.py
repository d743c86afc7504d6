# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Machine files: one YAML file that says what is known of a machine."""
