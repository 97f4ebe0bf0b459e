"""One trial: excite, identify, validate, deploy, and what it stores."""
