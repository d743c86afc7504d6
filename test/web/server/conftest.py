# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of tests on the page's server."""

from served_page import page, refusing, serve

__all__ = ['page', 'refusing', 'serve']
