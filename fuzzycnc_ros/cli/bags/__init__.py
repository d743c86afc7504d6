# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on recordings: record, replay, info, import-csv."""
