"""What a trial stores: metrics, coefficients, findings and time series, with units."""
