# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Entry point of `python test/qualification`."""

from commands import APPLICATION

APPLICATION.main()
