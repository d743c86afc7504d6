# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted models as they run: one class per form, no estimator and no training data."""
