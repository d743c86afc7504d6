# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of all pages: tables, sections, charts, templates.

jinja2 is loaded when a page is asked for, matplotlib for a PDF, rich when a table is printed.
"""
