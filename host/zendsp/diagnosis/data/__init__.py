"""From files to joint records that the estimators can use."""
