"""Physics and mathematics of marine vessels: no configuration, no database, no plots."""
