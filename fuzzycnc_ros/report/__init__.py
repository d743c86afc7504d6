# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reports: tables, plots and one self-contained HTML page for a compensation run.

matplotlib and jinja2 are loaded when a plot or a page is asked for, rich when a table is printed.
"""

from fuzzycnc_ros.report.contouring import contouring_page, contouring_table
from fuzzycnc_ros.report.model import (
    CompensationRun,
    Latency,
    ReportData,
    ReportDataError,
    Score,
    SensorCountCurve,
)
from fuzzycnc_ros.report.page import render_html
from fuzzycnc_ros.report.sections import render_page
from fuzzycnc_ros.report.summary import candidate_label, summary_document, summary_table
from fuzzycnc_ros.report.table import Column, Table

__all__ = [
    'Column',
    'CompensationRun',
    'Latency',
    'ReportData',
    'ReportDataError',
    'Score',
    'SensorCountCurve',
    'Table',
    'candidate_label',
    'contouring_page',
    'contouring_table',
    'render_html',
    'render_page',
    'summary_document',
    'summary_table',
]
