"""The hypotheses of one joint, screened, fitted and selected forward."""
