# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on thermal models: train, evaluate, compare, curve, simulate."""
