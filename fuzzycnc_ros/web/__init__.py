# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What browsers get: the plots of uPlot (vendor/uplot, MIT) and pages of the live graph."""
