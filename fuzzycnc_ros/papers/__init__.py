# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Methods as they were published, and the rivals that ours are compared with.

The thermal ones fit and predict; no model file holds them, and no machine is run by them.  The
feed schedulers can be chosen at their node, to be compared on a machine.
"""
