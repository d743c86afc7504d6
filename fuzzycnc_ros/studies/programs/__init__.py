# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Part programs: scheduled, judged on a controller, and what to set for a tolerance."""
