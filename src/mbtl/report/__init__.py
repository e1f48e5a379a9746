"""Report: a study's numbers as a frozen record, and text and pages drawn from that record."""

from mbtl.report.html import page, write_page
from mbtl.report.names import REFERENCE_NAMES
from mbtl.report.reference import ReferenceCurves, reference_curves
from mbtl.report.subject import PickFacts, Subject, of_study
from mbtl.report.summary import PickSummary, StudySummary, summarise_study

__all__ = [
    "REFERENCE_NAMES",
    "PickFacts",
    "PickSummary",
    "ReferenceCurves",
    "StudySummary",
    "Subject",
    "of_study",
    "page",
    "reference_curves",
    "summarise_study",
    "write_page",
]
