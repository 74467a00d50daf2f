"""Hypotheses of one joint, and of the bodies of a machine: screened, fitted, selected."""
