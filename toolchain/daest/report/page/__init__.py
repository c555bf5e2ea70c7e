"""The report: one HTML page of what stands in `results/`."""
