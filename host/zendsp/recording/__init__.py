"""recording of zendsp."""
