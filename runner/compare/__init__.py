"""Comparison of stored runs: tables, figures and SQL, from the results database alone."""
