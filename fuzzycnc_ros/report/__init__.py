# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reports: tables, plots and one self-contained HTML page for a compensation run.

matplotlib and jinja2 are loaded when a plot or a page is asked for, rich when a table is printed.
"""

from fuzzycnc_ros.report.model import (
    CompensationRun,
    Latency,
    ReportData,
    ReportDataError,
    Score,
    SensorCountCurve,
)
from fuzzycnc_ros.report.page import render_html
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
    'render_html',
    'summary_document',
    'summary_table',
]
