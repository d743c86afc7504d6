# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a person sees of a machine, put together from what its nodes say."""
