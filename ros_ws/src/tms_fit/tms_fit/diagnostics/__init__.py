"""What speaks against a fit: residuals, rival hypotheses, error budget."""
