# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Methods as they were published, and the rivals that ours are compared with.

They fit and predict.  No model file holds them, and no machine is run by them.
"""
