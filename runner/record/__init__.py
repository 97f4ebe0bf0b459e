"""What is recorded of a trial: names, the catalogue of metrics, rows with units."""
