"""What a trial stores: metrics, coefficients, diagnostics and time series, with units."""
