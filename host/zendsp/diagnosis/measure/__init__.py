"""How well a model explains recordings: likelihood, evidence, discrepancy, and where it lies."""
