"""Controllers, built from a vessel model or an identified state-space model."""
