"""The prediction error of one joint, and the parameters that make it small."""
