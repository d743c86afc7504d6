# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What browsers get: the live page with its server, and uPlot's plots (vendor/uplot, MIT)."""
