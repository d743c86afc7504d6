# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of all pages: tables, sections, drawings, templates.

matplotlib and jinja2 are loaded when a plot or a page is asked for, rich when a table is printed.
"""
