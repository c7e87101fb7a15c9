"""What is made of a run: report, summary, export, tables."""
