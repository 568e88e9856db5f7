"""The report of a fit: figures, tables and the page. It draws results and computes none."""

from .page import write_report
