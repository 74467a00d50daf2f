"""What is compiled for the estimators, and the filters built on it."""
