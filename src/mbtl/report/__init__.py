"""Report: a study's numbers as a frozen record, and text and pages drawn from that record."""

from mbtl.report.html import page, write_page
from mbtl.report.reference import REFERENCE_NAMES, ReferenceCurves, reference_curves
from mbtl.report.subject import Subject, of_study
from mbtl.report.summary import StudySummary, summarise_study

__all__ = [
    "REFERENCE_NAMES",
    "ReferenceCurves",
    "StudySummary",
    "Subject",
    "of_study",
    "page",
    "reference_curves",
    "summarise_study",
    "write_page",
]
