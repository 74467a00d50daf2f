"""The compiled kernel of the estimators, and the filters built on it."""
