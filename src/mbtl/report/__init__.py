"""Report: a study's numbers as a frozen record, and text and pictures drawn from that record."""

from mbtl.report.reference import ReferenceCurves, reference_curves
from mbtl.report.summary import PickSummary, StudySummary, summarise_study

__all__ = ["PickSummary", "ReferenceCurves", "StudySummary", "reference_curves", "summarise_study"]
