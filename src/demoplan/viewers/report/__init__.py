"""A report to send: one HTML file that needs nothing else, the same bytes for the same tables."""

from demoplan.viewers.report.content import (
    Confusion,
    DomainText,
    Failure,
    Picture,
    Reference,
    RefutedPlan,
    ReportContent,
)
from demoplan.viewers.report.render import render_report

__all__ = [
    "Confusion",
    "DomainText",
    "Failure",
    "Picture",
    "Reference",
    "RefutedPlan",
    "ReportContent",
    "render_report",
]
