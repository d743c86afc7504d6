# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal error at run time: models, their files and runs; `fit` learns them."""
