"""Results of a run: report, summary, export, tables."""
