"""The report of a fit: figures, tables and the page. It draws results and computes none."""

from .page import render, write_report

__all__ = ["render", "write_report"]
